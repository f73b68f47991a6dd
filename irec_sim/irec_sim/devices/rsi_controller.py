# SPDX-License-Identifier: Apache-2.0
"""The controller's side of KUKA RSI (ETHERNET object): sends its state once per cycle, wants the same IPOC back before the
next one.

As on the KRC: late answers are counted (`Delay`), with HOLDON=1 the last correction is kept meanwhile, and after `timeout`
late packets in a row RSI stops and so does the robot.
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


@dataclass
class Faults:
    """What goes wrong next; each counts down.

    Attributes:
        lose_sent, lose_answers: packets that vanish on the way there and back. hold_back: s by which the next packet leaves late.
    """

    lose_sent: int = 0
    lose_answers: int = 0
    hold_back: float = 0.0


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
    ) -> None:
        """Open the socket.

        Args:
            peer: the PC that answers. timeout: late packets in a row after which RSI stops. limit: of POSCORR, m; beyond it
                RSI stops.
            holdon: keep the last correction while answers are late; otherwise it drops to zero.
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
        self.stopped = ""

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
        if self.faults.lose_sent:
            self.faults.lose_sent -= 1
        else:
            self._socket.sendto(self.packet(state), self.peer)
        answer = self._answer(until)
        c = self.counts
        if answer is None:
            c.late += 1
            c.late_in_a_row += 1
            c.most_late_in_a_row = max(c.most_late_in_a_row, c.late_in_a_row)
            if not self.holdon:
                self.correction = Correction(np.zeros(3), np.zeros(3))
            if c.late_in_a_row >= self.timeout:
                self.stopped = f"{c.late_in_a_row} packets in a row were late"
            return self.correction
        c.latency.append(time.perf_counter() - sent)
        c.answered += 1
        c.late_in_a_row = 0
        if float(np.abs(answer.translation).max()) > self.limit:
            self.stopped = f"correction of {np.abs(answer.translation).max() * 1e3:.2f} mm is beyond the limit of POSCORR"
            return self.correction
        self.correction = answer
        return answer

    def packet(self, state: RobotState) -> bytes:
        """The bytes of one cycle."""
        x, y, z = (1e3 * state.p_tcp).tolist()
        a, b, c = np.degrees(state.abc).tolist()
        pose = f'X="{x:.4f}" Y="{y:.4f}" Z="{z:.4f}" A="{a:.4f}" B="{b:.4f}" C="{c:.4f}"'
        joints = " ".join(f'A{i}="{v:.6f}"' for i, v in enumerate(np.degrees(state.q).tolist(), 1))
        return (
            f'<Rob Type="KUKA"><RIst {pose}/><RSol {pose}/><AIPos {joints}/><ASPos {joints}/>'
            f'<EIPos E1="{1e3 * state.external:.4f}" E2="0.0" E3="0.0" E4="0.0" E5="0.0" E6="0.0"/>'
            f'<Delay D="{self.counts.late_in_a_row}"/><IPOC>{self.ipoc}</IPOC></Rob>'
        ).encode("ascii")

    def _answer(self, until: float) -> Correction | None:
        while True:
            left = until - time.perf_counter()
            if left <= 0.0:
                return None
            self._socket.settimeout(left)
            try:
                data, _ = self._socket.recvfrom(4096)
            except (TimeoutError, ConnectionRefusedError):
                continue
            if self.faults.lose_answers:
                self.faults.lose_answers -= 1
                continue
            read = _ANSWER.search(data)
            if read is None or read[1].decode() != self.sentype or int(read[8]) > self.ipoc:
                self.counts.wrong += 1
                continue
            if int(read[8]) < self.ipoc:
                self.counts.too_late += 1
                continue
            values = np.array([float(v) for v in read.groups()[1:7]])
            return Correction(1e-3 * values[:3], np.radians(values[3:]))

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
