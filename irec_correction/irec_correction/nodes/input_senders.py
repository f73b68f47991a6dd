# SPDX-License-Identifier: Apache-2.0
"""Whether an input has more than one publisher: two that agree hide it, of two that do not nobody knows which one is true."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

GRACE = 1.0  # s: where a publisher is started anew there may be two for a moment
LOOK = 0.1  # s between two looks at the graph
FORGET = 10.0  # s after which joint states that are none of this robot's count no more


def two_senders(others: str) -> str:
    """Why a node is not activated: `others`, as `InputSenders.found` tells them, send an input."""
    return (
        f"an input has more than one sender: {others}; end the other one"
        " (one that was killed is forgotten after half a minute at most)"
    )


class InputSenders:
    """Publishers of the inputs of one node. Times in s, CLOCK_MONOTONIC."""

    def __init__(
        self, others: Callable[[str, int], str], alone: Sequence[str], joints: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """others: who publishes a topic beside so many, for people. alone: topics that one node may publish. joints: topic of the
        joint states, on which others may publish joints that are not of this robot; empty: none is taken."""
        self._others, self._alone, self._joints, self._clock = others, tuple(alone), joints, clock
        self._topics = (*self._alone, *([joints] if joints else []))
        self._since: dict[str, float] = {}
        self._strangers: dict[tuple[str, ...], float] = {}
        self._looked, self._found = -LOOK, ""

    def saw_strangers(self, names: Sequence[str]) -> None:
        """Joint states without any joint of this robot came in: who sends them is no other sender of those of the robot."""
        self._strangers[tuple(names)] = self._clock()

    def found(self) -> str:
        """Who has been publishing an input beside another for longer than GRACE; empty where nobody has."""
        now = self._clock()
        if now - self._looked >= LOOK:
            self._looked = now
            texts = [text for topic in self._topics if (text := self._lasting(topic, now))]
            self._found = "; ".join(texts)
        return self._found

    def found_at_start(self, sleep: Callable[[float], None] = time.sleep) -> str:
        """The same before anything has come in: waits for GRACE where there are two. Of joint states that can't be known yet."""
        end = self._clock() + GRACE
        while self._clock() < end and any(self._others(topic, 1) for topic in self._alone):
            sleep(LOOK)
        texts = [text for topic in self._alone if (text := self._others(topic, 1))]
        self._looked = -LOOK  # what was found a moment ago may have gone since
        return "; ".join(texts) or self.found()

    def _lasting(self, topic: str, now: float) -> str:
        allowed = 1
        if topic == self._joints:
            self._strangers = {names: at for names, at in self._strangers.items() if now - at <= FORGET}
            allowed += len(self._strangers)
        text = self._others(topic, allowed)
        if not text:
            self._since.pop(topic, None)
            return ""
        return text if now - self._since.setdefault(topic, now) >= GRACE else ""
