# SPDX-License-Identifier: Apache-2.0
"""What `Delay` tells, the number of cycles without an answer that a controller puts into its packets.

Public descriptions do not say whether it counts cycles in a row or in all, nor whether it is a cycle behind: the first is found
out from how it goes on, the second is allowed for.
"""

from __future__ import annotations

LAG = 1  # cycles by which Delay may be behind
TOLERANCE = 1  # cycles


class DelayCount:
    """Learns from packet to packet.

    Attributes:
        rises: it has been seen to rise, so it counts.
    """

    def __init__(self) -> None:
        self.rises = False
        self._in_a_row: bool | None = None

    def follow(self, last: int | None, delay: int | None, steps: int) -> bool:
        """Delay of two packets that are `steps` cycles apart; whether it has risen."""
        if delay is None or last is None:
            return False
        if delay > last:
            self.rises = True
        elif steps == 1 and last > 0:
            self._in_a_row = delay < last
        return delay > last

    def since(self, then: int | None, delay: int | None) -> int:
        """Cycles without an answer that it has counted since a packet with `then`."""
        if delay is None or then is None:
            return 0
        return delay if self._in_a_row else delay - then

    def is_replay(self, first: int | None, delay: int | None, packets: int) -> bool:
        """A controller that gets no answer counts that; packets recorded earlier do not.

        Args:
            first, delay: of the first and the last of so many packets in a row that got no answer.
        """
        if not self.rises or delay is None or first is None:
            return False
        return delay - first < packets - 1 - LAG - TOLERANCE

    def same_session(self, then: int | None, delay: int | None, cycles: int) -> bool | None:
        """Whether RSI has been running and counting since a packet with `then`, so many cycles ago; None: can't be told."""
        if delay is None or then is None or not self.rises:
            return None
        least = cycles - 1 - LAG - TOLERANCE
        in_a_row, in_all = delay >= least, delay - then >= least
        if self._in_a_row is None:
            return in_a_row if in_a_row == in_all else None
        return in_a_row if self._in_a_row else in_all
