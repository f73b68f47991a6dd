# SPDX-License-Identifier: Apache-2.0
"""The controller's side of KUKA RSI (ETHERNET object): sends its state once per cycle, wants the same IPOC back before the
next one.

As on the KRC: an answer with another IPOC than that of the running cycle is late, late cycles are counted (`Delay`), with
HOLDON=1 the last correction is kept meanwhile, and after `timeout` late cycles in a row RSI stops and so does the robot. What is
not described in public can be chosen: `Delay`.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import SimError

Array = NDArray[np.float64]

_ANSWER = re.compile(
    rb'<Sen\s+Type="(\w+)">.*?<RKorr\s+X="([^"]+)"\s+Y="([^"]+)"\s+Z="([^"]+)"\s+A="([^"]+)"\s+B="([^"]+)"\s+C="([^"]+)"\s*/>'
    rb".*?<IPOC>(\d+)</IPOC>",
    re.DOTALL,
)


@dataclass(frozen=True)
class RobotState:
    """What the controller measures.

    Attributes:
        q: A1..A6, (6,), rad. p_tcp: (3,), m. abc: A, B, C of the TCP, (3,), rad. external: E1, m.
    """

    q: Array
    p_tcp: Array
    abc: Array
    external: float = 0.0


@dataclass(frozen=True)
class Correction:
    """Absolute correction of RKorr: translation (3,), m, and A, B, C (3,), rad."""

    translation: Array
    abc: Array


@dataclass(frozen=True)
class Delay:
    """How late cycles are counted in the packets.

    Attributes:
        sent: the configuration has DEF_Delay. in_all: never set back; otherwise cycles in a row.
        lag: cycles by which it is behind.
        takes_late: an answer that comes one cycle late acts all the same, though it counts as late.
    """

    sent: bool = True
    in_all: bool = False
    lag: int = 0
    takes_late: bool = False


@dataclass
class Faults:
    """What goes wrong next; each counts down.

    Attributes:
        lose_sent, lose_answers: packets that vanish on the way there and back. hold_back: s by which the next packet leaves late.
        late_answers: answers that arrive after their cycle. double_sent: packets that arrive twice. old_again: packets after
            which the one before arrives once more.
    """

    lose_sent: int = 0
    lose_answers: int = 0
    hold_back: float = 0.0
    late_answers: int = 0
    double_sent: int = 0
    old_again: int = 0

    def happens(self, name: str) -> bool:
        """Whether this one happens now; counts it down."""
        left = getattr(self, name)
        setattr(self, name, max(0, left - 1))
        return bool(left > 0)


@dataclass
class LinkCounts:
    """What happened so far.

    Attributes:
        answered: cycles answered in time. late: the others, in all; late_in_a_row: now. too_late: answers to an earlier cycle.
        wrong: answers of another type or with an IPOC that was never sent. latency: s, of each answer in time.
    """

    cycles: int = 0
    answered: int = 0
    late: int = 0
    late_in_a_row: int = 0
    most_late_in_a_row: int = 0
    too_late: int = 0
    wrong: int = 0
    latency: list[float] = field(default_factory=list, repr=False)


class RsiController:
    """One RSI session. `cycle()` is one interpolation cycle; the caller moves the robot between cycles."""

    def __init__(
        self,
        peer: tuple[str, int],
        address: str = "127.0.0.1",
        period: float = 0.004,
        timeout: int = 100,
        holdon: bool = True,
        limit: float = 5e-3,
        sentype: str = "IREC",
        first_ipoc: int = 4_208_000_000,
        delay: Delay | None = None,
    ) -> None:
        """Open the socket.

        Args:
            peer: the PC that answers. timeout: late packets in a row after which RSI stops. limit: of POSCORR, m; beyond it
                RSI stops.
            holdon: keep the last correction while answers are late; otherwise it drops to zero.
            delay: None: counted in a row, at once.
        """
        self.peer, self.period, self.timeout, self.holdon, self.limit, self.sentype = (
            peer,
            period,
            timeout,
            holdon,
            limit,
            sentype,
        )
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((address, 0))
        self.ipoc = first_ipoc
        self.counts, self.faults = LinkCounts(), Faults()
        self.correction = Correction(np.zeros(3), np.zeros(3))
        self.acted: list[Array] = [np.zeros(3)]  # translation of the correction that acted in each cycle, m
        self.stopped = ""
        self._delay = delay or Delay()
        self._delays = [0]  # one per cycle
        self._before = b""
        self._underway: bytes | None = None  # an answer that arrives in the next cycle

    def start_again(self, pause: int = 50) -> None:
        """RSI off, and on again after `pause` cycles, which are waited for: no correction acts."""
        time.sleep(pause * self.period)
        self.ipoc += pause * round(self.period * 1000)
        self.correction = Correction(np.zeros(3), np.zeros(3))
        self.stopped, self.counts.late_in_a_row = "", 0
        self.acted.append(np.zeros(3))
        self._delays = [self._delays[-1] if self._delay.in_all else 0]

    def cycle(self, state: RobotState, until: float) -> Correction:
        """Send the state, wait for its answer until `until` (time.perf_counter, s), and give the correction that acts now.

        Raises:
            SimError: RSI has stopped.
        """
        if self.stopped:
            raise SimError(f"RSI has stopped: {self.stopped}")
        self.ipoc += round(self.period * 1000)
        self.counts.cycles += 1
        if self.faults.hold_back:
            time.sleep(self.faults.hold_back)
            self.faults.hold_back = 0.0
        sent = time.perf_counter()
        self._send(self.packet(state))
        answer = self._answer(until)
        self.count(answer is not None)
        c = self.counts
        if answer is None:
            if not self.holdon:
                self.correction = Correction(np.zeros(3), np.zeros(3))
            if c.late_in_a_row >= self.timeout:
                self.stopped = f"{c.late_in_a_row} packets in a row were late"
            self.acted.append(self.correction.translation)
            return self.correction
        c.latency.append(time.perf_counter() - sent)
        if float(np.abs(answer.translation).max()) > self.limit:
            self.stopped = f"correction of {np.abs(answer.translation).max() * 1e3:.2f} mm is beyond the limit of POSCORR"
            return self.correction
        self.correction = answer
        self.acted.append(answer.translation)
        return answer

    def _send(self, packet: bytes) -> None:
        if self.faults.happens("lose_sent"):
            return
        self._socket.sendto(packet, self.peer)
        if self.faults.happens("double_sent"):
            self._socket.sendto(packet, self.peer)
        if self.faults.happens("old_again") and self._before:
            self._socket.sendto(self._before, self.peer)
        self._before = packet

    def count(self, in_time: bool) -> None:
        """A cycle is over: whether its answer came in time."""
        c = self.counts
        if in_time:
            c.answered += 1
            c.late_in_a_row = 0
        else:
            c.late += 1
            c.late_in_a_row += 1
            c.most_late_in_a_row = max(c.most_late_in_a_row, c.late_in_a_row)
        self._delays.append(c.late if self._delay.in_all else c.late_in_a_row)

    def packet(self, state: RobotState) -> bytes:
        """The bytes of one cycle."""
        x, y, z = (1e3 * state.p_tcp).tolist()
        a, b, c = np.degrees(state.abc).tolist()
        pose = f'X="{x:.4f}" Y="{y:.4f}" Z="{z:.4f}" A="{a:.4f}" B="{b:.4f}" C="{c:.4f}"'
        joints = " ".join(f'A{i}="{v:.6f}"' for i, v in enumerate(np.degrees(state.q).tolist(), 1))
        count = self._delays[-1 - min(self._delay.lag, len(self._delays) - 1)]
        delay = f'<Delay D="{count}"/>' if self._delay.sent else ""
        return (
            f'<Rob Type="KUKA"><RIst {pose}/><RSol {pose}/><AIPos {joints}/><ASPos {joints}/>'
            f'<EIPos E1="{1e3 * state.external:.4f}" E2="0.0" E3="0.0" E4="0.0" E5="0.0" E6="0.0"/>'
            f"{delay}<IPOC>{self.ipoc}</IPOC></Rob>"
        ).encode("ascii")

    def _answer(self, until: float) -> Correction | None:
        data, self._underway = self._underway, None
        while True:
            correction = self._read(data) if data is not None else None
            if correction is not None:
                return correction
            left = until - time.perf_counter()
            if left <= 0.0:
                return None
            self._socket.settimeout(left)
            data = None
            try:
                data, _ = self._socket.recvfrom(4096)
            except (TimeoutError, ConnectionRefusedError):
                continue
            if self.faults.happens("lose_answers"):
                data = None
            elif self.faults.happens("late_answers"):
                self._underway, data = data, None

    def _read(self, data: bytes) -> Correction | None:
        """An answer to the running cycle; others are counted."""
        read = _ANSWER.search(data)
        if read is None or read[1].decode() != self.sentype or int(read[8]) > self.ipoc:
            self.counts.wrong += 1
            return None
        values = np.array([float(v) for v in read.groups()[1:7]])
        correction = Correction(1e-3 * values[:3], np.radians(values[3:]))
        if int(read[8]) < self.ipoc:
            self.counts.too_late += 1
            if self._delay.takes_late:
                self.correction = correction
            return None
        return correction

    def run(self, cycles: int, state: Callable[[], RobotState], act: Callable[[Correction], None] = lambda _: None) -> None:
        """Cycles in real time.

        Where this process is held up, which no controller is, a cycle gets longer, not the time to answer shorter.

        Args:
            state: asked at the beginning of each cycle.
            act: told the correction at the end of each one that was answered in time.
        """
        due = time.perf_counter()
        for _ in range(cycles):
            due += self.period
            answered, now = self.counts.answered, state()
            until = max(due, time.perf_counter() + 0.75 * self.period)
            correction = self.cycle(now, until)
            if self.counts.answered > answered:
                act(correction)
            if self.stopped:
                return
            due = max(due, time.perf_counter())
            time.sleep(max(0.0, due - time.perf_counter()))

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
