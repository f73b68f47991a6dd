# SPDX-License-Identifier: Apache-2.0
"""`poses.yaml` (`irec-poses/1`): the engagement poses that `irec plan` chose and the procedure drives to.

format: irec-poses/1
cell: name of the cell
robot: {serial, urdf_sha256, joints: [names]}     a pose file belongs to one robot
lateral_factor: 1.25                              forces across the tool, in multiples of the cell file's; 1 where it is not said
plan: {method, seed, d_max_m, pool, drawn, rejected: {reason: count}, figures: {...}}
poses:                                            SI units, in the order in which they are to be visited
  - pose: 1                                       index, from 1
    joints: [rad, ...]                            engagement configuration H_i: TCP on the surface
    ext: {rail: m}                                external axes; empty without
    p_tool0_in_base: [m, m, m]                    tool0 in base_link at contact (rail where ext says)
    quat_tool0_in_base: [x, y, z, w]
    normal_in_base: [x, y, z]                     outward surface normal (minus tool z)
    approach_distance: m                          approach pose A_i is this far back along tool z
    station: name                                 tracker station that sees the marker best
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..errors import PlanError
from ..files import Document, check_replaceable, read_document, write_file
from ..files.outputs import of_format
from ..typing import Array

FORMAT = "irec-poses/1"


@dataclass(frozen=True)
class EngagementPose:
    """One engagement configuration; see the module's text for units and frames. q (k,), p (3,), quat_xyzw (4,), normal (3,)."""

    index: int
    q: Array
    ext: dict[str, float]
    p_tool_in_base: Array
    quat_tool_in_base: Array
    normal_in_base: Array
    approach_distance: float
    station: str


@dataclass(frozen=True)
class PoseList:
    """The content of a pose file.

    Attributes:
        plan: method, seed, pool and figures, as plain values.
        lateral_factor: of the forces across the tool in the load cases at these poses, in multiples of the cell file's.
    """

    cell: str
    serial: str
    urdf_sha256: str
    joint_names: tuple[str, ...]
    poses: tuple[EngagementPose, ...]
    plan: dict[str, Any] = field(default_factory=dict)
    lateral_factor: float = 1.0


def write_poses(poses: PoseList, path: str | Path) -> Path:
    """Write a pose file; returns its path. PlanError: what is there is no pose file, and stays; or it can't be written."""
    path = check_poses_target(path)
    content = {
        "format": FORMAT,
        "cell": poses.cell,
        "robot": {"serial": poses.serial, "urdf_sha256": poses.urdf_sha256, "joints": list(poses.joint_names)},
        **({"lateral_factor": float(poses.lateral_factor)} if poses.lateral_factor != 1.0 else {}),
        "plan": poses.plan,
        "poses": [
            {
                "pose": pose.index,
                "joints": _plain(pose.q),
                "ext": {name: round(float(value), 9) for name, value in pose.ext.items()},
                "p_tool0_in_base": _plain(pose.p_tool_in_base),
                "quat_tool0_in_base": _plain(pose.quat_tool_in_base),
                "normal_in_base": _plain(pose.normal_in_base),
                "approach_distance": float(pose.approach_distance),
                "station": pose.station,
            }
            for pose in poses.poses
        ],
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120)
    return write_file(path, text, "the poses", PlanError)


def check_poses_target(path: str | Path) -> Path:
    """The path of a pose file that may be written. PlanError: what is there is something else."""
    return check_replaceable(path, "a pose file", (of_format(FORMAT),), PlanError)


def read_poses(path: str | Path, serial: str | None = None, urdf_sha256: str | None = None) -> PoseList:
    """Read a pose file.

    Args:
        serial, urdf_sha256: where given, of the robot that is to drive to these poses.

    Raises:
        PlanError: not a pose file, a wrong value, or poses of another robot; names file, line and pose.
    """
    document = read_document(path, FORMAT, "pose file", PlanError, rules=(_consistent,))
    content = document.data
    robot = content["robot"]
    result = PoseList(
        content["cell"],
        robot["serial"],
        robot["urdf_sha256"],
        tuple(robot["joints"]),
        tuple(_pose(entry) for entry in content["poses"]),
        content.get("plan") or {},
        float(content.get("lateral_factor", 1.0)),
    )
    if serial is not None and serial != result.serial:
        raise PlanError(f"{path}: planned for the robot {result.serial!r}, this one is {serial!r}; plan again")
    if urdf_sha256 is not None and urdf_sha256 != result.urdf_sha256:
        raise PlanError(f"{path}: the robot description has changed since these poses were planned; plan again")
    return result


def _consistent(document: Document) -> None:
    """Lengths, indices and unit vectors."""
    if not (document.sound("poses") and document.sound("robot")):
        return
    n = len(document.data["robot"]["joints"])
    seen: dict[int, int] = {}
    for i, pose in enumerate(document.data["poses"]):
        if len(pose["joints"]) != n:
            document.wrong(("poses", i, "joints"), f"has {len(pose['joints'])} values, robot.joints names {n}")
        if int(pose["pose"]) in seen:
            other = seen[int(pose["pose"])]
            document.wrong(("poses", i, "pose"), f"is {pose['pose']} again (poses[{other}]); every pose has an index of its own")
        seen[int(pose["pose"])] = i
        for key in ("quat_tool0_in_base", "normal_in_base"):
            length = float(np.linalg.norm(pose[key]))
            if abs(length - 1.0) > 1e-3:
                document.wrong(("poses", i, key), f"has length {length:.4f}, must have length 1")


def _pose(entry: dict[str, Any]) -> EngagementPose:
    return EngagementPose(
        index=int(entry["pose"]),
        q=np.array(entry["joints"], dtype=float),
        ext={str(name): float(value) for name, value in (entry.get("ext") or {}).items()},
        p_tool_in_base=np.array(entry["p_tool0_in_base"], dtype=float),
        quat_tool_in_base=np.array(entry["quat_tool0_in_base"], dtype=float),
        normal_in_base=np.array(entry["normal_in_base"], dtype=float),
        approach_distance=float(entry["approach_distance"]),
        station=entry["station"],
    )


def _plain(values: Array) -> list[float]:
    return [round(float(value), 9) for value in values]
