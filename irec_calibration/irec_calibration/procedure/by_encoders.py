# SPDX-License-Identifier: Apache-2.0
"""Procedure 1 without a tracker: standing still, slip and commanded angles, by joint states, tcp_pose and the force sensor.

The limits of the marker go for the TCP. It has to stand by two readings: tcp_pose, and each joint by how far it alone moves
the TCP, so that joints which move against each other do not pass for standing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..session.without_tracker import MOVED
from ..typing import Array
from .settings import Settling
from .standstill import Window, drift, force_unsettled

LEAST_LEVER = 0.1  # m; axes that pass through the TCP turn the tool, whose rim is so far away


def levers(J: Array, revolute: Array, rails: int) -> Array:
    """How far each axis moves the TCP, m per rad (or m per m): from the Jacobian (3, k), at least LEAST_LEVER; (k + rails,)."""
    lever = np.linalg.norm(J, axis=0)
    return np.append(np.where(revolute, np.maximum(lever, LEAST_LEVER), lever), np.ones(rails))


def unsettled_by_encoders(
    window: Window, s: Settling, min_samples: int, force_target: Array | None, lever: Array, names: Sequence[str]
) -> str:
    """Why the robot does not stand still in a window, empty if it does.

    Args:
        force_target: set point in tool0, (3,), N; None for a reference, where no force is controlled.
        lever: how far each joint and external axis moves the TCP, (k,), m per rad or per m. names: of them, k.
    """
    for topic, n in (("joint_states", len(window.q)), ("tcp_pose", len(window.p_tcp_in_base))):
        if n < min_samples:
            return f"{topic} delivers {n} samples per window, {min_samples} are needed"
    at_tcp = (window.q - window.q.mean(axis=0)) * lever
    for source, columns, way in (("the TCP", "xyz", window.p_tcp_in_base), ("", names, at_tcp)):
        std, moving = way.std(axis=0), drift(way)
        worst, furthest = int(std.argmax()), int(moving.argmax())
        if not std[worst] <= s.marker_std_m:
            return (
                f"{_what(source, columns[worst])}: standard deviation {std[worst] * 1e6:.0f} um at the TCP,"
                f" limit {s.marker_std_m * 1e6:.0f} um"
            )
        if not moving[furthest] <= s.marker_drift_m:
            return (
                f"{_what(source, columns[furthest])}: drift of {moving[furthest] * 1e6:.1f} um at the TCP per half window,"
                f" limit {s.marker_drift_m * 1e6:.1f} um"
            )
    return force_unsettled(window, s, force_target)


def _what(source: str, axis: str) -> str:
    return f"{source} moves along {axis} (tcp_pose)" if source else f"{axis} moves (joint_states)"


def slip_problem(window: Window, p_contact: Array, R_tool_in_base: Array, slip_m: float) -> str:
    """Whether the disc may have slipped since contact was made under the normal force alone; empty if it has not.

    Args:
        p_contact: TCP by the controller when contact was made, (3,), m in base_link.
        R_tool_in_base: rotation of tool0, (3, 3).
        slip_m: m; the way that arm and disc give way across is part of it.
    """
    moved = R_tool_in_base.T @ (window.p_tcp_in_base.mean(axis=0) - p_contact)
    way = float(np.hypot(moved[0], moved[1]))
    if way <= slip_m:
        return ""
    return (
        f"the contact slipped, or arm and disc give way by as much: tcp_pose moved by {way * 1e3:.2f} mm across the tool since"
        f" contact was made, limit {slip_m * 1e3:.2f} mm (settling.slip_m; raise it where the arm is soft across the tool)"
    )


def commanded_problem(p_tcp: Sequence[Array]) -> str:
    """Whether the controller's TCP is the same under all load cases of a pose, as commanded angles are; empty if it is not.

    Args:
        p_tcp: mean TCP of each load case that was recorded, each (3,), m.
    """
    if len(p_tcp) < 2:
        return ""
    way = float(np.linalg.norm(np.array(p_tcp) - p_tcp[0], axis=1).max())
    if way >= MOVED:
        return ""
    return (
        f"tcp_pose moves by {1e6 * way:.2g} um from one load case to the next, at least {1e6 * MOVED:g} um is expected where"
        " force control presses on: without a tracker joint_states have to be measured angles, these seem to be commanded ones"
    )
