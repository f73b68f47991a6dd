# SPDX-License-Identifier: Apache-2.0
"""What is checked before the robot moves (reach, limits, singularity, clearance, line of sight, torque, workspace) and
before a row is recorded (friction cone, slip)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cell import Cell
from ..errors import PlanError
from ..poses.pool import REASONS, Checker
from ..robot import Robot
from ..typing import Array
from .settings import Settings
from .settle import Window

_MAX_STEPS = 50
_CONVERGED = 1e-10  # m and rad
_WAY_STEPS = 16  # configurations between HOME and an approach pose that are checked


@dataclass(frozen=True)
class Target:
    """One engagement pose H_i with its approach pose A_i and its reference a few millimetres before contact.

    Attributes:
        pose: index i, from 1.
        q_approach: joint angles of A_i, (k,), rad. rail: position of the rail, m; None without one.
        R_tool_in_base: orientation of tool0 in all three, (3, 3).
        p_approach, p_reference: TCP in base_link, (3,), m.
        problem: why the robot must not go there; empty if it may.
    """

    pose: int
    q_approach: Array
    rail: float | None
    R_tool_in_base: Array
    p_approach: Array
    p_reference: Array
    problem: str = ""


def plan_targets(cell: Cell, settings: Settings, q: Array, rail: Array, numbers: list[int]) -> list[Target]:
    """Approach and reference of each pose, and whether the robot may go there.

    Args:
        q: joint angles in contact, (n, k), rad. rail: (n,), m. numbers: pose index i of each, from 1.

    Raises:
        PlanError: shapes that do not fit, numbers that repeat.
    """
    if q.ndim != 2 or q.shape[1] != cell.robot.n_joints or len(rail) != len(q) or len(numbers) != len(q):
        raise PlanError(f"poses have shape {q.shape}; the robot {cell.robot.name} has {cell.robot.n_joints} joints")
    if len(set(numbers)) != len(numbers):
        raise PlanError(f"a pose number is there twice: {sorted(n for n in numbers if numbers.count(n) > 1)[0]}")
    kin = cell.robot.kinematics(q)
    z = kin.R_tool[:, :, 2]
    checker = Checker(cell)
    failed, _, _ = checker.check(q, np.ones(len(q), dtype=bool), rail, -z)
    reasons = [*REASONS.values(), ""]
    targets = []
    for i, number in enumerate(numbers):
        R, p_contact = kin.R_tool[i], kin.p_tcp[i]
        p_approach = p_contact - cell.approach_distance * z[i]
        p_reference = p_contact - cell.reference_distance * z[i]
        q_approach = inverse(cell.robot, q[i], p_approach, R)
        problem = reasons[failed[i]] or _moves(cell, settings, q_approach, np.array([p_approach, p_contact]), rail[i])
        if not problem and q_approach is not None and _way_touches(checker, q_approach, rail[i]):
            problem = "the way from HOME to the approach pose comes too close to the tooling"
        targets.append(
            Target(
                number, q[i] if q_approach is None else q_approach, None if cell.rail is None else float(rail[i]),
                R, p_approach, p_reference, problem,
            )  # fmt: skip
        )
    return targets


def _moves(cell: Cell, settings: Settings, q_approach: Array | None, path_in_base: Array, rail: float) -> str:
    """What is wrong with the way from the approach pose to contact."""
    if q_approach is None:
        return "no joint angles reach the approach pose"
    margin = np.where(cell.robot.is_prismatic, 0.0, cell.joint_margin)
    if (q_approach < cell.robot.lower + margin).any() or (q_approach > cell.robot.upper - margin).any():
        return "the approach pose is outside the joint limits"
    if cell.rail is not None and not cell.rail.lower <= rail <= cell.rail.upper:
        return f"rail position {rail:.3f} m is outside {cell.rail.lower:g} to {cell.rail.upper:g} m"
    path_in_cell = path_in_base + cell.base_in_cell(np.array([rail]))
    if (path_in_cell < settings.workspace[0]).any() or (path_in_cell > settings.workspace[1]).any():
        return "approach or contact is outside the workspace of the cell file"
    return ""


def _way_touches(checker: Checker, q_approach: Array, rail: float) -> bool:
    """Whether arm or tool come too close to the tooling between HOME and the approach pose, wherever the rail comes from."""
    cell = checker.cell
    share = np.linspace(0.0, 1.0, _WAY_STEPS)
    q = cell.home + share[:, None] * (q_approach - cell.home)
    starts = [rail] if cell.rail is None else [rail, cell.rail.lower, cell.rail.upper]
    return any(checker.touches(q, start + share * (rail - start)).any() for start in starts)


def inverse(robot: Robot, start: Array, p_in_base: Array, R_in_base: Array) -> Array | None:
    """Joint angles for a pose of tool0 near known ones (Newton steps); None where there are none.

    Args:
        start: joint angles nearby, (k,), rad. p_in_base: (3,), m. R_in_base: (3, 3).
    """
    q = np.array(start, dtype=float)
    for _ in range(_MAX_STEPS):
        kin = robot.kinematics(q[None])
        E = R_in_base @ kin.R_tool[0].T
        turn = 0.5 * np.array([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]])
        error = np.concatenate([p_in_base - kin.p_tcp[0], turn])
        if np.abs(error).max() < _CONVERGED:
            return q
        angular = np.where(robot.is_prismatic[:, None], 0.0, kin.axis[0]).T
        J = np.vstack([kin.jacobian(kin.p_tcp)[0], angular])
        step = np.linalg.lstsq(J, error, rcond=1e-6)[0]
        q += step * min(1.0, 0.2 / max(np.abs(step).max(), 1e-12))
    return None


def contact_problem(window: Window, reference: Window, R_tool_in_station: Array, settings: Settings) -> str:
    """Why a loaded window must not be recorded; empty if it may.

    Args:
        reference: the reference window of the pose.
        R_tool_in_station: rotation of tool0 into the frame of the station, (3, 3).
    """
    force = window.force_in_tool.mean(axis=0)
    lateral, normal = float(np.hypot(force[0], force[1])), float(-force[2])
    if normal <= 0.0:
        return f"no contact: normal force is {normal:.0f} N"
    if lateral > settings.friction * normal * 1.02:  # 2 % for the tolerance of the force controller
        return (
            f"the contact may slip: {lateral:.0f} N across at {normal:.0f} N normal,"
            f" ratio {lateral / normal:.3f}, limit {settings.friction:.3f}"
        )
    if window.station != reference.station:
        return f"tracker station changed from {reference.station} to {window.station}"
    moved = R_tool_in_station.T @ (window.p_marker_in_station.mean(axis=0) - reference.p_marker_in_station.mean(axis=0))
    way = float(np.hypot(moved[0], moved[1]))
    if way > settings.settling.slip_m:
        limit = settings.settling.slip_m
        return f"the contact slipped: the marker moved {way * 1e3:.2f} mm along the surface, limit {limit * 1e3:.2f} mm"
    return ""
