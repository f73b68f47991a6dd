# SPDX-License-Identifier: Apache-2.0
"""What joint_trajectory_controller does with the points that it is sent: linear from where it is, held after the last one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .cell import Cell
from .kinematics import Array


class TrajectoryFollower:
    """Commands the cell along the newest trajectory; a new one replaces the rest of the one before."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._points: list[tuple[float, Array]] = []  # time on the cell's clock, positions of all axes

    @property
    def names(self) -> list[str]:
        """Axes in the order of the positions."""
        return [*self._cell.chain.joint_names, *self._cell.rail_names]

    def take(self, points: Sequence[tuple[float, Array]]) -> None:
        """Points as time from now, s, and positions of all axes (k,), rad and m."""
        q, rail = self._cell.commanded
        now = np.array([*q, rail] if self._cell.rail_names else q)
        begin = self._cell.time
        self._points = [(begin, now), *((begin + t, np.asarray(positions)) for t, positions in points)]

    def before_step(self) -> None:
        """Command where the cell is to be one period later."""
        if not self._points:
            return
        t, n = self._cell.time + self._cell.period, self._cell.chain.n
        times = [at for at, _ in self._points]
        wanted = np.array([np.interp(t, times, column) for column in np.array([x for _, x in self._points]).T])
        self._cell.command(wanted[:n], float(wanted[n]) if self._cell.rail_names else 0.0)
