# SPDX-License-Identifier: Apache-2.0
"""Which socket of the controller is being answered: its port is kept for as long as packets come from it.

A controller may open another socket for each session, so another port of the same address is taken over, but only after the
present one has been silent and several packets came from the other. Packets of any other port change nothing meanwhile.
"""

from __future__ import annotations

import math

from .sequence import CONFIRM, RESTART, SHORTEST_PAUSE

KEPT_PORTS = 8


class PeerPort:
    """Keeps the port. All times on one steady clock, s.

    Attributes:
        port: that is being answered; None: none yet.
        is_fresh: it was silent for RESTART cycles before its first packet, so that its RSI session is new.
    """

    def __init__(self, cycle: float, now: float) -> None:
        """Args: cycle: of the controller, s. now: when listening began."""
        self.port: int | None = None
        self.is_fresh = False
        self._cycle = cycle
        self._last = -math.inf
        self._known_since = now  # a port that is in no table has been silent since then
        self._other_ports: dict[int, tuple[float, float]] = {}  # other port -> since when without a pause, and last packet
        self._served: dict[int, float] = {}  # port that was answered before -> last packet
        self._candidate: tuple[int, int] | None = None  # port, packets in a row

    def admit(self, port: int, now: float) -> bool:
        """Whether a packet of this port is one of the controller's; `port` may have changed by that."""
        if port == self.port:
            self._last = now
            self._candidate = None
            return True
        since = self._note(port, now)
        if self.port is not None:
            if not self._may_take_over(port, now):
                return False
            gone = now - RESTART * self._cycle
            self._served = {p: at for p, at in {**self._served, self.port: self._last}.items() if at > gone}
        self.is_fresh = since - self._known_since >= RESTART * self._cycle
        self.port, self._last, self._candidate = port, now, None
        del self._other_ports[port]
        return True

    def _may_take_over(self, port: int, now: float) -> bool:
        served = self._served.get(port)
        if served is not None and now - served < RESTART * self._cycle:
            self._served[port] = now  # its session may go on and hold what it was answered: it has to stop first
            return False
        if now - self._last < SHORTEST_PAUSE * self._cycle:
            self._candidate = None
            return False
        count = self._candidate[1] + 1 if self._candidate is not None and self._candidate[0] == port else 1
        self._candidate = port, count
        return count >= CONFIRM

    def _note(self, port: int, now: float) -> float:
        """Remember a packet of another port; since when it has been sending without a pause."""
        since, last = self._other_ports.get(port, (now, now))
        if now - last >= RESTART * self._cycle:
            since = now
        self._other_ports[port] = since, now
        if len(self._other_ports) > KEPT_PORTS:
            del self._other_ports[min(self._other_ports, key=lambda p: self._other_ports[p][1])]
            self._known_since = now
        return since
