# SPDX-License-Identifier: Apache-2.0
"""What a model predicts at most over its envelope: any force and torque up to those it was identified with, in any direction.

Springs are linear in the wrench, so the worst directions at a pose follow from six predictions. Other effects are not: the model
itself is asked again under that load, both ways, and where it predicts most under loads along the diagonals too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..errors import ModelError
from ..robot import Robot
from ..typing import Array
from .model import Envelope

# translation of the TCP (3,), m, for joint angles (k,), rad, and force and torque (3,) at the TCP in tool0, N and N m
Predict = Callable[[Array, Array, Array], Array]
POSES = 48  # over the envelope, and its middle
SEED = 1
DIAGONALS_AT = 4  # poses with the largest predictions, where the diagonals are looked at
STEPS = 30  # towards the worst direction; each is at least as bad as the one before
DIAGONALS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)
STARTS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)], dtype=float)


def largest_prediction(envelope: Envelope, robot: Robot, predict: Predict, limit: float) -> float:
    """Largest deflection over the joint ranges and loads of the envelope, m.

    Args:
        limit: m, that it may reach.

    Raises:
        ModelError: above the limit, with pose and load; or a prediction that is not finite.
    """
    poses = _poses(envelope, robot)
    loads = [(axis, np.zeros(3)) for axis in np.eye(3)] + [(np.zeros(3), axis) for axis in np.eye(3)]
    alone = np.array([[_predicted(q, n, m, envelope, predict, limit) for n, m in loads] for q in poses])
    by_force, by_torque = alone[:, :3], alone[:, 3:]  # (poses, 3 axes, 3)
    along, about = worst_directions(by_force, by_torque)
    largest = float(np.linalg.norm(alone, axis=2).max())
    at_pose = np.zeros(len(poses))
    for i, q in enumerate(poses):
        for sign in (1.0, -1.0):
            u = _predicted(q, sign * along[i], sign * about[i], envelope, predict, limit)
            at_pose[i] = max(at_pose[i], float(np.linalg.norm(u)))
    for i in np.argsort(-at_pose)[:DIAGONALS_AT]:
        for n in DIAGONALS:
            m = _unit(by_torque[i] @ _unit(n @ by_force[i]))  # the torque that adds most to what this force does
            at_pose[i] = max(at_pose[i], float(np.linalg.norm(_predicted(poses[i], n, m, envelope, predict, limit))))
    return max(largest, float(at_pose.max()))


def worst_directions(by_force: Array, by_torque: Array) -> tuple[Array, Array]:
    """Unit vectors of the force and of the torque that together displace most, where both act linearly.

    For a direction v of the displacement the best force and torque are those that push along v; v then follows what they do.

    Args:
        by_force, by_torque: displacement by the whole force along, the whole torque about each axis, (n, 3 axes, 3), m.

    Returns:
        Each (n, 3); zero where there is no displacement.
    """
    v = np.repeat(_unit(STARTS)[None], len(by_force), axis=0)  # (n, starts, 3)
    for _ in range(STEPS):
        v = _unit(_unit(v @ by_force.transpose(0, 2, 1)) @ by_force + _unit(v @ by_torque.transpose(0, 2, 1)) @ by_torque)
    f, t = v @ by_force.transpose(0, 2, 1), v @ by_torque.transpose(0, 2, 1)
    best = np.argmax(np.linalg.norm(f, axis=2) + np.linalg.norm(t, axis=2), axis=1)
    n = np.arange(len(v))
    return _unit(f[n, best]), _unit(t[n, best])


def _poses(envelope: Envelope, robot: Robot) -> Array:
    low = np.maximum(np.array(envelope.q_lower), np.where(np.isfinite(robot.lower), robot.lower, -np.pi))
    high = np.minimum(np.array(envelope.q_upper), np.where(np.isfinite(robot.upper), robot.upper, np.pi))
    high = np.maximum(low, high)
    drawn = low + np.random.default_rng(SEED).random((POSES, robot.n_joints)) * (high - low)
    return np.vstack([0.5 * (low + high), drawn])


def _unit(v: Array) -> Array:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(np.divide(v, length, out=np.zeros_like(v), where=length > 0.0))


def _predicted(q: Array, along: Array, about: Array, envelope: Envelope, predict: Predict, limit: float) -> Array:
    """(3,), m, under the whole force along and the whole torque about a direction."""
    u = np.asarray(predict(q, envelope.force * along, envelope.torque * about))
    where = f"at joint angles {np.round(q, 3).tolist()} rad"
    if not np.all(np.isfinite(u)):
        raise ModelError(f"the model predicts {u.tolist()} m {where}")
    length = float(np.linalg.norm(u))
    if length > limit:
        load = " and ".join(
            f"{size:g} {unit} {word} {np.round(axis, 2).tolist()}"
            for size, unit, word, axis in ((envelope.force, "N", "along", along), (envelope.torque, "N m", "about", about))
            if size * np.any(axis)
        )
        raise ModelError(
            f"the model predicts a deflection of {length * 1e3:.3g} mm {where} under {load} of the tool, "
            f"with the {envelope.force:g} N and {envelope.torque:g} N m that it was identified with; "
            f"{limit * 1e3:g} mm is the limit (parameter predicted_limit)"
        )
    return u
