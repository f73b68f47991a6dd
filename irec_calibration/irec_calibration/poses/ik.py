# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics of thousands of tool axes at once: damped least squares on the product of exponentials.

The chain is read once from the robot (Pinocchio) at zero joint angles; from there on all starts move together as arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..robot import Robot
from ..typing import Array, BoolArray

_MAX_STEPS = 60
_RESTING_STEPS = 35  # of these, in which a redundant arm is drawn to its rest
_REST_GAIN = 0.15  # share of the distance per step
_NEARBY_STEPS = 15  # from joint angles that are near the solution
_LARGEST_STEP = 0.35  # rad (or m) per iteration and joint
_ANGLE_WEIGHT = 0.5  # m per rad: what an error of direction counts against one of position
_CONVERGED = 1e-9  # m (or weighted rad)
_EYE = np.eye(3)


@dataclass(frozen=True)
class Chain:
    """Product of exponentials: axes and origins (k, 3) in base_link and tool0 (rotation, position) at zero joints."""

    axis: Array
    origin: Array
    R_tool: Array
    p_tool: Array
    is_prismatic: BoolArray

    @classmethod
    def of(cls, robot: Robot) -> Chain:
        zero = robot.kinematics(np.zeros((1, robot.n_joints)))
        return cls(zero.axis[0], zero.origin[0], zero.R_tool[0], zero.p_tcp[0], zero.is_prismatic.astype(bool))

    @cached_property
    def _turning(self) -> tuple[Array, Array]:
        """The cross-product matrix of each axis and its square, (k, 3, 3)."""
        x, y, z = self.axis.T
        none = np.zeros_like(x)
        K = np.array([[none, -z, y], [z, none, -x], [-y, x, none]]).transpose(2, 0, 1)
        return K, K @ K

    def forward(self, q: Array) -> tuple[Array, Array, Array]:
        """tool0 and Jacobian for joints q (n, k): p (n, 3) m, R (n, 3, 3), J (n, 6, k), linear part first, in base_link."""
        n, k = q.shape
        R, t = np.broadcast_to(_EYE, (n, 3, 3)), np.zeros((n, 3))
        K, KK = self._turning
        turns = _EYE + np.sin(q)[..., None, None] * K + (1 - np.cos(q))[..., None, None] * KK
        shifts = (_EYE - turns) @ self.origin[..., None]
        axes, origins = np.empty((n, k, 3)), np.empty((n, k, 3))
        for i in range(k):
            axes[:, i] = R @ self.axis[i]
            origins[:, i] = R @ self.origin[i] + t
            if self.is_prismatic[i]:
                t = t + axes[:, i] * q[:, i, None]
            else:
                t = t + (R @ shifts[:, i])[..., 0]
                R = R @ turns[:, i]
        p = R @ self.p_tool + t
        linear = np.where(self.is_prismatic[:, None], axes, np.cross(axes, p[:, None, :] - origins))
        angular = np.where(self.is_prismatic[:, None], 0.0, axes)
        return p, R @ self.R_tool, np.concatenate([linear, angular], axis=2).swapaxes(1, 2)


