# SPDX-License-Identifier: Apache-2.0
"""`poses.yaml` (`irec-poses/1`): the engagement poses that `irec plan` chose and the procedure drives to.

format: irec-poses/1
cell: name of the cell
robot: {serial, urdf_sha256, joints: [names]}     a pose file belongs to one robot
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
    """The content of a pose file. plan: method, seed, pool and figures, as plain values."""

    cell: str
    serial: str
    urdf_sha256: str
    joint_names: tuple[str, ...]
    poses: tuple[EngagementPose, ...]
    plan: dict[str, Any] = field(default_factory=dict)


def write_poses(poses: PoseList, path: str | Path) -> Path:
    """Write a pose file; returns its path."""
    path = Path(path)
    content = {
        "format": FORMAT,
        "cell": poses.cell,
        "robot": {"serial": poses.serial, "urdf_sha256": poses.urdf_sha256, "joints": list(poses.joint_names)},
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
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120), encoding="utf-8")
    return path


def read_poses(path: str | Path, serial: str | None = None, urdf_sha256: str | None = None) -> PoseList:
    """Read a pose file.

    Args:
        serial, urdf_sha256: where given, of the robot that is to drive to these poses.

    Raises:
        PlanError: not a pose file, a wrong value, or poses of another robot; names file and pose.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise PlanError(f"{path}: can't read the pose file: {error.strerror}; make one with irec plan") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise PlanError(f"{path}: not a YAML file: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise PlanError(f"{path}: format is {found!r}, this version reads {FORMAT}")
    try:
        robot = content["robot"]
        names = tuple(str(name) for name in robot["joints"])
        poses = tuple(_pose(path, i, entry, len(names)) for i, entry in enumerate(content["poses"]))
        result = PoseList(
            str(content["cell"]), str(robot["serial"]), str(robot["urdf_sha256"]), names, poses, content.get("plan", {})
        )
    except (KeyError, TypeError) as error:
        raise PlanError(f"{path}: {error} is missing or of the wrong kind") from error
    if len({pose.index for pose in poses}) != len(poses):
        raise PlanError(f"{path}: a pose index occurs twice")
    if serial is not None and serial != result.serial:
        raise PlanError(f"{path}: planned for the robot {result.serial!r}, this one is {serial!r}; plan again")
    if urdf_sha256 is not None and urdf_sha256 != result.urdf_sha256:
        raise PlanError(f"{path}: the robot description has changed since these poses were planned; plan again")
    return result


def _pose(path: str | Path, i: int, entry: dict[str, Any], n_joints: int) -> EngagementPose:
    def numbers(key: str, length: int) -> Array:
        try:
            value = np.array(entry[key], dtype=float)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        if value.shape != (length,) or not np.isfinite(value).all():
            raise PlanError(f"{path}: poses[{i}].{key} must be {length} finite numbers, is {entry[key]!r}")
        return value

    return EngagementPose(
        index=int(entry["pose"]),
        q=numbers("joints", n_joints),
        ext={str(name): float(value) for name, value in (entry.get("ext") or {}).items()},
        p_tool_in_base=numbers("p_tool0_in_base", 3),
        quat_tool_in_base=numbers("quat_tool0_in_base", 4),
        normal_in_base=numbers("normal_in_base", 3),
        approach_distance=float(entry["approach_distance"]),
        station=str(entry["station"]),
    )


def _plain(values: Array) -> list[float]:
    return [round(float(value), 9) for value in values]
