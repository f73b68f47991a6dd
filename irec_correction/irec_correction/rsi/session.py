# SPDX-License-Identifier: Apache-2.0
"""The answers to a controller, packet by packet, without socket or clock.

An answer is computed before its packet comes. It is one tick of the source away from the one before it, and is sent only when
the controller's packet does not speak against that. Otherwise the controller gets what it may hold once more, and the source
goes on from there, from rest.
"""

from __future__ import annotations

import numpy as np

from .answers import Action, Answer
from .codec import encode_correction, encode_ipoc
from .sequence import Sequence
from .sources import OffsetSource


class RsiSession:
    """One source, one controller."""

    def __init__(self, source: OffsetSource, sentype: str, cycle_ms: int) -> None:
        self._source, self._sentype = source, sentype
        zero = Answer(np.zeros(3), np.zeros(3), encode_correction(np.zeros(3), np.zeros(3), sentype))
        self.sequence = Sequence(zero, cycle_ms)
        self.repeated = self.unanswered = 0
        self._ready: Answer | None = None
        self._action = Action.SILENT

    @property
    def wants_tick(self) -> bool:
        """An answer can be computed ahead."""
        return self._ready is None and self.sequence.in_session

    def tick(self, now: float) -> None:
        """Compute the next answer; now, s."""
        translation, rotation = self._source.offset(now)
        self._ready = Answer(translation, rotation, encode_correction(translation, rotation, self._sentype))

    def reply(self, ipoc: int, delay: int | None, now: float, is_fresh: bool = False) -> bytes | None:
        """Bytes to send now, if any; then call `finish`. Arguments as for `Sequence.judge`."""
        sequence = self.sequence
        action = sequence.judge(ipoc, delay, now, is_fresh)
        self._action = action
        if action is Action.SILENT:
            self.unanswered += 1
            return None
        answer = sequence.sent
        if action is Action.NEXT and self._ready is not None:
            answer, self._ready = self._ready, None
        elif action is Action.NEXT:  # it came before its answer was ready
            self._action = Action.HOLD
        sequence.gave(ipoc, delay, answer)
        return answer.text + encode_ipoc(ipoc)

    def finish(self, now: float) -> None:
        """What follows from the last packet, after the answer has been sent; now, s."""
        if self._action is Action.START:
            self._source.start_session(now)
            self._ready = None
        elif self._action is Action.HOLD:
            self.repeated += 1
            sent = self.sequence.sent
            self._source.resynchronise(sent.translation, sent.rotation)
            self._ready = None