def solve_tool_axis(
    chain: Chain, p: Array, z: Array, start: Array, rest: Array | None = None
) -> tuple[Array, BoolArray]:
    """Joint angles that put the TCP at a point with tool z along a direction; rotation about tool z is left free.

    Args:
        p: wanted TCP in base_link, shape (n, 3), m.
        z: wanted unit direction of tool z in base_link, shape (n, 3).
        start: joint angles to begin with, shape (n, k), rad. The rotation about z that comes out follows from it.
        rest: joint angles (n, k) that the arm is drawn to by motions that leave the tool where it is (None: not drawn).

    Returns:
        joint angles (n, k), not wrapped to any limit, and whether each has converged to 1e-9 m (n,).
    """
    q = start.copy()
    converged = np.zeros(len(q), dtype=bool)
    active = np.arange(len(q))
    damping = 1e-3 * np.eye(6)
    for iteration in range(_MAX_STEPS):
        p_now, R_now, J = chain.forward(q[active])
        z_now = R_now[:, :, 2]
        turn = np.cross(z_now, z[active])
        sine, cosine = np.linalg.norm(turn, axis=1), np.sum(z_now * z[active], axis=1)
        turn *= (np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))[:, None]
        error = np.concatenate([p[active] - p_now, _ANGLE_WEIGHT * turn], axis=1)
        size = np.linalg.norm(error, axis=1)
        done = size < _CONVERGED
        if rest is not None and iteration < _RESTING_STEPS:
            done[:] = False
        converged[active[done]] = True
        active, J, z_now, error, size = active[~done], J[~done], z_now[~done], error[~done], size[~done]
        if len(active) == 0:
            break
        about_z = np.einsum("ni,nij->nj", z_now, J[:, 3:])
        J[:, 3:] = _ANGLE_WEIGHT * (J[:, 3:] - z_now[:, :, None] * about_z[:, None, :])
        # damping fades with the error: safe far away, quadratic convergence close by
        JJ = J @ J.swapaxes(1, 2) + damping * np.minimum(1.0, size)[:, None, None] + 1e-12 * np.eye(6)
        step = np.einsum("nij,ni->nj", J, np.linalg.solve(JJ, error[:, :, None])[:, :, 0])
        if rest is not None and iteration < _RESTING_STEPS:
            drawn = _REST_GAIN * (rest[active] - q[active])
            moved = np.einsum("nij,nj->ni", J, drawn)
            step += drawn - np.einsum("nij,ni->nj", J, np.linalg.solve(JJ, moved[:, :, None])[:, :, 0])
        largest = np.abs(step).max(axis=1)
        q[active] += step * np.minimum(1.0, _LARGEST_STEP / np.maximum(largest, 1e-12))[:, None]
    return q, converged


def solve_pose(chain: Chain, p: Array, R: Array, start: Array) -> tuple[Array, BoolArray]:
    """Joint angles for poses of tool0 near known ones.

    Args:
        p: wanted TCP in base_link, shape (n, 3), m. R: wanted rotation of tool0 into base_link, (n, 3, 3).
        start: joint angles nearby, shape (n, k), rad.

    Returns:
        joint angles (n, k), not wrapped to any limit, and whether each has converged to 1e-9 m (n,).
    """
    q = start.copy()
    converged = np.zeros(len(q), dtype=bool)
    active = np.arange(len(q))
    for _ in range(_NEARBY_STEPS):
        p_now, R_now, J = chain.forward(q[active])
        E = R[active] @ R_now.swapaxes(1, 2)
        turn = 0.5 * np.stack([E[:, 2, 1] - E[:, 1, 2], E[:, 0, 2] - E[:, 2, 0], E[:, 1, 0] - E[:, 0, 1]], axis=1)
        error = np.concatenate([p[active] - p_now, _ANGLE_WEIGHT * turn], axis=1)
        done = np.linalg.norm(error, axis=1) < _CONVERGED
        converged[active[done]] = True
        active, J, error = active[~done], J[~done], error[~done]
        if len(active) == 0:
            break
        J[:, 3:] *= _ANGLE_WEIGHT
        JJ = J @ J.swapaxes(1, 2) + 1e-12 * np.eye(6)
        step = np.einsum("nij,ni->nj", J, np.linalg.solve(JJ, error[:, :, None])[:, :, 0])
        q[active] += step * np.minimum(1.0, _LARGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
    return q, converged


def wrap_into_limits(q: Array, lower: Array, upper: Array, is_prismatic: BoolArray) -> Array:
    """Add whole turns to revolute joints so that each lies as near the middle of its range as possible, shape (n, k)."""
    middle = np.where(np.isfinite(lower) & np.isfinite(upper), 0.5 * (lower + upper), 0.0)
    turned = q - 2 * np.pi * np.round((q - middle) / (2 * np.pi))
    return np.where(is_prismatic, q, turned)
