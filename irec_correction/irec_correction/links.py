# SPDX-License-Identifier: Apache-2.0
"""Secondary encoders: what the gears have wound up is read behind them, in place of being predicted from the force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from irec_calibration.robot import Robot
from irec_calibration.typing import Array

from .filters import Filter
from .spring_chain import build_chain

LATE = 0.05  # s without a windup after which the last one is not believed
LARGEST = 0.01  # rad; no healthy gear winds up further


class Links:
    """Windup of all gears, filtered as the wrench is, and what it moves the TCP by.

    The model beside it has to be one of what lies beyond the encoders: identified from a session with link-side joint angles.
    """

    def __init__(self, robot: Robot, filters: Sequence[Filter], late: float = LATE, zeroed: bool = False) -> None:
        """Args: late: s without a windup after which the last one is not believed. zeroed: what the gears have wound up when the
        correction starts, without process, is taken off from then on."""
        self._filters, self._chain = list(filters), build_chain(robot)
        self._columns = [self._chain.index[f"joint_{k + 1}"] for k in range(robot.n_joints)]
        self._windup, self._seen = np.zeros(robot.n_joints), -np.inf
        self._late, self._zeroed = late, zeroed
        self._zero: Array | None = np.zeros(robot.n_joints)

    def start(self) -> None:
        """The correction starts."""
        if self._zeroed:
            self._zero = None

    def take(self, now: float, windup: Array) -> str:
        """Link-side minus motor-side angles, less what they are there without process, (k,), rad, at the time `now`, s.

        Returns:
            what is wrong with them, so that they are not believed; empty where nothing is.
        """
        if np.shape(windup) != self._windup.shape:
            return f"{np.size(windup)} windups came, the robot has {len(self._windup)} joints"
        if not np.isfinite(windup).all() or np.abs(windup).max() > LARGEST:
            return f"windups are {np.round(windup, 6).tolist()} rad; numbers of at most {LARGEST} rad are believed"
        for stage in self._filters:
            windup = stage.step(windup)
        if self._zero is None:
            self._zero = np.array(windup, dtype=float)
        self._windup, self._seen = np.asarray(windup, dtype=float) - self._zero, now
        return ""

    def is_late(self, now: float) -> bool:
        """Whether nothing that can be believed has come for too long."""
        return now - self._seen > self._late

    def displacement(self, q: Array) -> Array:
        """Of the TCP in base_link at motor-side angles q (k,), rad: (3,), m."""
        self._chain.update(q)
        twist = self._chain.J_at_base[:, self._columns] @ self._windup
        return np.asarray(twist[:3] + np.cross(twist[3:], self._chain.p_tcp))
