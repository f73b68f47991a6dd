# SPDX-License-Identifier: Apache-2.0
"""What `Delay` tells, the number of cycles without an answer that a controller puts into its packets.

Public descriptions do not say whether it counts cycles in a row or in all, nor whether it is a cycle behind: the first is found
out from how it goes on, the second is allowed for.
"""

from __future__ import annotations

from collections import deque

RECENT = 4  # packets
LAG = 1  # cycles by which Delay may be behind
TOLERANCE = 1  # cycles
UNCOUNTED = 6  # cycles that a session may not have counted; RSI is not stopped and started again within SHORTEST_PAUSE, 10


class DelayCount:
    """Learns from packet to packet.

    Attributes:
        rises: it has been seen to rise, so it counts.
    """

    def __init__(self) -> None:
        self.rises = False
        self._in_a_row: bool | None = None
        self._newest: deque[int] = deque(maxlen=RECENT)  # of packets of anybody
        self._then = (0, 0)  # smallest and largest of them when the last answer was given
        self._seen: bool | None = None  # what the last packet said of that; believed when nothing comes between it and the next

    def follow(self, last: int | None, delay: int | None, steps: int) -> bool:
        """Delay of two packets that are `steps` cycles apart; whether it has risen."""
        if delay is None or last is None:
            return False
        if self._seen is not None:
            self._in_a_row, self._seen = self._seen, None
        if delay > last:
            self.rises = True
        elif steps == 1 and last > 0:
            self._seen = delay < last
        return delay > last

    def hear(self, delay: int | None) -> None:
        """Delay of any packet, also of one that is not of the sequence."""
        if delay is not None:
            self._newest.append(delay)

    def answered(self) -> None:
        """An answer was given now: what the controller counts from, if one of the last packets was its own."""
        self._then = (min(self._newest, default=0), max(self._newest, default=0))

    def forget_last(self) -> None:
        """The last packet may have been somebody else's."""
        self._seen = None

    def since(self, then: int | None, delay: int | None) -> int:
        """Cycles without an answer that it has counted since a packet with `then`."""
        if delay is None or then is None:
            return 0
        return delay if self._in_a_row else delay - then

    def may_follow(self, last: int | None, delay: int | None, steps: int) -> bool:
        """Whether one controller can have said both, `steps` cycles apart: it counts no cycles that have not been."""
        if delay is None or last is None:
            return delay is last
        return delay - last <= steps + LAG + TOLERANCE

    def same_session(self, then: int | None, delay: int | None, cycles: int) -> bool | None:
        """Whether RSI has been running and counting since a packet with `then`, so many cycles ago; None: can't be told."""
        if delay is None or then is None or not self.rises:
            return None
        least = cycles - 1 - UNCOUNTED
        in_a_row = delay >= least
        low, high = min(then, self._then[0]), max(then, self._then[1])
        if not self._in_a_row and (delay - low >= least) != (delay - high >= least):
            return None  # one of the packets was not the controller's
        in_all = delay - then >= least
        if self._in_a_row is None:
            return in_a_row if in_a_row == in_all else None
        return in_a_row if self._in_a_row else in_all
