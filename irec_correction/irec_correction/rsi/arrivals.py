# SPDX-License-Identifier: Apache-2.0
"""When packets of the sequence came: whether another IPOC is in its time."""

from __future__ import annotations

from collections import deque

EARLY = 2.0  # cycles by which an IPOC may be ahead of its time: the packet before it was held up on the way
LOOK_BACK = (4, 8)  # arrivals ago by which the time of an IPOC is judged; of one of them it must be
IPOC_WRAP = 1 << 32  # ms
_KEPT = 64


def cycles_between(before: int, after: int, cycle_ms: int) -> int:
    """Cycles from one IPOC to another, ms."""
    difference = after - before
    if difference < -IPOC_WRAP // 2:
        difference += IPOC_WRAP
    return round(difference / cycle_ms)


class Arrivals:
    """The last IPOCs, ms, and their times, s; one per half a cycle at most."""

    def __init__(self, cycle_ms: int) -> None:
        self._cycle_ms, self._cycle = cycle_ms, 1e-3 * cycle_ms
        self._kept: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def add(self, ipoc: int, now: float) -> None:
        """One of the sequence."""
        if not self._kept or now - self._kept[-1][1] >= 0.5 * self._cycle:
            self._kept.append((ipoc, now))

    def clear(self) -> None:
        """Judge the next ones by what comes from now on."""
        self._kept.clear()

    def are_behind(self, ipoc: int, now: float) -> bool:
        """Whether an IPOC is ahead of its time by all of LOOK_BACK, also where others led to it step by step."""
        return bool(self._kept) and all(
            self._ahead(*self._kept[-min(back, len(self._kept))], ipoc, now) > EARLY for back in LOOK_BACK
        )

    def were_overrun(self, ipoc: int, now: float, newest: int, newest_at: float) -> bool:
        """Whether an IPOC is in its time and a newer one that came before it was ahead: that one came from somebody else."""
        for then, at in reversed(self._kept):
            steps = cycles_between(then, ipoc, self._cycle_ms)
            if steps >= 1:
                in_time = abs(self._ahead(then, at, ipoc, now)) <= EARLY + 0.5 * steps
                return in_time and self._ahead(then, at, newest, newest_at) > EARLY
        return False

    def back_to(self, ipoc: int) -> None:
        """Forget this IPOC and newer ones."""
        while self._kept and cycles_between(self._kept[-1][0], ipoc, self._cycle_ms) <= 0:
            self._kept.pop()

    def _ahead(self, then: int, at: float, ipoc: int, now: float) -> float:
        """Cycles by which an IPOC that comes now is ahead of its time, by another one and its time."""
        return cycles_between(then, ipoc, self._cycle_ms) - (now - at) / self._cycle
