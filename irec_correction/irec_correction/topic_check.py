# SPDX-License-Identifier: Apache-2.0
"""The checks at the boundary for a stamped message that goes on to another process: frame, stamp, finiteness, plausible size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .figures import signed
from .watchdog import Fault, Finding


@dataclass(frozen=True)
class TopicCheck:
    """What a message has to fulfil.

    Attributes:
        what: for people, e.g. `wrench`. frame: that it has to come in. tolerance: between its stamp and now, s.
        largest: magnitude of any of its values, SI.
        bad_frame, bad_clock, bad_value: faults to be told.
    """

    what: str
    frame: str
    tolerance: float
    largest: float
    bad_frame: Fault
    bad_clock: Fault
    bad_value: Fault

    def finding(self, frame: str, stamp: float, now: float, values: Sequence[float]) -> Finding | None:
        """Why a message can't be used, with its value and limit; None where it can. Times on one clock, s."""
        if frame != self.frame:
            return Finding(self.bad_frame, f"{self.what} comes in frame '{frame}', '{self.frame}' is needed")
        away = stamp - now
        if not abs(away) <= self.tolerance:
            return Finding(self.bad_clock, f"{self.what} is stamped {signed(away, 3)} s from now, limit {self.tolerance:g} s")
        for v in values:
            if not math.isfinite(v):
                return Finding(self.bad_value, f"{self.what} holds {v}")
            if abs(v) > self.largest:
                return Finding(self.bad_value, f"{self.what} holds {v:g}, limit {self.largest:g}")
        return None
