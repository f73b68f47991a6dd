# SPDX-License-Identifier: Apache-2.0
"""Typical magnitudes of parameters for a robot of any size, from what its drives can supply."""

from __future__ import annotations

import numpy as np

from ..robot import Robot
from ..scene import Scene
from ..typing import Array

TWIST_AT_RATED_TORQUE = 1e-3  # rad; heavy and light robots alike twist 0.2 .. 2 mrad per joint at their drives' limit
EFFORT_WHERE_UNKNOWN = 1000.0  # N m


def rated_torque(robot: Robot) -> Array:
    """Torque limit of each joint, (k,), N m; a middle value where the URDF gives none."""
    effort = np.asarray(robot.effort, dtype=float)
    return np.where(np.isfinite(effort) & (effort > 0.0), effort, EFFORT_WHERE_UNKNOWN)


def typical_compliance(robot: Robot) -> Array:
    """Order of magnitude of each joint's torsional compliance, (k,), rad/(N m)."""
    return TWIST_AT_RATED_TORQUE / rated_torque(robot)


def typical_reach(scene: Scene) -> float:
    """Distance of the TCP from base_link, m."""
    return float(max(np.linalg.norm(scene.p_tcp, axis=1).max(), 0.1))
