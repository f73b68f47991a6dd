# SPDX-License-Identifier: Apache-2.0
"""The loop that must answer within the controller's cycle: one thread, one socket, nothing else in its interpreter.

Late packets: when several wait in the socket, the loop was held up; only the newest is answered (the controller has counted
the others as late already, and an answer with their IPOC would be refused). RKorr is absolute, so a lost answer costs
nothing with HOLDON=1: the controller goes on with the last one. A packet from anybody but the peer is dropped and counted.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from irec_calibration.typing import Array

from ..errors import CorrectionError, ProtocolError, SettingsError
from ..shared import SharedValues
from .codec import RobotPacket, decode_robot, encode_reply
from .sources import OffsetSource

PACKET_SIZE = 4096
IDLE = 0.1  # s without a packet: look for commands all the same
KEPT = 4096  # latencies over which the report's percentiles are taken


@dataclass(frozen=True)
class Link:
    """One interface and one peer.

    Attributes:
        address: of this machine on the robot's network, and port; never 0.0.0.0.
        peer: address of the controller; its port may change.
        sentype: name that the controller's ethernet XML expects.
    """

    address: str = "127.0.0.1"
    port: int = 59152
    peer: str = "127.0.0.1"
    sentype: str = "IREC"

    def __post_init__(self) -> None:
        for name, value in (("address", self.address), ("peer", self.peer)):
            try:
                packed = socket.inet_aton(value)
            except OSError:
                raise SettingsError(f"RSI {name} is '{value}'; an IPv4 address is needed") from None
            if packed == b"\0\0\0\0":
                raise SettingsError(f"RSI {name} is {value}; name one interface, the bridge never listens on all of them")
        if not 0 <= self.port <= 65535:
            raise SettingsError(f"RSI port is {self.port}; 0 .. 65535 is possible")


# report block, for monitoring: see LoopCounts.values
REPORT_SIZE = 30


@dataclass
class LoopCounts:
    """What happened on the link.

    Attributes:
        late_here: packets that waited behind a newer one; late_there: what the controller counts (Delay).
        lost: IPOC steps that never arrived; foreign: packets of somebody else; bad: unreadable; restarts: IPOC went back.
        latency: seconds from receipt to answer, the last KEPT ones.
    """

    answered: int = 0
    late_here: int = 0
    late_there: int = 0
    lost: int = 0
    foreign: int = 0
    bad: int = 0
    restarts: int = 0
    latency: Array = field(default_factory=lambda: np.zeros(KEPT))


class RsiLoop:
    """Receives, asks the source for an offset, answers. Blocks; run it as the only thread of its process."""

    def __init__(
        self,
        link: Link,
        source: OffsetSource,
        report: SharedValues | None = None,
        latency: SharedValues | None = None,
        cycle_ms: int = 4,
    ) -> None:
        """Open the socket.

        Args:
            report: block of REPORT_SIZE numbers for monitoring. latency: block of KEPT numbers, s from receipt to answer.
            cycle_ms: 4 (IPO_FAST) or 12 (IPO).

        Raises:
            CorrectionError: the address is not one of this machine's, or the port is taken.
        """
        self.link, self.source = link, source
        self.counts = LoopCounts() if latency is None else LoopCounts(latency=latency.numbers)
        self._report, self._cycle_ms = report, cycle_ms
        self._values = np.zeros(REPORT_SIZE)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((link.address, link.port))
        except OSError as error:
            self._socket.close()
            raise CorrectionError(f"RSI: can't listen on {link.address}:{link.port}: {error.strerror}") from error
        # a time-out of the system, not of Python: that one would add a poll() to each call, and wait in spite of MSG_DONTWAIT
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", 0, int(IDLE * 1e6)))
        self.port = self._socket.getsockname()[1]
        self._last_ipoc: int | None = None

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Answer until `goes_on` (asked after each packet or idle time) says no."""
        while goes_on():
            self.once()

    def once(self) -> bool:
        """Wait for one packet and answer it; False after idle time or a packet that is not answered."""
        try:
            packet, sender = self._socket.recvfrom(PACKET_SIZE)
        except BlockingIOError:
            return False
        began = time.perf_counter()
        packet, sender = self._newest(packet, sender)
        if sender[0] != self.link.peer:
            self.counts.foreign += 1
            return False
        try:
            state = decode_robot(packet)
        except ProtocolError:
            self.counts.bad += 1
            return False
        self._follow(state)
        now = time.monotonic()
        translation, rotation = self.source.offset(state, now)
        self._socket.sendto(encode_reply(translation, rotation, state.ipoc, self.link.sentype), sender)
        c = self.counts
        c.latency[c.answered % KEPT] = time.perf_counter() - began
        c.answered += 1
        if self._report is not None:
            self._write_report(state, translation, rotation, now)
        return True

    def _newest(self, packet: bytes, sender: tuple[str, int]) -> tuple[bytes, tuple[str, int]]:
        """The last packet of the peer that waits in the socket."""
        while True:
            try:
                newer, who = self._socket.recvfrom(PACKET_SIZE, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return packet, sender
            if who[0] != self.link.peer:
                self.counts.foreign += 1
                continue
            self.counts.late_here += sender[0] == self.link.peer
            packet, sender = newer, who

    def _follow(self, state: RobotPacket) -> None:
        last, self._last_ipoc = self._last_ipoc, state.ipoc
        if last is not None:
            steps = (state.ipoc - last) / self._cycle_ms
            if steps < 0:
                self.counts.restarts += 1
            elif steps > 1:
                self.counts.lost += round(steps) - 1
        self.counts.late_there = state.late

    def _write_report(self, state: RobotPacket, translation: Array, rotation: Array, now: float) -> None:
        c, v = self.counts, self._values
        v[0:9] = (
            now, c.answered, c.late_here, c.late_there, c.lost, c.foreign, c.bad, c.restarts, c.latency[(c.answered - 1) % KEPT]
        )  # fmt: skip
        v[9:12], v[12:15], v[15:21], v[21:24], v[24:27] = translation, rotation, state.q, state.p_tcp, state.abc
        v[27], v[28], v[29] = float(self.source.state), state.external[0], state.ipoc
        assert self._report is not None
        self._report.write(v)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
