# SPDX-License-Identifier: Apache-2.0
"""How the robot's driver names its joints, and how a session does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cell import Cell
from ..errors import CellError

RAIL_SPEED = 5.0  # m/s, that no rail exceeds; cell files do not state it


@dataclass(frozen=True)
class Axes:
    """Joints in the order of the robot description, then the rail where there is one.

    Attributes:
        driver: names in `joint_states` and in moves. recorded: names in a session (joint_1 .. joint_n, ext_rail).
        lower, upper: limits, rad or m. revolute: whether the axis turns. velocity: limit, rad/s or m/s; inf: not known.
    """

    driver: tuple[str, ...]
    recorded: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    revolute: tuple[bool, ...]
    velocity: tuple[float, ...]


def read_axes(cell: Cell) -> Axes:
    """`robot.joint_names` (default: the names of the robot description) and `robot.rail.joint_name` (default: ext_rail).

    Raises:
        CellError: a name twice.
    """
    robot = cell.raw["robot"]
    names = robot.get("joint_names", cell.robot.joint_names)  # as many as joints: the rules of the cell file see to it
    driver, recorded = list(names), [f"joint_{k + 1}" for k in range(cell.robot.n_joints)]
    lower, upper = list(cell.robot.lower), list(cell.robot.upper)
    revolute = [not prismatic for prismatic in cell.robot.kinematics(cell.home[None]).is_prismatic]
    velocity = [float(v) if np.isfinite(v) and v > 0.0 else np.inf for v in cell.robot.velocity]
    if cell.rail is not None:
        driver.append(robot["rail"].get("joint_name", "ext_rail"))
        recorded.append("ext_rail")
        lower.append(cell.rail.lower)
        upper.append(cell.rail.upper)
        revolute.append(False)
        velocity.append(RAIL_SPEED)
    if len(set(driver)) != len(driver):
        raise CellError(f"{cell.path}: robot.joint_names: a name is there twice: {driver}")
    return Axes(
        tuple(driver), tuple(recorded), tuple(map(float, lower)), tuple(map(float, upper)), tuple(map(bool, revolute)),
        tuple(map(float, velocity)),
    )  # fmt: skip
