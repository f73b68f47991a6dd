# SPDX-License-Identifier: Apache-2.0
"""Time that has passed in the cell, for time-outs: it can't be set, neither forwards nor back, by whoever sets the clock."""

from __future__ import annotations

import math

MAX_RATE = 100.0  # simulated s per s of the machine's clock that are believed
SLACK = 2.0  # s of the cell's clock by which one step may be ahead of that: a simulator sends what it has in bursts
STEP_BACK = 0.05  # s that a simulated clock may go back by; several threads of a simulator overtake each other
REAL_JUMP = 0.5  # s by which the clock of a real cell may leave the machine's steady clock between two steps
STILL = 6.0  # s of the machine's clock without a tick, after which the cell's clock stands still


class CellTime:
    """Elapsed time from the cell's clock, which may be set, and the machine's steady clock, which may not.

    In a real cell it is the steady clock. In a simulated one, which may run faster or slower than real time, it is what the
    cell's clock advances, each step bounded by MAX_RATE; a clock that stands still leaves it to the steady clock.

    Attributes:
        elapsed: s since the first look. still: the cell's clock does not move.
        jump: s by which the clock was set at the last look; 0 where it was not.
    """

    def __init__(self, simulated: bool) -> None:
        self._simulated = simulated
        self._now = self._steady = math.nan
        self._moved = 0.0  # steady clock when the cell's clock last moved
        self.elapsed = self.jump = 0.0
        self.still = False
        self._between = 0.0  # by how much the clock was set between two looks

    def was_set(self, now: float, steady: float) -> None:
        """The cell's clock jumped between two looks; the next one may find it where it was before. Arguments: see look."""
        self.look(now, steady)
        self._between = self.jump or self._between

    def look(self, now: float, steady: float) -> None:
        """now: the cell's clock, s. steady: the machine's, s."""
        if math.isnan(self._now):
            self._now, self._steady, self._moved = now, steady, steady
            return
        passed, really = now - self._now, steady - self._steady
        self._now, self._steady = now, steady
        if passed != 0.0:
            self._moved = steady
        self.still = steady - self._moved > STILL
        if self._simulated:
            most = MAX_RATE * really + SLACK
            self.jump = passed if not -STEP_BACK <= passed <= most else 0.0
            self.elapsed += really if self.still else min(max(passed, 0.0), most)
        else:
            self.jump = passed - really if abs(passed - really) > REAL_JUMP else 0.0
            self.elapsed += really
        self.jump, self._between = self.jump or self._between, 0.0
