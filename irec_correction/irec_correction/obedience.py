# SPDX-License-Identifier: Apache-2.0
"""Whether the driver does what it is sent: the offset that it reports to apply against those that were sent.

A driver is late, and a report lies between two ticks: one that is near any offset of the last LATENCY s is obedience.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from irec_calibration.typing import Array

from .figures import fixed

LATENCY = 0.3  # s that a driver may be late, with the way to it and back
LASTS = 1.0  # s for which it must differ: drivers fade an offset in over half a second after they had none
NEAR, SHARE = 3e-5, 0.15  # m, and of the offset: closer is obedience
KEPT = 2.0  # s of what was sent
CLOCK = 0.5  # s: a stamp that is further from now is not believed, the report then counts as one of now


class Obedience:
    """Offsets that were sent, and the reports about them. Times in s on one clock; vectors (3,), m, in base_link."""

    def __init__(self, latency: float = LATENCY, lasts: float = LASTS) -> None:
        self._latency, self._lasts = latency, lasts
        self._sent: deque[tuple[float, Array]] = deque()
        self._differs_since: float | None = None

    def reset(self) -> None:
        """Nothing is sent that somebody would have to obey."""
        self._sent.clear()
        self._differs_since = None

    def sent(self, now: float, offset: Array) -> None:
        """An offset was sent."""
        if self._sent and now < self._sent[-1][0]:  # the clock was set back
            self.reset()
        self._sent.append((now, offset))
        while self._sent[0][0] < now - KEPT:
            self._sent.popleft()

    def wrong(self, stamp: float, now: float, reported: Array) -> str:
        """What is wrong with a report, for people; empty where it fits or has differed for a short time only."""
        if not abs(stamp - now) <= CLOCK:
            stamp = now
        near = [v for t, v in self._sent if stamp - self._latency <= t <= stamp]
        if not near:
            return ""
        sent = np.array(near)
        away = np.linalg.norm(sent - reported, axis=1)
        limit = NEAR + SHARE * float(np.linalg.norm(sent, axis=1).max())
        if float(np.min(away)) <= limit:  # no number is none
            self._differs_since = None
            return ""
        if self._differs_since is None or now < self._differs_since:
            self._differs_since = now
        lasted = now - self._differs_since
        if lasted < self._lasts:
            return ""
        last = sent[-1]
        return (
            f"the driver reports offset {_mm(reported)} mm while {_mm(last)} mm was sent, for {lasted:.1f} s, limit"
            f" {fixed(1e3 * limit, 2)} mm: {_how(reported, last, limit)}; mend the driver, then activate again"
        )


def _mm(v: Array) -> str:
    return f"({', '.join(fixed(1e3 * x, 3) for x in v.tolist())})"


def _how(reported: Array, sent: Array, limit: float) -> str:
    """What a driver seems to do with the offset."""
    size, wanted = float(np.linalg.norm(reported)), float(np.linalg.norm(sent))
    if not math.isfinite(size):
        return "it reports no number"
    if size <= NEAR:
        return "it ignores it"
    for factor, does in ((2.0, "doubles it"), (-1.0, "applies it the other way round")):
        if float(np.linalg.norm(reported - factor * sent)) <= limit:
            return f"it {does}"
    if abs(size - wanted) <= limit:
        return "it turns it: is it in another frame?"
    if float(np.linalg.norm(np.cross(reported, sent))) <= limit * wanted and float(reported @ sent) > 0.0:
        return "it cuts it: is its limit below limit.translation?" if size < wanted else "it applies more"
    return "it applies another one"
