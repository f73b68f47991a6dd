# SPDX-License-Identifier: Apache-2.0
"""The answers to a controller, packet by packet, without socket or clock.

An answer is computed before its packet comes. It is one tick of the source away from the one before it, and is sent only when
the controller's packet does not speak against that. Otherwise the controller gets what it may hold once more, and the source
goes on from there, from rest.
"""

from __future__ import annotations

import numpy as np

from .codec import encode_correction, encode_ipoc
from .holding import Answer, Holding, Verdict
from .sources import OffsetSource


class Conversation:
    """One source, one controller."""

    def __init__(self, source: OffsetSource, sentype: str, cycle_ms: int) -> None:
        self._source, self._sentype = source, sentype
        zero = Answer(np.zeros(3), np.zeros(3), encode_correction(np.zeros(3), np.zeros(3), sentype))
        self.holding = Holding(zero, cycle_ms)
        self.repeated = self.unanswered = 0
        self._ready: Answer | None = None
        self._verdict = Verdict.SILENT

    @property
    def wants_tick(self) -> bool:
        """An answer can be computed ahead."""
        return self._ready is None and self.holding.in_session

    def tick(self, now: float) -> None:
        """Compute the next answer; now, s."""
        translation, rotation = self._source.offset(now)
        self._ready = Answer(translation, rotation, encode_correction(translation, rotation, self._sentype))

    def reply(self, ipoc: int, delay: int | None, was_silent: bool) -> bytes | None:
        """Bytes to send now, if any; then call `settle`. Arguments as for `Holding.judge`."""
        holding = self.holding
        verdict = holding.judge(ipoc, delay, was_silent)
        self._verdict = verdict
        if verdict is Verdict.SILENT:
            self.unanswered += 1
            return None
        answer = holding.sent
        if verdict is Verdict.NEXT and self._ready is not None:
            answer, self._ready = self._ready, None
        elif verdict is Verdict.NEXT:  # it came before its answer was ready
            self._verdict = Verdict.STAND
        holding.gave(ipoc, delay, answer)
        return answer.text + encode_ipoc(ipoc)

    def settle(self, now: float) -> None:
        """What follows from the last verdict, after the answer has been sent; now, s."""
        if self._verdict is Verdict.BEGIN:
            self._source.restart(now)
            self._ready = None
        elif self._verdict is Verdict.STAND:
            self.repeated += 1
            sent = self.holding.sent
            self._source.settle(sent.translation, sent.rotation)
            self._ready = None
