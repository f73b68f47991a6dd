# SPDX-License-Identifier: Apache-2.0
"""What the controller holds, told from its own packets, so that no answer is further from that than one step of the limits.

A controller takes an answer only with the IPOC of the running cycle. Otherwise it keeps the correction that it has (HOLDON=1)
and counts the cycle in `Delay`, which its packets carry; after `Timeout` such cycles in a row RSI stops. A packet that never came
here shows as a gap in IPOC. So with `missed` cycles since the last answer, the count says whether that answer was taken.

`Delay` is described in public in few words, so nothing is taken for granted about it: the first packets of each session stay
unanswered, and no offset is sent before the count has been seen to rise by them. That tells too whether it comes a cycle late
(then each value is sent twice before the next one), and the first answer tells whether it counts late cycles in a row or in all.
Where IPOC and Delay contradict each other nothing is answered: a controller without an answer never moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from irec_calibration.typing import Array

RESTART = 150  # cycles; the controller, with its time-out of 100, has stopped RSI for sure. IPOC this far back: no late packet
LATEST_COUNT = 1  # cycles by which Delay may lag behind
PATIENCE = 6  # unanswered cycles in which Delay must rise
REFUSED = 20  # answers in a row that were not taken, to say so
SHORTEST_PAUSE = 10  # cycles between two sessions; no controller stops RSI and starts it again within that
TOLERANCE = 1  # cycles
IPOC_WRAP = 1 << 32  # ms


class Verdict(Enum):
    """What to do with a packet."""

    NEXT = "the last answer was taken just now: go on from it"
    AGAIN = "the last answer is not yet confirmed: send it again"
    STAND = "cycles are missing: send what the controller holds, go on from rest"
    BEGIN = "a new session, which holds no correction"
    SILENT = "it is not known what the controller holds, or the packet has been answered: no answer"


@dataclass(frozen=True)
class Answer:
    """An offset, translation (3,), m, and rotation vector (3,), rad, and its bytes up to the IPOC."""

    translation: Array
    rotation: Array
    text: bytes


class Holding:
    """Judges each packet of the controller. `held`: what it holds for certain; `sent`: what it was sent last."""

    def __init__(self, zero: Answer, cycle_ms: int) -> None:
        self._zero, self._cycle_ms = zero, cycle_ms
        self.held = self.sent = zero
        self.problem = ""
        self.lost = self.doubled = self.not_taken = self.sessions = 0
        self._newest: int | None = None  # IPOC
        self._answered: tuple[int, int] | None = None  # IPOC and Delay of the packet answered last
        self._proof: tuple[int, int] | None = None  # IPOC and Delay of the first one left unanswered on purpose
        self._fresh = False  # the session that is being proven holds no correction
        self._lag = 0
        self._in_a_row: bool | None = None
        self._clean = 0  # packets since `sent` was sent first
        self._refused = 0  # answers in a row

    @property
    def in_session(self) -> bool:
        """Packets are being answered."""
        return self._proof is None and self._answered is not None

    def is_newer(self, stamp: tuple[int, int | None] | None, other: tuple[int, int | None] | None) -> bool:
        """Whether another packet (IPOC, Delay) is of a later cycle; counts it where it has come twice or too late."""
        if other is None:
            return False
        newer = stamp is None or not -RESTART < self._steps(stamp[0], other[0]) <= 0
        self.doubled += not newer
        return newer

    def judge(self, ipoc: int, delay: int | None, was_silent: bool) -> Verdict:
        """Args: was_silent: no packet came for RESTART cycles before this one."""
        if self._newest is not None:
            steps = self._steps(self._newest, ipoc)
            if -RESTART < steps <= 0:  # doubled, or overtaken by a newer one, on the way
                self.doubled += 1
                return Verdict.SILENT
            self.lost += max(0, steps - 1) if steps < RESTART else 0
        self._newest = ipoc
        if delay is None:
            self.problem = "packets carry no Delay: add DEF_Delay to SEND of the ethernet XML (irec rsi-config writes one)"
            return Verdict.SILENT
        if self._answered is not None:
            verdict = self._judge_in_session(*self._answered, ipoc, delay)
            if verdict is not None:
                self._proof, self.problem = None, self._complaint()
                return verdict
        if self._proof is None or was_silent or self._steps(self._proof[0], ipoc) < 0:
            self._fresh = self._answered is not None or was_silent or delay == 0
            self._proof = ipoc, delay
            return Verdict.SILENT
        return self._prove(*self._proof, ipoc, delay)

    def gave(self, ipoc: int, delay: int | None, answer: Answer) -> None:
        """Such an answer was sent to such a packet."""
        self._answered = ipoc, delay or 0
        if answer is not self.sent:
            self.sent, self._clean = answer, 0

    def _judge_in_session(self, ipoc_then: int, delay_then: int, ipoc: int, delay: int) -> Verdict | None:
        """None: this is not the session of the last answer."""
        missed = self._steps(ipoc_then, ipoc) - 1
        counted = delay if self._in_a_row else delay - delay_then
        if missed < 0 or (missed >= SHORTEST_PAUSE and counted < missed - self._lag - TOLERANCE):
            return None  # it has not been running through these cycles
        if self._in_a_row is None:  # answers are zero until that is known
            taken = missed == 0 and delay_then > 0 and delay in (0, delay_then)
            self._in_a_row = delay == 0 if taken else None
            self._refused = 0 if taken else self._refused + 1
            return Verdict.STAND
        taken = counted <= missed
        self.not_taken += not taken
        self._refused = 0 if taken else self._refused + 1
        if missed == 0 and taken:
            self._clean += 1
            if self._clean <= self._lag:
                return Verdict.AGAIN
            self.held = self.sent
            return Verdict.NEXT
        if taken and self._lag == 0:
            self.held = self.sent
        self._clean = 0
        return Verdict.STAND

    def _prove(self, ipoc_first: int, delay_first: int, ipoc: int, delay: int) -> Verdict:
        unanswered, counted = self._steps(ipoc_first, ipoc), delay - delay_first
        lag = unanswered - counted
        if counted >= 1 and 0 <= lag <= LATEST_COUNT:
            if not self._fresh:
                self.problem = (
                    f"RSI was running before this process, {delay} packets late: the controller may hold a correction of an "
                    "earlier one, so it gets no answer until it has stopped; then start RSI again"
                )
                return Verdict.SILENT
            self._lag, self._proof, self._in_a_row, self.problem = lag, None, None, ""
            self.held = self.sent = self._zero
            self._clean = 0
            self.sessions += 1
            return Verdict.BEGIN
        if unanswered > PATIENCE:
            self.problem = (
                f"Delay went from {delay_first} to {delay} over {unanswered} cycles of {self._cycle_ms} ms without an answer: it "
                "can't be told what the controller holds. Check parameter cycle_ms (IPO_FAST: 4, IPO: 12) and DEF_Delay in "
                "the ethernet XML"
            )
        return Verdict.SILENT

    def _complaint(self) -> str:
        if self._refused < REFUSED:
            return ""
        return (
            f"the controller has not taken the last {REFUSED} answers or more: they come too late (latency in /diagnostics), get "
            "lost on the way back (firewall), or 'sentype' is not the SENTYPE of its ethernet XML"
        )

    def _steps(self, before: int, after: int) -> int:
        """Cycles from one IPOC to another."""
        difference = after - before
        if difference < -IPOC_WRAP // 2:
            difference += IPOC_WRAP
        return round(difference / self._cycle_ms)
