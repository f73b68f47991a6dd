# SPDX-License-Identifier: Apache-2.0
"""The loop that must answer within the controller's cycle: one thread, one socket, nothing else in its interpreter.

An answer is ready before its packet comes: a quarter of a cycle ahead the newest wrench goes through the chain, and the packet
only brings IPOC and Delay. So the time to answer is hardly more than that of an echo, at the price of joint angles from the
packet before. Everything else, reading the packet included, comes after the answer.

When several packets wait in the socket, the loop was held up; only the newest is answered (the controller has counted the
others as late already, and refuses an answer with their IPOC). What may be answered after late and lost packets: see sequence.py.
A packet from anybody but the peer, or from another port of it while its session goes on (peer.py), is dropped and counted.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from irec_calibration.typing import Array

from ..errors import CorrectionError, ProtocolError, SettingsError
from ..shared import SharedValues
from .codec import RobotPacket, decode_robot, stamp_of
from .peer import PeerPort
from .report import KEPT, REPORT_SIZE, WHERE
from .session import RsiSession
from .sources import OffsetSource

PACKET_SIZE = 4096
IDLE = 0.1  # s without a packet: look for commands all the same
AHEAD = 0.25  # of a cycle by which an answer is ready before its packet
LATE = 0.5  # of a cycle after which a packet may have another one behind it


@dataclass(frozen=True)
class Link:
    """One interface and one peer.

    Attributes:
        address: of this machine on the robot's network, and port; never 0.0.0.0.
        peer: address of the controller; its port may be another one in each session.
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


@dataclass
class LoopCounts:
    """What happened in the socket; `Sequence` counts what happened on the way.

    Attributes:
        late_here: packets that waited behind a newer one; late_there: what the controller counts (Delay).
        foreign: packets of another address or port; bad: unreadable.
        latency: seconds from receipt to answer, the last KEPT ones.
    """

    answered: int = 0
    late_here: int = 0
    late_there: int = 0
    foreign: int = 0
    bad: int = 0
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
        self._report, self._cycle = report, 1e-3 * cycle_ms
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
        self.session = RsiSession(source, link.sentype, cycle_ms)
        self.problem = ""
        self._due = -math.inf
        self._peer = PeerPort(self._cycle, time.monotonic())

    def run(self, is_running: Callable[[], bool]) -> None:
        """Answer until `is_running` (asked after each packet or idle time) says no."""
        while is_running():
            self.once()

    def once(self) -> bool:
        """Get an answer ready, wait for a packet, answer it; False after idle time or a packet that is not answered."""
        session = self.session
        if session.wants_tick:
            self._get_ready()
        try:
            packet, sender = self._socket.recvfrom(PACKET_SIZE)
        except BlockingIOError:
            return False
        began = time.perf_counter()
        now = time.monotonic()
        ours = self._is_peer(sender, now)
        # in time there can be no other one behind it; at the beginning the first one that came is needed, its Delay is 0
        if now > self._due + LATE * self._cycle and session.sequence.in_session:
            packet, sender, ours = self._newest(packet, sender, ours, now)
        if not ours:
            return False
        stamp = stamp_of(packet)
        if stamp is None:
            self.counts.bad += 1
            return False
        reply = session.reply(*stamp, now, self._peer.is_fresh)
        if reply is not None:
            self._socket.sendto(reply, sender)
            c = self.counts
            c.latency[c.answered % KEPT] = time.perf_counter() - began
            c.answered += 1
            now = time.monotonic()
            self._due = now + self._cycle
            session.finish(now)
        self._after(packet, stamp[0] == session.sequence.newest, now)
        return reply is not None

    def _is_peer(self, sender: tuple[str, int], now: float) -> bool:
        """Whether a packet is one of the controller's; counts it where it is not."""
        if sender[0] == self.link.peer:
            port = self._peer.port
            if sender[1] == port:
                self._peer.admit(port, now)
                return True
            if self._peer.admit(sender[1], now):
                self.session.sequence.other_peer()
                self._due = -math.inf
                return True
        self.counts.foreign += 1
        return False

    def _get_ready(self) -> None:
        """Wait until shortly before the next packet, then compute."""
        wait = self._due - AHEAD * self._cycle - time.monotonic()
        if not select.select([self._socket], [], [], max(0.0, wait))[0]:
            self.session.tick(time.monotonic())

    def _after(self, packet: bytes, in_sequence: bool, now: float) -> None:
        """Read the whole packet, after it has been answered; one of another time says nothing about the robot."""
        self.problem = self.session.sequence.problem
        if not in_sequence:
            return
        try:
            state = decode_robot(packet)
        except ProtocolError as error:
            self.counts.bad += 1
            self.problem = str(error)
            return
        self.counts.late_there = state.late
        self.source.take(state, now)
        if self._report is not None:
            self._write_report(self._report, state, now)

    def _newest(self, packet: bytes, sender: tuple[str, int], ours: bool, now: float) -> tuple[bytes, tuple[str, int], bool]:
        """The packet of the peer with the latest IPOC that waits in the socket, otherwise the one given; and whether it is the
        peer's."""
        while True:
            try:
                other, who = self._socket.recvfrom(PACKET_SIZE, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return packet, sender, ours
            if not self._is_peer(who, now):
                continue
            if not ours or who != sender:
                packet, sender, ours = other, who, True
            elif self.session.sequence.is_newer(stamp_of(packet), stamp_of(other)):
                self.counts.late_here += 1
                packet = other

    def _write_report(self, report: SharedValues, state: RobotPacket, now: float) -> None:
        c, v, session, s = self.counts, self._values, self.session, self.session.sequence
        sent = s.sent
        v[WHERE["now"]] = now
        v[WHERE["link"]] = (
            c.answered, c.late_here, c.late_there, s.lost, c.foreign, c.bad, s.sessions, s.duplicate, s.out_of_sequence,
            s.not_taken, session.repeated, session.unanswered,
        )  # fmt: skip
        self.source.report(v)
        v[WHERE["translation"]], v[WHERE["rotation"]] = sent.translation, sent.rotation
        v[WHERE["q"]], v[WHERE["p_tcp"]], v[WHERE["abc"]] = state.q, state.p_tcp, state.abc
        v[WHERE["external"]], v[WHERE["state"]] = state.external[0], float(self.source.state)
        report.write(v)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
