# SPDX-License-Identifier: Apache-2.0
"""Whether a robot follows the positions that are sent to it, and whether they are such that it can."""

from __future__ import annotations

import numpy as np

from ..typing import Array

BEHIND = 0.3  # s for which positions may lag behind what was sent


class Following:
    """Keeps what was sent within the last BEHIND s, (k,) each, rad and m."""

    def __init__(self, limit: float) -> None:
        """limit: rad or m by which a reported position may be beyond all that was sent in that time."""
        self._limit = limit
        self._sent: list[tuple[float, Array]] = []

    @property
    def last(self) -> Array | None:
        """What was sent last; None: nothing yet."""
        return self._sent[-1][1] if self._sent else None

    def forget(self) -> None:
        """The robot was stopped, or moved by somebody else."""
        self._sent.clear()

    def sent(self, now: float, positions: Array) -> None:
        """Such positions were sent."""
        self._sent.append((now, positions))

    def leap(self, send: Array, reported: Array, allowed: Array) -> str:
        """Why these positions (k,) must not be sent: more than `allowed` (k,) from the last ones, or from where the robot is."""
        last = self.last
        start = reported if last is None else last
        fits = np.abs(send - start) <= allowed  # False for what is no number
        if fits.all():
            return ""
        k = int(np.argmin(fits))
        where = "reported" if last is None else "sent last"
        return f"axis {k + 1} would be sent to {send[k]:.4g}, {start[k]:.4g} was {where}, {allowed[k]:.3g} apart is the limit"

    def problem(self, now: float, reported: Array) -> str:
        """Why the robot does not follow; empty where it does, or nothing is known yet."""
        while len(self._sent) > 1 and self._sent[1][0] < now - BEHIND:
            self._sent.pop(0)
        if not self._sent or self._sent[0][0] > now - BEHIND:
            return ""
        low = np.min([s for _, s in self._sent], axis=0) - self._limit
        high = np.max([s for _, s in self._sent], axis=0) + self._limit
        off = np.maximum(low - reported, reported - high)
        k = int(np.argmax(off))
        if off[k] <= 0.0:
            return ""
        return (
            f"axis {k + 1} is at {reported[k]:.4f}, within the last {BEHIND:g} s it was sent to {self._sent[-1][1][k]:.4f}:"
            " the robot does not follow; is its trajectory controller active?"
        )
