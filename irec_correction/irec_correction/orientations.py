# SPDX-License-Identifier: Apache-2.0
"""Collects standing readings of the raw sensor for the identification of the tool load, one orientation at a time."""

from __future__ import annotations

from collections import deque

import numpy as np
from irec_calibration.robot import Robot
from irec_calibration.sensors.tool_load import ToolLoadFit, identify_tool_load
from irec_calibration.typing import Array

from .errors import CorrectionError

WINDOW = 0.5  # s that are averaged
STILL = 5e-4  # rad within the window
FEWEST = 20  # readings in it


class Orientations:
    """The last half second of both inputs, and the orientations recorded from it."""

    def __init__(self, robot: Robot, R_sensor_in_tool: Array, gravity_in_base: tuple[float, float, float]) -> None:
        self._robot, self._R, self._gravity = robot, R_sensor_in_tool, gravity_in_base
        self._wrench: deque[tuple[float, Array]] = deque()
        self._q: deque[tuple[float, Array]] = deque()
        self.recorded: list[tuple[Array, Array]] = []

    def take_wrench(self, stamp: float, reading: Array) -> None:
        """A raw reading (6,), N and N m; stamp, s."""
        _append(self._wrench, stamp, reading)

    def take_joints(self, stamp: float, q: Array) -> None:
        """Joint angles (k,), rad."""
        _append(self._q, stamp, q)

    def record(self) -> int:
        """Average the last half second as one orientation; how many there are now.

        Raises:
            CorrectionError: the robot moved, or too little came in.
        """
        if len(self._wrench) < FEWEST or len(self._q) < 2 or self._wrench[-1][0] - self._wrench[0][0] < 0.8 * WINDOW:
            raise CorrectionError(f"only {len(self._wrench)} readings within {WINDOW} s; wait, or check the force sensor")
        q = np.array([v for _, v in self._q])
        moved = float(np.ptp(q, axis=0).max())
        if moved > STILL:
            raise CorrectionError(f"the robot moved by {moved:.5f} rad within {WINDOW} s, limit {STILL} rad; let it stand")
        self.recorded.append((q.mean(axis=0), np.mean([v for _, v in self._wrench], axis=0)))
        return len(self.recorded)

    def identify(self) -> ToolLoadFit:
        """Tool load from all orientations recorded so far. Raises SolveError."""
        q = np.array([q for q, _ in self.recorded]).reshape(-1, self._robot.n_joints)
        R = self._robot.kinematics(q).R_tool @ self._R if len(q) else np.zeros((0, 3, 3))
        return identify_tool_load(np.array([w for _, w in self.recorded]).reshape(-1, 6), R, self._gravity)


def _append(values: deque[tuple[float, Array]], stamp: float, value: Array) -> None:
    if values and not values[-1][0] <= stamp <= values[-1][0] + WINDOW:
        values.clear()  # the clock was set, or nothing came for long
    values.append((stamp, value))
    while values[-1][0] - values[0][0] > WINDOW:
        values.popleft()
