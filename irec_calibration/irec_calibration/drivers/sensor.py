# SPDX-License-Identifier: Apache-2.0
"""Raw readings of a force sensor, believed while they are new, in one frame, and of now."""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from ..procedure.inputs import LARGEST_FORCE
from ..typing import Array
from .reported import LARGEST_LAG

SAME = 5  # readings that are equal to the last bit; fewer may come of a broadcaster that is quicker than its sensor
HELD_BACK = 0.5  # s for which equal readings are passed on


class RawReadings:
    """Of one sensor. Times are s.

    Attributes:
        at: when the newest reading that said something new was taken, by the driver's clock; None: never.
        problem: why the last reading was not believed or says nothing new; empty where it does.
    """

    def __init__(self, frame: str, links: Set[str]) -> None:
        """frame: the link in which the cell file says that it measures. links: of the robot description."""
        self._frame, self._links = frame, links
        self._named: str | None = None  # frame_id of the first reading
        self._last: Array | None = None
        self._same, self._stamp = 0, -np.inf
        self.at: float | None = None
        self.problem = ""

    def take(self, now: float, clock: float, stamp: float, frame: str, reading: Array) -> bool:
        """Whether to use a reading (6,), N and N m, and pass it on; `at` stays where it repeats the one before.

        Args:
            now: by the driver's clock. clock: now, on the clock of the stamps. frame: frame_id of the reading.
        """
        self.problem = self._wrong(clock, stamp, frame, reading)
        if self.problem:
            return False
        self._stamp = stamp
        taken = now - max(clock - stamp, 0.0)
        if self._last is None or not np.array_equal(reading, self._last):
            self._last, self._same, self.at = reading, 1, taken
            return True
        self._same += 1
        if self._same < SAME or self.at is None:
            self.at = taken
            return True
        held = taken - self.at
        self.problem = (
            f"the force sensor repeats one reading to the last bit, {self._same} times until now: it or its driver has stopped"
            " measuring, or holds readings back (a dead band?)"
        )
        return held <= HELD_BACK

    def _wrong(self, clock: float, stamp: float, frame: str, reading: Array) -> str:
        if not np.isfinite(reading).all():
            return f"the force sensor reads {reading}, finite numbers are needed"
        if np.abs(reading).max() > LARGEST_FORCE:
            return f"the force sensor reads {reading}, more than {LARGEST_FORCE:g} N or N m can't be"
        if self._named is None:
            if frame != self._frame and frame in self._links:
                return f"the force sensor's readings are in '{frame}' by their frame_id, the cell file says '{self._frame}'"
            self._named = frame
        if frame != self._named:
            return f"the force sensor's readings were in '{self._named}' by their frame_id, and now are in '{frame}'"
        if stamp > clock + LARGEST_LAG:
            return f"a reading of the force sensor is stamped {stamp - clock:.1f} s ahead of the clock, limit {LARGEST_LAG:g} s"
        if self._stamp - LARGEST_LAG < stamp <= self._stamp:
            return f"a reading of the force sensor with stamp {stamp:.3f} s came after that of {self._stamp:.3f} s"
        return ""
