# SPDX-License-Identifier: Apache-2.0
"""The offset that a driver applies: cut to its limits, held when one is late, faded out when none comes or two senders do."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..typing import Array
from .moves import MoveError

HOLD, SILENT, FADE = 0.020, 0.100, 0.5  # s: an offset is held, then missed, then faded to zero


class OffsetHold:
    """Of one robot. Times are s of one clock that never goes back.

    Attributes:
        applied: now, (6,): m and rotation vector, in base_link. late: times at which one was missing for longer than HOLD.
    """

    def __init__(self, limit: float, turn_limit: float) -> None:
        """limit, turn_limit: largest translation, m, and rotation, rad, that are applied."""
        self._limits = ((slice(0, 3), limit), (slice(3, 6), turn_limit))
        self.applied, self.late = np.zeros(6), 0
        self._wanted, self._at, self._missed = np.zeros(6), -math.inf, False
        self._share = 0.0
        self._fades = False  # on its way to zero: another sender's offset, or a later one, would be a step

    def take(self, translation: Sequence[float], turn: Sequence[float], now: float) -> None:
        """A new offset; what is beyond the limits is cut, and none is taken on the way to zero. MoveError: it is no transform."""
        wanted = np.array([*translation, *turn], dtype=float)
        if not np.isfinite(wanted).all():
            raise MoveError(f"offset {wanted} is no transform")
        for part, limit in self._limits:
            size = float(np.linalg.norm(wanted[part]))
            wanted[part] *= min(1.0, limit / size) if size > 0.0 else 1.0
        if not self._fades:
            self._wanted, self._at, self._missed = wanted, now, False

    def fade(self) -> None:
        """Nobody knows whose offset holds: keep the last one, fade it out, and follow nobody before it is at zero."""
        self._fades = True

    def drop(self) -> None:
        """Begin at zero again; `applied` is what the last tick has applied."""
        self._share = 0.0

    def tick(self, now: float, dt: float, active: bool) -> Array:
        """What is to be applied now, (6,); zero where it is not active."""
        age = now - self._at
        self._fades = self._share > 0.0 and (self._fades or age > SILENT)
        if not active:
            self._share = 0.0
        elif not self._fades and age <= SILENT:
            if age > HOLD and not self._missed:
                self._missed = True
                self.late += 1
            self._share = min(1.0, self._share + dt / FADE)
        else:
            self._share = max(0.0, self._share - dt / FADE)
        self.applied = self._share * self._wanted
        return self.applied
