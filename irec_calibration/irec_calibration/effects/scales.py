# SPDX-License-Identifier: Apache-2.0
"""Typical magnitudes of parameters for a robot of any size, from what its drives can supply."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..robot import Robot
from ..robot.ratings import rated_torque, rating_known
from ..typing import Array, BoolArray, IntArray
from .scene import Scene

SURELY = 2.0  # standard errors by which a value is what it is said to be, for certain
TWIST_AT_RATED_TORQUE = 1e-3  # rad; heavy and light robots alike twist 0.2 .. 2 mrad per joint at their drives' limit
STIFFER_THAN = 100.0  # times the typical compliance: more is no gear
TWIST_UNDER_OWN_WEIGHT = 0.02  # rad; light arms on soft drives or soft servos sag that much, none more
LAG = 3e-3  # rad; friction of a sound gear and servo
LAG_OVER_REPEATABILITY = 5.0  # what the side from which a joint came moves the tool by, over one standard deviation of the rest
USUAL_SHARE = 0.03  # of the deflection, RMS; chosen: the most that tools and floors without any cause were found to give way by
COUNTS = 0.1  # of the largest size of a law in any axis: less says nothing of what it is
POSTURES = 100
AT_BORDER = 0.02
NEAR = 1.5  # times the range over which a law of torque bends: tanh is at 0.9 there


def typical_compliance(robot: Robot) -> Array:
    """Order of magnitude of each joint's torsional compliance, (k,), rad/(N m)."""
    return TWIST_AT_RATED_TORQUE / rated_torque(robot)


def softest(scene: Scene, scale: Array, largest_torque: Array) -> Array:
    """The largest compliance that is physically likely, (p,), rad/(N m).

    Under gravity alone a light arm on soft drives may be far softer than its torque limits say; how far it sags bounds it.

    Args:
        scale: typical compliance, (p,). largest_torque: that acts in the session, (p,), N m.
    """
    limit = STIFFER_THAN * scale
    if scene.kind != "absolute":
        return limit
    by_sag = TWIST_UNDER_OWN_WEIGHT / np.maximum(largest_torque, TWIST_UNDER_OWN_WEIGHT / np.maximum(1e3 * limit, 1e-300))
    return np.maximum(limit, by_sag)


def largest_lag(scene: Scene) -> Array:
    """The largest angle that is physically likely between a joint that came from one side and from the other, (k,), rad.

    A stated repeatability tells the class of the robot: it counts approaches from one side, the lag comes on top of it.
    """
    by_class = LAG_OVER_REPEATABILITY * scene.arm.repeatability / np.maximum(scene.view.lever, 1e-2)
    return np.maximum(LAG, by_class)


def typical_reach(scene: Scene) -> float:
    """Distance of the TCP from base_link, m."""
    return float(max(np.linalg.norm(scene.p_tcp, axis=1).max(), 0.1))


@lru_cache(maxsize=16)
def typical_give(robot: Robot) -> float:
    """How far the TCP moves per force, m/N, where every joint has its typical compliance, over random postures.

    What carries a light arm, or is carried by it, gives way as the arm does.
    """
    q = np.random.default_rng(0).uniform(-np.pi / 2, np.pi / 2, (POSTURES, robot.n_joints))
    kin = robot.kinematics(q)
    return float(((kin.jacobian(kin.p_tcp) ** 2).sum(axis=1) @ typical_compliance(robot)).mean())


def may_be_wide(scene: Scene, axes: IntArray, size: Array, soft: Array, share: float) -> BoolArray:
    """Of the axes that have a law and whose torque limit is not stated: whether the range over which the gear is soft may be
    wider than a share of the limit.

    There `rated_torque` is a guess; all that is known is that the drive carries what the session shows.

    Args:
        axes: joints from 0, (p,); size: of the law in each, (p,); soft: half of the range, (p,), N m; share: of the limit.
    """
    largest = np.abs(scene.tau_acting + scene.tau_gravity).max(axis=0)[axes]
    has_it = (size != 0.0) & (np.abs(size) >= COUNTS * np.abs(size).max(initial=0.0))
    asked = has_it & ~rating_known(scene.robot)[axes]
    return np.asarray(soft[asked] > share * largest[asked])


def at_border(share: float, border: float) -> bool:
    """Whether a gear is soft over just the range at which play ends and a soft gear begins: a law came to it as to a bound, and
    the one on the other side would do as well."""
    return abs(share - border) <= AT_BORDER * border


def comes_near_zero(scene: Scene, soft: Array) -> BoolArray:
    """Joints whose total torque comes near zero in the rows of a session, or is on both sides of it, (k,).

    Args:
        soft: range of torque about zero over which a law bends, (k,), N m.
    """
    torque = scene.tau_acting + scene.tau_gravity
    near = (np.abs(torque) <= NEAR * soft).any(axis=0)
    return np.asarray(near | ((torque > 0.0).any(axis=0) & (torque < 0.0).any(axis=0)))
