# SPDX-License-Identifier: Apache-2.0
"""Stamps for readings that arrive late and in bursts: their own clock brought to the machine's, and how late each came.

A reading arrives after it was taken, never before: arrival = t + offset + delay with delay >= least delay. The smallest
arrival - t within a window is the offset plus the least delay of the way; what is left is that least delay, which no receiver
can see and which the user states (`delay`), e.g. from `irec export --align`.
"""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass, field

from .tracker_stream import StreamError

WINDOW = 60.0  # s over which the two clocks are compared
DRIFT_WINDOW = 5.0  # s: within this the clocks run alike
BREAK = 1.5  # periods that a counted stream may be silent beyond a burst before it is counted anew
SHOWN = 200  # readings of which the lateness is shown


@dataclass
class Restamper:
    """Stamps of one stream.

    Attributes:
        period: s between readings of a stream that sends no time of its own; 0: it sends one.
        delay: least delay of the way, s. longest_burst: s that readings may be held up together.
    """

    period: float = 0.0
    delay: float = 0.0
    longest_burst: float = 0.5
    late: deque[float] = field(default_factory=lambda: deque(maxlen=SHOWN), repr=False)
    _least: deque[tuple[float, float]] = field(default_factory=deque, repr=False)  # (t of the slot, smallest arrival - t)
    _count: int = 0
    _last_arrival: float = -1e18
    _last: float = -1e18
    _last_t: float = -1e18

    def __post_init__(self) -> None:
        if self.period < 0.0 or not 0.0 <= self.delay < 2.0 or not self.longest_burst > 0.0:
            raise StreamError(f"period {self.period} s, delay {self.delay} s, longest_burst {self.longest_burst} s: not possible")

    def stamp(self, arrival: float, t: float | None) -> float | None:
        """When a reading was taken, s of the machine's clock; None: not after the one before, so that it is left out.

        Args:
            arrival: s of the machine's clock. t: s of the tracker's clock, None where it sends none.
        """
        if t is None:
            if self.period <= 0.0:
                self._note(0.0)
                return self._in_order(arrival - self.delay)
            if arrival - self._last_arrival > self.longest_burst + BREAK * self.period:  # the beam was broken: count anew
                self._count = 0
                self._least.clear()
            self._last_arrival = arrival
            t = self._count * self.period
            self._count += 1
        elif t < self._last_t - 1.0:  # the tracker's clock was set
            self._least.clear()
        self._last_t = t
        offset = self._offset(arrival, t)
        self._note(arrival - t - offset)
        return self._in_order(t + offset - self.delay)

    def _offset(self, arrival: float, t: float) -> float:
        """Smallest arrival - t of the window, by slots, the newest slots first where the clocks drift apart."""
        new = arrival - t
        if self._least and t - self._least[-1][0] < DRIFT_WINDOW:
            since, least = self._least[-1]
            self._least[-1] = since, min(least, new)
        else:
            self._least.append((t, new))
        while len(self._least) > 1 and t - self._least[0][0] > WINDOW:
            self._least.popleft()
        newest = self._least[-1][1]
        if len(self._least) < 2:
            return newest
        # the slot before bridges the begin of a slot, in which the quickest reading has not come yet
        return min(newest, self._least[-2][1])

    @property
    def drift(self) -> float:
        """How much faster the tracker's clock runs than the machine's, s/s, over the window; 0 where it is too short to tell."""
        if len(self._least) < 3:
            return 0.0
        (t0, o0), (t1, o1) = self._least[0], self._least[-2]
        return -(o1 - o0) / (t1 - t0) if t1 > t0 else 0.0

    def _note(self, lateness: float) -> None:
        self.late.append(max(lateness, 0.0))

    def _in_order(self, stamp: float) -> float | None:
        if stamp <= self._last:
            return None
        self._last = stamp
        return stamp

    def lateness_text(self) -> str:
        """Lateness of the newest readings and drift of the clocks, for people."""
        if not self.late:
            return "no readings yet"
        ordered = sorted(self.late)
        worst, usual = ordered[-1], statistics.median(ordered)
        return (
            f"readings came {1e3 * usual:.0f} ms (median) to {1e3 * worst:.0f} ms (largest of {len(ordered)}) after the quickest"
            f" one; clocks drift by {1e6 * self.drift:.0f} ppm"
        )
