# SPDX-License-Identifier: Apache-2.0
"""What is checked before the robot moves (reach, limits, singularity, clearance, line of sight, torque, workspace) and
before a row is recorded (friction cone, slip)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ..cell import Cell
from ..errors import PlanError
from ..poses.checker import REASONS, Checker
from ..typing import Array
from .by_encoders import levers, slip_problem
from .commands import LONGEST_LEASE
from .settings import Settings
from .standstill import Window

SLIP_MARGIN = 1.02  # for the tolerance of the force controller
TCP_OFF = 0.005  # m by which the contact may be off the TCP along the tool
TORQUE_MARGIN, TORQUE_SHARE = 3.0, 0.005  # N m of a sensor's own errors, and N m per N of the force at most
LARGEST_NUMBER = 2**31 - 1  # of a pose, in a message


@dataclass(frozen=True)
class Target:
    """One engagement pose H_i with its approach pose A_i and its reference a few millimetres before contact.

    Attributes:
        pose: index i, from 1.
        q_approach: joint angles of A_i, (k,), rad. rail: position of the rail, m; None without one.
        R_tool_in_base: orientation of tool0 in all three, (3, 3).
        p_approach, p_reference: TCP in base_link, (3,), m.
        problem: why the robot must not go there; empty if it may.
        lever: how far each joint and external axis moves the TCP in contact, (k,), m per rad or per m.
    """

    pose: int
    q_approach: Array
    rail: float | None
    R_tool_in_base: Array
    p_approach: Array
    p_reference: Array
    problem: str = ""
    lever: Array = field(default_factory=lambda: np.ones(1))


def plan_targets(cell: Cell, settings: Settings, q: Array, rail: Array, numbers: list[int]) -> list[Target]:
    """Approach and reference of each pose, and whether the robot may go there.

    Args:
        q: joint angles in contact, (n, k), rad. rail: (n,), m. numbers: pose index i of each, from 1.

    Raises:
        PlanError: shapes that do not fit, numbers that repeat.
    """
    if q.ndim != 2 or q.shape[1] != cell.robot.n_joints or len(rail) != len(q) or len(numbers) != len(q):
        raise PlanError(f"poses have shape {q.shape}; the robot {cell.robot.name} has {cell.robot.n_joints} joints")
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= LARGEST_NUMBER:
            raise PlanError(f"a pose is numbered {number!r}; whole numbers from 1 to {LARGEST_NUMBER} are needed")
    if len(set(numbers)) != len(numbers):
        raise PlanError(f"a pose number is there twice: {sorted(n for n in numbers if numbers.count(n) > 1)[0]}")
    kin = cell.robot.kinematics(q)
    z = kin.R_tool[:, :, 2]
    checker = Checker(cell)
    failed, _, _ = checker.check(q, np.ones(len(q), dtype=bool), rail, -z)
    q_approach, _ = checker.approach(q, kin.p_tcp, kin.R_tool)
    reasons = [*REASONS.values(), ""]
    J, revolute = kin.jacobian(kin.p_tcp), np.logical_not(cell.robot.is_prismatic)
    targets = []
    for i, number in enumerate(numbers):
        p_approach = kin.p_tcp[i] - cell.approach_distance * z[i]
        p_reference = kin.p_tcp[i] - cell.reference_distance * z[i]
        path = np.array([p_approach, kin.p_tcp[i]])
        targets.append(
            Target(
                number,
                q_approach[i],
                None if cell.rail is None else float(rail[i]),
                kin.R_tool[i],
                p_approach,
                p_reference,
                reasons[failed[i]] or _out_of_bounds(cell, settings, path, float(rail[i])),
                levers(J[i], revolute, 0 if cell.rail is None else 1),
            )  # fmt: skip
        )
    return targets


def _out_of_bounds(cell: Cell, settings: Settings, path_in_base: Array, rail: float) -> str:
    """What is wrong with the rail position or the way from the approach pose to contact."""
    if cell.rail is not None and not cell.rail.lower <= rail <= cell.rail.upper:
        return f"rail position {rail:.3f} m is outside {cell.rail.lower:g} to {cell.rail.upper:g} m"
    path_in_cell = path_in_base + cell.base_in_cell(np.array([rail]))
    if (path_in_cell < settings.workspace[0]).any() or (path_in_cell > settings.workspace[1]).any():
        return "approach or contact is outside the workspace of the cell file"
    return ""


def contact_problem(window: Window, reference: Window, R_tool_in_station: Array, settings: Settings) -> str:
    """Why a loaded window must not be recorded; empty if it may.

    Args:
        reference: the reference window of the pose.
        R_tool_in_station: rotation of tool0 into the frame of the station, (3, 3).
    """
    if problem := _force_problem(window, reference, settings):
        return problem
    if window.station != reference.station:
        return f"tracker station changed from {reference.station} to {window.station}"
    moved = R_tool_in_station.T @ (window.p_marker_in_station.mean(axis=0) - reference.p_marker_in_station.mean(axis=0))
    way = float(np.hypot(moved[0], moved[1]))
    if way > settings.settling.slip_m:
        limit = settings.settling.slip_m
        moved_by = f"{way * 1e3:.2f} mm along the surface, limit {limit * 1e3:.2f} mm"
        return f"the contact slipped, or the tracker jumped: the marker moved by {moved_by}"
    return ""


def contact_problem_by_encoders(
    window: Window, reference: Window, p_contact: Array, R_tool_in_base: Array, settings: Settings
) -> str:
    """The same without a tracker; p_contact: TCP by the controller when contact was made, (3,), m in base_link."""
    problem = _force_problem(window, reference, settings)
    return problem or slip_problem(window, p_contact, R_tool_in_base, settings.settling.slip_m)


def _force_problem(window: Window, reference: Window, settings: Settings) -> str:
    force = window.force_in_tool.mean(axis=0)
    lateral, normal = float(np.hypot(force[0], force[1])), float(-force[2])
    if normal <= 0.0:
        return f"no contact: normal force is {normal:.0f} N"
    if lateral > settings.friction * normal * SLIP_MARGIN:
        return (
            f"the contact may slip: {lateral:.0f} N across at {normal:.0f} N normal,"
            f" ratio {lateral / normal:.3f}, limit {settings.friction:.3f}"
        )
    torque = window.torque_in_tool.mean(axis=0) - reference.torque_in_tool.mean(axis=0)  # less what the tool's weight leaves
    return torque_problem(torque, force, settings.pad_radius)


def torque_limit(force: Array, pad_radius: float) -> float:
    """Largest torque about the TCP, N m, that a pad can carry. force: (3,), N, in tool0. pad_radius: m."""
    total = float(np.linalg.norm(force))
    return pad_radius * abs(float(force[2])) + TCP_OFF * total + min(TORQUE_MARGIN, TORQUE_SHARE * total)


def torque_problem(torque: Array, force: Array, pad_radius: float) -> str:
    """Why a pad can't carry this torque about the TCP; empty if it can, or its radius is not known (0).

    All of the normal force at the rim is the most: a pad that touches as it should carries far less.

    Args:
        torque: (3,), N m. force: (3,), N, both of the contact on the robot in tool0. pad_radius: m.
    """
    size, total = float(np.linalg.norm(torque)), float(np.linalg.norm(force))
    limit = torque_limit(force, pad_radius)
    if pad_radius <= 0.0 or size <= limit:
        return ""
    return (
        f"the wrench has a torque of {size:.1f} N m in contact, limit {limit:.1f} N m: a pad of {1e3 * pad_radius:g} mm radius"
        f" (tool.pad_radius) can't carry more at {abs(float(force[2])):.0f} N along the tool. The lever arm is at least"
        f" {1e3 * size / max(total, 1e-9):.0f} mm of the force, {_across(size, force)} mm of its part across the tool: is the"
        " torque taken about the sensor in place of the TCP, or in another unit?"
    )


def _across(size: float, force: Array) -> str:
    across = float(np.hypot(force[0], force[1]))
    return f"{1e3 * size / across:.0f}" if across > 0.0 else "no"


def lease_problem(lease: float, operator_at_robot: bool) -> str:
    """Why a driver that takes a force set point to hold for `lease` s (0: for ever) must not press; empty where it may."""
    if not (math.isfinite(lease) and lease >= 0.0):
        return f"the robot's driver says that force_lease is {lease} s; a finite number from 0 on is needed"
    if operator_at_robot or 0.0 < lease <= LONGEST_LEASE:
        return ""
    way_out = " set procedure.operator_at_robot: true in the cell file where somebody stands at the emergency stop"
    if lease == 0.0:
        return (
            f"the robot's driver has no dead man's switch (force_lease is 0): it would press on if this computer failed;{way_out}"
        )
    return (
        f"the robot's driver would press on for {lease:g} s if this computer failed (force_lease), limit {LONGEST_LEASE:g} s;"
        f" shorten it, or{way_out}"
    )
