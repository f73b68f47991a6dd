# SPDX-License-Identifier: Apache-2.0
"""Force control over positions: v = (f_read - f_asked) / (K T), limited in speed, along x, y, z of tool0.

It waits for a robot that is late, or whose states come late: what is sent ahead of where the robot is would be pressed once it
gets there.
"""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .moves import Planner
from .settings import Settings

DAMPING = 1e-6  # of the pseudo-inverse
LEAD_SHARE = 0.1  # of the set point: what the way that was sent and not gone yet may add to the force, by contact_stiffness
LEAD_WAIT = 0.5  # s after which a robot that stays behind is not late: its servo gives way by that under the load


class ForceControl:
    """Of one robot; forces are N, of the environment on the robot in tool0, (3,). Times are s of one clock."""

    def __init__(self, planner: Planner, settings: Settings) -> None:
        self._planner, self._settings = planner, settings
        self._gives_way = np.zeros(3)  # m by which the robot stays behind under the load, in tool0
        self._waits: float | None = None  # since when it waits for the robot

    def begin(self) -> None:
        """The robot was switched to force control."""
        self._gives_way, self._waits = np.zeros(3), None

    def step(self, now: float, dt: float, base: Array, reported: Array, force: Array, asked: Array) -> Array:
        """Positions to be sent next (k,), from those sent last; MoveError: one would be beyond its limit."""
        s, n = self._settings, self._planner.n
        v = (force - asked) / (s.contact_stiffness * s.force_time)
        size = float(np.linalg.norm(v))
        v *= min(1.0, s.contact_speed / size) if size > 0.0 else 1.0
        _, R, J = self._planner.chain.forward(base[None, :n])
        ahead = R[0].T @ J[0, :3] @ (base - reported)[:n]  # m, in tool0
        v *= self._patience(now, v, ahead, asked)
        stepped = base.copy()
        stepped[:n] += inverse(J[0]) @ np.concatenate([R[0] @ v * dt, np.zeros(3)])
        self._planner.refuse_beyond_limits(stepped)
        return stepped

    def _patience(self, now: float, v: Array, ahead: Array, asked: Array) -> float:
        """Share of the velocity v (3,) at which to go on, `ahead` (3,), m, of where the robot is; from half the limit on less."""
        s = self._settings
        limit = LEAD_SHARE * max(float(np.linalg.norm(asked)), s.touch) / s.contact_stiffness
        lead = ahead - self._gives_way
        share = 2.0 - 2.0 * float(np.linalg.norm(lead)) / limit if v @ lead > 0.0 else 1.0
        if share > 0.05:
            self._waits = None
        elif self._waits is None:
            self._waits = now
        elif now - self._waits > LEAD_WAIT:
            self._gives_way, self._waits = ahead, None
        return min(1.0, max(0.0, share))


def inverse(J: Array) -> Array:
    """Damped pseudo-inverse (k, 6) of a Jacobian (6, k)."""
    return np.asarray(J.T @ np.linalg.inv(J @ J.T + DAMPING * np.eye(6)))
