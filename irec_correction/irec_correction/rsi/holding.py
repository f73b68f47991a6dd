# SPDX-License-Identifier: Apache-2.0
"""What the controller may hold, told from its own packets, so that no answer is further from that than one step of the limits.

A controller takes an answer only with the IPOC of the running cycle. Otherwise it keeps the correction that it has (HOLDON=1)
and counts the cycle in `Delay`, which its packets carry; after `Timeout` such cycles in a row RSI stops. A packet that never came
here shows as a gap in IPOC.

`Delay` is described in public in few words, so it is taken to be up to one cycle behind: of the last two answers it is never
known whether they were taken. That is why two answers in a row make no more than one step of the limits (`per_answer`), and why,
when Delay rises or cycles are missing, the controller gets the middle one of what it may hold until two cycles went well.

Every cycle is answered, but for two cases in which any answer could make the robot jump: RSI ran before this process did, or
packets were missing for so long that RSI may have been stopped and started, and Delay does not say which.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from irec_calibration.typing import Array

from ..limits import OffsetLimits

RESTART = 150  # cycles; the controller, with its time-out of 100, has stopped RSI for sure. IPOC this far back: no late packet
LAG = 1  # cycles by which Delay may be behind
SHORTEST_PAUSE = 10  # cycles between two sessions; no controller stops RSI and starts it again within that
TOLERANCE = 1  # cycles
REFUSED = 20  # cycles in a row that went wrong, to say so
ANEW = 10  # packets in a row, each a cycle after the other and none of them of a later cycle: the controller's clock began anew
IPOC_WRAP = 1 << 32  # ms


class Verdict(Enum):
    """What to do with a packet."""

    NEXT = "go on from the answer before"
    STAND = "cycles went wrong: send what the controller may hold, go on from rest"
    BEGIN = "a new session, which holds no correction"
    SILENT = "any answer could be a jump, or the packet has been answered: no answer"


@dataclass(frozen=True)
class Answer:
    """An offset, translation (3,), m, and rotation vector (3,), rad, and its bytes up to the IPOC."""

    translation: Array
    rotation: Array
    text: bytes


def per_answer(limits: OffsetLimits) -> OffsetLimits:
    """Limits for a source of answers: LAG + 1 answers in a row stay within one step of the limits given."""
    share = 1.0 / (LAG + 1)
    return replace(
        limits,
        translation=replace(limits.translation, rate=share * limits.translation.rate),
        rotation=replace(limits.rotation, rate=share * limits.rotation.rate),
    )


class Holding:
    """Judges each packet of the controller. `sent` is the last answer, `before` the one before it."""

    def __init__(self, zero: Answer, cycle_ms: int) -> None:
        self._zero, self._cycle_ms = zero, cycle_ms
        self.sent = self.before = zero
        self.problem = ""
        self.lost = self.doubled = self.not_taken = self.sessions = 0
        self._newest: int | None = None  # IPOC
        self._delay: int | None = None  # of the newest packet
        self._answered: tuple[int, int | None] | None = None  # IPOC and Delay of the packet answered last
        self._in_a_row: bool | None = None  # how Delay counts: late cycles in a row, or in all
        self._counts = False  # Delay has been seen to rise
        self._doubt = False  # it is not known what the controller holds
        self._standing = False
        self._clean = self._wrong = 0  # packets in a row
        self._even = self._uneven = 0  # packets on which IPOC went on by one cycle, and others
        self._behind: tuple[int, int] | None = None  # the last packet of an earlier cycle: IPOC, and how many in a row led to it

    @property
    def in_session(self) -> bool:
        """Packets are being answered."""
        return self._answered is not None and not self._doubt

    def is_newer(self, stamp: tuple[int, int | None] | None, other: tuple[int, int | None] | None) -> bool:
        """Whether another packet (IPOC, Delay) is of a later cycle; counts it where it has come twice or too late."""
        if other is None:
            return False
        newer = stamp is None or not -RESTART < self._steps(stamp[0], other[0]) <= 0
        self.doubled += not newer
        return newer

    def judge(self, ipoc: int, delay: int | None, was_silent: bool) -> Verdict:
        """What to do with a packet; `sent` is then what to answer, unless it is NEXT.

        Args:
            delay: None where the packet carries none.
            was_silent: no packet came for RESTART cycles before this one.
        """
        steps = None if self._newest is None else self._steps(self._newest, ipoc)
        # doubled, or overtaken by a newer one, on the way; a controller that begins anew with lower ones was silent before
        if steps is not None and steps <= 0 and (steps > -RESTART or not was_silent):
            self.doubled += 1
            self._pace(ipoc == self._newest)
            self.problem = self._complaint()
            return self._earlier(ipoc, delay)
        self._behind = None
        rose = self._heard(ipoc, delay, steps)
        # IPOC is the controller's time: where it goes on cycle by cycle RSI has not been started anew, however long that took
        if steps is None or abs(steps) >= RESTART or (was_silent and steps > SHORTEST_PAUSE):
            if steps is not None and steps > 0 and self._answered is not None:
                same = self._is_same_session(*self._answered, ipoc, delay)
                if same:
                    return self._stand(False)  # its time-out is longer
                if same is None and self._counts and delay:
                    self._doubt = True
                    return self._in_doubt(ipoc, delay)
            return self._first(delay, was_silent or steps is not None)
        self.lost += steps - 1
        self._doubt = self._doubt or self._answered is None or steps > SHORTEST_PAUSE
        if self._doubt:
            return self._in_doubt(ipoc, delay)
        return self._in_session(ipoc, delay, steps - 1, rose)

    def gave(self, ipoc: int, delay: int | None, answer: Answer) -> None:
        """Such an answer was sent to such a packet."""
        self._answered = ipoc, delay
        if answer is not self.sent:
            self.before, self.sent = self.sent, answer

    def _heard(self, ipoc: int, delay: int | None, steps: int | None) -> bool:
        """Take a packet of a new cycle; whether Delay has risen since the one before. Learns how Delay counts."""
        last, self._newest, self._delay = self._delay, ipoc, delay
        if steps is None:
            return False
        self._pace(steps == 1)
        if delay is None or last is None or steps < 0:
            return False
        if delay > last:
            self._counts = True
        elif steps == 1 and last > 0:
            self._in_a_row = delay < last
        return delay > last

    def _pace(self, regular: bool) -> None:
        """Watch whether IPOC goes on by one cycle from packet to packet."""
        self._even = self._even + 1 if regular else 0
        self._uneven = 0 if self._even >= REFUSED // 2 else self._uneven + (not regular)

    def _earlier(self, ipoc: int, delay: int | None) -> Verdict:
        """A packet of a cycle that is over. Many in a row, in step, are the packets of a controller that was started anew."""
        in_step = self._behind is not None and self._steps(self._behind[0], ipoc) == 1
        self._behind = ipoc, (self._behind[1] + 1 if in_step and self._behind is not None else 1)
        if self._behind[1] < ANEW:
            return Verdict.SILENT
        self._behind = None
        self._heard(ipoc, delay, None)
        return self._begin()

    def _first(self, delay: int | None, stood: bool) -> Verdict:
        """The first packet of a session; `stood`: RSI was off before for sure."""
        if not stood and delay:
            self._doubt = True
            self.problem = (
                f"RSI was running before this process, {delay} packets late: the controller may hold a correction of an "
                "earlier one, so it gets no answer until it has stopped; then start RSI again"
            )
            return Verdict.SILENT
        return self._begin()

    def _begin(self) -> Verdict:
        self.sent = self.before = self._zero
        self._doubt = self._standing = False
        self._clean = self._wrong = 0
        self.problem = self._complaint()
        self.sessions += 1
        return Verdict.BEGIN

    def _in_doubt(self, ipoc: int, delay: int | None) -> Verdict:
        """After a long gap: is this the session of the last answer?"""
        same = None if self._answered is None else self._is_same_session(*self._answered, ipoc, delay)
        if same is None:
            if self._answered is not None:
                self.problem = (
                    f"packets of {SHORTEST_PAUSE} cycles or more did not come, and Delay does not tell whether RSI was started "
                    "anew meanwhile: no answer until it has stopped. DEF_Delay belongs into SEND of the ethernet XML (irec "
                    "rsi-config writes one)"
                )
            return Verdict.SILENT
        if not same:
            return self._begin()
        self._doubt = False
        return self._stand(False)

    def _is_same_session(self, ipoc_then: int, delay_then: int | None, ipoc: int, delay: int | None) -> bool | None:
        """Whether RSI has been running and counting since the last answer; None: can't be told."""
        if delay is None or delay_then is None or not self._counts:
            return None
        least = self._steps(ipoc_then, ipoc) - 1 - LAG - TOLERANCE
        in_a_row, in_all = delay >= least, delay - delay_then >= least
        if self._in_a_row is None:
            return in_a_row if in_a_row == in_all else None
        return in_a_row if self._in_a_row else in_all

    def _in_session(self, ipoc: int, delay: int | None, gap: int, rose: bool) -> Verdict:
        if gap == 0 and not rose:
            self._clean += 1
            self._wrong = 0
            self.problem = self._complaint()
            if self._standing and self._clean <= LAG:
                return Verdict.STAND
            self._standing = False
            return Verdict.NEXT
        then = self._answered[1] if self._answered is not None else None
        counted = 0 if delay is None or then is None else delay if self._in_a_row else delay - then
        refused = counted > gap
        self.not_taken += refused
        return self._stand(refused)

    def _stand(self, refused: bool) -> Verdict:
        """Args: refused: the last answer was not taken, or the one before it."""
        if refused and not self._standing:
            self.sent = self.before
        self._standing, self._clean = True, 0
        self._wrong += 1
        self.problem = self._complaint()
        return Verdict.STAND

    def _complaint(self) -> str:
        if self._uneven >= REFUSED:
            return (
                f"IPOC does not go on by {self._cycle_ms} ms from packet to packet: check parameter cycle_ms (IPO_FAST: 4, "
                "IPO: 12); until then the offset stands still"
            )
        if self._wrong >= REFUSED:
            return (
                f"the controller has not taken the last {REFUSED} answers or more: they come too late (latency in "
                "/diagnostics), get lost on the way back (firewall), or 'sentype' is not the SENTYPE of its ethernet XML"
            )
        if self._answered is not None and self._answered[1] is None:
            return (
                "packets carry no Delay, so answers that are lost on the way to the controller are not seen, and after k of them "
                "the next one may be (k + 1) / 2 steps of the rate limit away: add DEF_Delay to SEND of the ethernet XML (irec "
                "rsi-config writes one)"
            )
        return ""

    def _steps(self, before: int, after: int) -> int:
        """Cycles from one IPOC to another."""
        difference = after - before
        if difference < -IPOC_WRAP // 2:
            difference += IPOC_WRAP
        return round(difference / self._cycle_ms)
