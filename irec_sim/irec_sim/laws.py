# SPDX-License-Identifier: Apache-2.0
"""How single gears answer to torque: gear curves, play, friction, creep. Batched over rows (n) and joints (k).

Torques in N m, angles in rad. Each law gives an angle beside that of the linear spring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .kinematics import Array

SLIDER_LEVELS = np.array([0.25, 0.6, 1.0, 1.6])  # slip torques of the sliders, shares of friction_torque


@dataclass(frozen=True)
class GearCurve:
    """Measured curve of one gear: further compliance at given torques, in between linear, nothing beyond the last.

    The angle is its integral: a monotone quadratic spline through the table, odd in the torque.

    Attributes:
        joint: from 1; torque: rising from 0, (m,), N m; compliance: there, (m,), rad/(N m).
    """

    joint: int
    torque: Array
    compliance: Array

    def angle(self, tau: Array) -> Array:
        """Further angle, same shape as tau, rad."""
        t, c = np.asarray(self.torque, dtype=float), np.asarray(self.compliance, dtype=float)
        reached = np.r_[0.0, np.cumsum(0.5 * (c[1:] + c[:-1]) * np.diff(t))]
        size = np.minimum(np.abs(tau), t[-1])
        i = np.clip(np.searchsorted(t, size, side="right") - 1, 0, len(t) - 2)
        d = size - t[i]
        slope = (c[i + 1] - c[i]) / (t[i + 1] - t[i])
        return np.sign(tau) * (reached[i] + c[i] * d + 0.5 * slope * d * d)


def play(share: Array, sharpness: float) -> Array:
    """How far a play is taken up, -1 .. 1, at a torque of `share` times that at which it is: sharp edges for large sharpness."""
    return share / (1.0 + np.abs(share) ** sharpness) ** (1.0 / sharpness)


def presliding(
    tau: Array, compliance: Array, limit: Array, stiffness: Array, wound: Array, friction: Array
) -> tuple[Array, Array]:  # fmt: skip
    """Part of a gear that is wound up against dry friction with presliding, quasi-static.

    The spring of this part and the friction carry the torque together: tau = wound / compliance + friction. Friction follows the
    displacement as in the models of Dahl and LuGre: d friction / d wound = stiffness (1 - sign friction / limit).

    Args:
        tau, wound, friction: torque now, angle and friction torque before, (n, k).
        compliance, limit, stiffness: of the part, largest friction, friction per angle at rest, (k,); compliance > 0.

    Returns:
        angle and friction torque now.
    """
    ahead = tau - wound / compliance - friction
    way = np.where(ahead < 0.0, -1.0, 1.0)
    room = np.maximum(limit - way * friction, 0.0)
    decay = limit / stiffness
    u = np.zeros_like(ahead)
    for _ in range(30):  # concave and rising: Newton from 0 comes from one side
        left = np.exp(-u / decay)
        missing = np.abs(ahead) - u / compliance - room * (1.0 - left)
        step = missing / (1.0 / compliance + room / decay * left)
        u = u + step
        if np.abs(step).max() < 1e-15:
            break
    return wound + way * u, way * (limit - room * np.exp(-u / decay))


class Maxwell:
    """Gears as springs with several Maxwell branches beside them: at once as stiff as without, softer by a share in the end.

    In units of the strain x = compliance * torque that the gear has at once: x = s / (1 + share) + sum of branches m, each of
    stiffness w share / (1 + share) and relaxing with its own time.
    """

    def __init__(self, share: Array, weights: Array, times: Array) -> None:
        """share: (k,) > -1; weights: of the branches, (b,), sum 1; times: (b,), s."""
        self._end = 1.0 / (1.0 + share)
        self._branch = np.outer(share / (1.0 + share), weights)  # (k, b)
        rate = (self._branch[:, :, None] - np.eye(len(times))) / times  # dm/dt under constant torque, (k, b, b)
        self._rate, V = np.linalg.eig(rate)
        self._V, self._V_inverse = V, np.linalg.inv(V)

    def at_rest(self, x: Array) -> tuple[Array, Array]:
        """Strain and branches of a gear that has long carried x (n, k)."""
        return x / self._end, np.zeros((*x.shape, self._branch.shape[1]))

    def after(self, x: Array, strain: Array, branches: Array, dt: Array) -> tuple[Array, Array]:
        """Strain and branches when x (n, k) has been carried for dt (n,) s from a state on."""
        before = self._end * strain + branches.sum(axis=2)
        jumped = branches + self._branch * (x - before)[..., None]
        modes = (self._V_inverse @ jumped[..., None])[..., 0]
        relaxed = (self._V @ (np.exp(self._rate * dt[:, None, None]) * modes)[..., None])[..., 0].real
        return (x - relaxed.sum(axis=2)) / self._end, relaxed
