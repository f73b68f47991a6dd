# SPDX-License-Identifier: Apache-2.0
"""The loop that must answer within the controller's cycle: one thread, one socket, nothing else in its interpreter.

An answer is ready before its packet comes: a quarter of a cycle ahead the newest wrench goes through the chain, and the packet
only brings the IPOC. So the time to answer is hardly more than that of an echo, at the price of joint angles from the packet
before.

Late packets: when several wait in the socket, the loop was held up; only the newest is answered (the controller has counted
the others as late already, and an answer with their IPOC would be refused). RKorr is absolute, so a lost answer costs
nothing with HOLDON=1: the controller goes on with the last one. A packet from anybody but the peer is dropped and counted.
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
from .codec import RobotPacket, decode_robot, encode_correction, encode_ipoc, ipoc_of
from .sources import OffsetSource

PACKET_SIZE = 4096
IDLE = 0.1  # s without a packet: look for commands all the same
AHEAD = 0.25  # of a cycle by which an answer is ready before its packet
LATE = 0.5  # of a cycle after which a packet may have another one behind it
RESTART = 150  # cycles of silence after which the controller, with its time-out of 100, has stopped RSI for sure
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
        self._ready = encode_correction(np.zeros(3), np.zeros(3), link.sentype)
        self._sent = np.zeros(3), np.zeros(3)
        self._next = self._sent
        self._is_ready = True
        self._due = -math.inf
        self._idle = 0

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Answer until `goes_on` (asked after each packet or idle time) says no."""
        while goes_on():
            self.once()

    def once(self) -> bool:
        """Get an answer ready, wait for a packet, answer it; False after idle time or a packet that is not answered."""
        if not self._is_ready:
            self._get_ready()
        try:
            packet, sender = self._socket.recvfrom(PACKET_SIZE)
        except BlockingIOError:
            self._wait_on()
            return False
        began = time.perf_counter()
        if time.monotonic() > self._due + LATE * 1e-3 * self._cycle_ms:  # in time there can be no other one behind it
            packet, sender = self._newest(packet, sender)
        if sender[0] != self.link.peer:
            self.counts.foreign += 1
            return False
        ipoc = ipoc_of(packet)
        if ipoc is None:
            self.counts.bad += 1
            return False
        self._follow(ipoc)
        self._socket.sendto(self._ready + encode_ipoc(ipoc), sender)
        c = self.counts
        c.latency[c.answered % KEPT] = time.perf_counter() - began
        c.answered += 1
        self._sent, self._is_ready = self._next, False
        self._due = time.monotonic() + 1e-3 * self._cycle_ms
        self._learn(packet)
        return True

    def _get_ready(self) -> None:
        """Wait until shortly before the next packet, then compute. A packet that comes sooner gets the answer before again."""
        wait = self._due - AHEAD * 1e-3 * self._cycle_ms - time.monotonic()
        if select.select([self._socket], [], [], max(0.0, wait))[0]:
            return
        self._next = self.source.offset(time.monotonic())
        self._ready = encode_correction(*self._next, self.link.sentype)
        self._is_ready = True

    def _learn(self, packet: bytes) -> None:
        """Read the whole packet, after it has been answered."""
        now = time.monotonic()
        try:
            state = decode_robot(packet)
        except ProtocolError:
            self.counts.bad += 1
            return
        self.counts.late_there = state.late
        self.source.take(state, now)
        if self._report is not None:
            self._write_report(state, *self._sent, now)

    def _wait_on(self) -> None:
        """No packet came: after RESTART cycles the controller has stopped RSI, and will begin without any offset.

        Nothing is computed meanwhile: what would have been faded out by then would reach the robot in one step.
        """
        self._idle += 1
        if self._silent:
            self._restart()

    @property
    def _silent(self) -> bool:
        return self._idle * IDLE > RESTART * 1e-3 * self._cycle_ms

    def _restart(self) -> None:
        self.source.restart(time.monotonic())
        zero = np.zeros(3)
        self._next, self._ready, self._is_ready = (zero, zero), encode_correction(zero, zero, self.link.sentype), True

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

    def _follow(self, ipoc: int) -> None:
        last, self._last_ipoc = self._last_ipoc, ipoc
        was_silent, self._idle = self._silent, 0
        if last is None:
            return
        steps = (ipoc - last) / self._cycle_ms
        if steps < 0 or was_silent:
            self.counts.restarts += 1
            self._restart()
        elif steps > 1:
            self.counts.lost += round(steps) - 1

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
