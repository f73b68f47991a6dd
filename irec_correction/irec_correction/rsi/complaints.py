# SPDX-License-Identifier: Apache-2.0
"""What somebody has to look at in the exchange with a controller: its pace, answers that are not taken, packets without Delay."""

from __future__ import annotations

REFUSED = 20  # cycles in a row that went wrong, to say so


class Complaints:
    """Counts what goes wrong in a row.

    Attributes:
        wrong: cycles in a row whose answer was not taken.
    """

    def __init__(self, cycle_ms: int) -> None:
        self._cycle_ms = cycle_ms
        self.wrong = 0
        self._even = self._uneven = 0  # packets on which IPOC went on by one cycle, and others

    def pace(self, regular: bool) -> None:
        """A packet came; whether IPOC went on by one cycle with it."""
        self._even = self._even + 1 if regular else 0
        self._uneven = 0 if self._even >= REFUSED // 2 else self._uneven + (not regular)

    def text(self, without_delay: bool) -> str:
        """Empty where nothing has to be looked at.

        Args:
            without_delay: the packet that was answered last carried no Delay.
        """
        if self._uneven >= REFUSED:
            return (
                f"IPOC does not go on by {self._cycle_ms} ms from packet to packet: check parameter cycle_ms (IPO_FAST: 4, "
                "IPO: 12), and whether somebody else sends packets; until then the offset is held"
            )
        if self.wrong >= REFUSED:
            return (
                f"the controller has not taken the last {REFUSED} answers or more: they come too late (latency in "
                "/diagnostics), get lost on the way back (firewall), or 'sentype' is not the SENTYPE of its ethernet XML"
            )
        if without_delay:
            return (
                "packets carry no Delay, so answers that are lost on the way to the controller are not seen, and after k of them "
                "the next one may be (k + 1) / 2 steps of the rate limit away: add DEF_Delay to SEND of the ethernet XML (irec "
                "rsi-config writes one)"
            )
        return ""
