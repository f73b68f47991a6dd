# SPDX-License-Identifier: Apache-2.0
"""Everything that can be wrong in a cell file and what it names, said at once: description, surface, sections, pose file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..cell.cell import open_cell
from ..cell.rules import PROCEDURE_SECTIONS
from ..errors import IrecError, PlanError
from ..files.document import Document
from ..files.regular import is_there
from ..robot import Robot
from .store import PoseList, read_poses

POSITION_TOLERANCE = 1e-4  # m, between the pose file and forward kinematics
ANGLE_TOLERANCE = 1e-3  # rad


def cell_problems(path: Path) -> tuple[list[str], list[str]]:
    """What is wrong in a cell file, one line each, and what should be known about it.

    Raises CellError: not a cell file at all.
    """
    document, robot, _ = open_cell(path)
    notes = []
    for name in PROCEDURE_SECTIONS:
        if name not in document.data:
            document.wrong((name,), "is missing: planning does without, the procedure does not; irec init-cell writes one")
    if document.sound("poses"):
        file = path.parent / document.data["poses"]
        if not is_there(file):
            notes.append(f"poses: {file} is not there yet; irec plan {path} writes it")
        else:
            _check_poses(document, robot, file)
    return [str(p) for p in document.problems], notes


def _check_poses(document: Document, robot: Robot | None, file: Path) -> None:
    """Note what of a pose file is wrong or does not belong to this cell."""
    cell = document.data
    serial = cell["robot"]["serial"] if document.sound("robot", "serial") else None
    try:
        poses = read_poses(file, serial, robot.sha256 if robot else None)
    except PlanError as error:
        for text in error.problems or (str(error),):
            document.wrong(("poses",), f"can't be used: {text}")
        return
    if document.sound("name") and poses.cell != cell["name"]:
        document.wrong(("poses",), f"{file} was planned for the cell {poses.cell!r}, this is {cell['name']!r}; plan again")
    if document.sound("stations"):
        names = {station["name"] for station in cell["stations"]}
        for unknown in sorted({pose.station for pose in poses.poses} - names):
            have = ", ".join(sorted(names))
            document.wrong(("poses",), f"{file} names the station {unknown!r}, the cell has {have}; plan again")
    if robot is not None:
        try:
            _check_kinematics(document, robot, poses, file)
        except IrecError as error:
            document.wrong(("poses",), f"{file} does not fit the robot: {error}")


def _check_kinematics(document: Document, robot: Robot, poses: PoseList, file: Path) -> None:
    q = np.array([pose.q for pose in poses.poses])
    kin = robot.kinematics(q)
    away = np.linalg.norm(kin.p_tcp - [pose.p_tool_in_base for pose in poses.poses], axis=1)
    worst = int(np.argmax(away))
    if away[worst] > POSITION_TOLERANCE:
        document.wrong(
            ("poses",),
            f"{file}: the joints of pose {poses.poses[worst].index} put tool0 {1e3 * away[worst]:.1f} mm from its p_tool0_in_base"
            f" (limit {1e3 * POSITION_TOLERANCE:g} mm); plan again",
        )
    low, high = robot.lower - ANGLE_TOLERANCE, robot.upper + ANGLE_TOLERANCE
    for i in np.flatnonzero(((q < low) | (q > high)).any(axis=1))[:1]:
        index = poses.poses[i].index
        document.wrong(("poses",), f"{file}: pose {index} lies outside the joint limits of the description; plan again")
    if document.sound("robot", "rail", "range"):
        low_, high_ = document.data["robot"]["rail"]["range"]
        for pose in poses.poses:
            if not low_ - 1e-6 <= pose.ext.get("rail", 0.0) <= high_ + 1e-6:
                at = pose.ext.get("rail", 0.0)
                document.wrong(("poses",), f"{file}: pose {pose.index} has the rail at {at:g} m, range {low_:g} .. {high_:g} m")
                break
