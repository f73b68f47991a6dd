# SPDX-License-Identifier: Apache-2.0
"""What is not yet wrong with an input but makes the correction worse than it has to be: readings that are old, another rate."""

from __future__ import annotations

from collections.abc import Sequence

from .figures import fixed

WINDOW = 1.0  # s
LATE = 0.05  # s: where even the youngest reading of a window was older, the offset is late by that
SLOW, FAST = 0.7, 1.4  # of the rate that the filters are designed for
LASTS = 3  # windows one after the other with another rate


class InputQuality:
    """Of the streams of one node. Times in s on one clock, given by the caller."""

    def __init__(self, rates: dict[str, float]) -> None:
        """rates: expected of each stream, Hz; 0: of any rate."""
        self._streams = {what: _Stream(rate) for what, rate in rates.items()}

    def take(self, what: str, stamp: float, now: float) -> None:
        """A reading of a stream came in."""
        self._streams[what].take(stamp, now)

    def cautions(self, now: float) -> Sequence[str]:
        """What somebody should look at, a sentence each; nothing of a stream that is silent, which others tell."""
        return [text for what, stream in self._streams.items() for text in stream.cautions(what, now)]


class _Stream:
    def __init__(self, expected: float) -> None:
        self._expected = expected
        self._begin(0.0)
        self._age, self._rate, self._odd = 0.0, expected, 0

    def _begin(self, now: float) -> None:
        self._began, self._count, self._youngest = now, 0, float("inf")

    def take(self, stamp: float, now: float) -> None:
        passed = now - self._began
        if passed >= WINDOW or passed < 0.0:
            if 0.0 <= passed < 2.0 * WINDOW and self._count:
                self._age, self._rate = self._youngest, self._count / passed
                self._odd = self._odd + 1 if self._expected and not SLOW <= self._rate / self._expected <= FAST else 0
            else:  # it was silent, or the clock was set
                self._age, self._odd = 0.0, 0
            self._begin(now)
        self._count += 1
        self._youngest = min(self._youngest, now - stamp)

    def cautions(self, what: str, now: float) -> list[str]:
        told: list[str] = []
        if not 0.0 <= now - self._began < 2.0 * WINDOW:
            return told
        if self._age > LATE:
            told.append(
                f"{what} is {fixed(1e3 * self._age, 0)} ms old when it comes in, more than {1e3 * LATE:.0f} ms: the offset is"
                " late by that; look for what delays it"
            )
        if self._odd >= LASTS:
            told.append(
                f"{what} comes {fixed(self._rate, 0)} times a second, the filters are designed for {self._expected:g}"
                " (wrench_rate): mend the one or the other"
            )
        return told
