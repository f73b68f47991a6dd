# SPDX-License-Identifier: Apache-2.0
"""What the drives of a robot can supply: from its description where that says it, else from the weight of its own arm."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..typing import Array, BoolArray
from .robot import Robot

RATED_OVER_GRAVITY = 2.0  # a drive that is rated for its arm carries about twice what gravity asks of it at worst
POSTURES = 64
SMALLEST_SHARE = 0.05  # of the strongest drive's torque; wrists of serial arms have 0.06 to 0.2 of it
WITHOUT_MASSES = 1000.0  # N m, where the robot description gives neither efforts nor masses: nothing is known
FEWEST_ALIKE = 4  # joints with one and the same limit: from shoulder to wrist drives differ, so it was filled in


def rating_known(robot: Robot) -> BoolArray:
    """Joints whose torque limit the description gives, (k,); 0 means that it is not known, and so does one number for all."""
    effort = np.asarray(robot.effort, dtype=float)
    found: BoolArray = np.isfinite(effort) & (effort > 0.0)
    filled_in = len(effort) >= FEWEST_ALIKE and len(np.unique(effort)) == 1
    return np.zeros(len(effort), dtype=bool) if filled_in else found


@lru_cache(maxsize=16)
def rated_torque(robot: Robot) -> Array:
    """Torque limit of each joint, (k,), N m (N where it slides).

    Where the robot description gives none (see `rating_known`), twice the largest torque that gravity exerts
    in any direction over a fixed set of postures. It depends on the robot alone, so that a share of it in a model means the same
    in every session.
    """
    effort = np.asarray(robot.effort, dtype=float)
    known = rating_known(robot)
    if not known.all():
        by_gravity = _worst_gravity_torque(robot)
        largest = float(by_gravity.max())
        guess = np.maximum(by_gravity, SMALLEST_SHARE * largest) if largest > 0.0 else np.full(len(effort), WITHOUT_MASSES)
        effort = np.where(known, effort, guess)
    effort.setflags(write=False)
    return effort


def _worst_gravity_torque(robot: Robot) -> Array:
    lower, upper = np.clip(robot.lower, -np.pi, np.pi), np.clip(robot.upper, -np.pi, np.pi)
    q = np.random.default_rng(0).uniform(lower, np.maximum(upper, lower), (POSTURES, robot.n_joints))
    torque = [np.abs(robot.gravity_torque(q, tuple(9.81 * e))).max(axis=0) for e in np.eye(3)]
    return RATED_OVER_GRAVITY * np.max(torque, axis=0)
