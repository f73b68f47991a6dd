# SPDX-License-Identifier: Apache-2.0
"""The sequence of a controller's packets and what the controller may hold, so that no answer is further from that than one step
of the limits.

A controller takes an answer only with the IPOC of the running cycle. Otherwise it keeps the correction that it has (HOLDON=1)
and counts the cycle in `Delay`, which its packets carry; after `Timeout` such cycles in a row RSI stops. A packet that never came
here shows as a gap in IPOC.

`Delay` is described in public in few words, so it is taken to be up to one cycle behind: of the last two answers it is never
known whether they were taken. That is why two answers in a row make no more than one step of the limits (`per_answer`), and why,
when Delay rises or cycles are missing, the controller gets the middle one of what it may hold until two cycles went well.

A packet belongs to the sequence when its IPOC is later than the newest one and not ahead of its time. Anything else (an IPOC
ahead of its time, an old one again) is not answered. It may be somebody else's, and then the packet answered before it too: the
offset stands until packets of the sequence come alone again.

A new session begins at zero. That is right only where the controller has stopped, so it takes evidence of that: Delay that has
counted fewer cycles than went by, or packets of another sequence (its clock was set anew) that begin after more cycles without
any answer than its time-out allows. Cycles are counted by IPOC here and by Delay there, so after the gap IPOC has to go on by one
cycle once: a controller at 12 ms counts a third of the cycles of 4 ms. Without that there is no answer: what the controller holds
stays, until it stops by itself.
Who sends packets from the controller's own socket while none of the controller's come can't be told from it.

Every cycle is answered, but for two cases in which any answer could make the robot jump: RSI ran before this process did, or
packets were missing for so long that RSI may have been stopped and started, and Delay does not say which.
"""

from __future__ import annotations

from dataclasses import dataclass

from .answers import Action, Answer
from .arrivals import EARLY, Arrivals, cycles_between
from .complaints import Complaints
from .delay_count import LAG, DelayCount

RESTART = 150  # cycles; the controller, with its time-out of 100, has stopped RSI for sure. IPOC this far back: no late packet
SHORTEST_PAUSE = 10  # cycles between two sessions; no controller stops RSI and starts it again within that
CONFIRM = 3  # packets in a row that must agree before a new session begins at zero while the controller may hold something
NEW_CLOCK = 10  # packets of another sequence, one a cycle and none of anybody else: the controller's clock was set anew


@dataclass
class _Other:
    """Packets that are not of the sequence: the last IPOC, how many in step led to it, time, s, and Delay of the first."""

    ipoc: int
    count: int
    since: float
    first_delay: int | None


class Sequence:
    """Judges each packet of the controller.

    Attributes:
        sent: the last answer; before: the one before it.
        newest: IPOC of the last packet that belongs to the sequence; None: none yet.
        problem: what somebody has to look at; empty: nothing.
        lost: cycles without a packet. duplicate: packets of an earlier cycle. out_of_sequence: of a cycle that is not yet.
        not_taken: answers that the controller did not take. sessions: begun so far.
    """

    def __init__(self, zero: Answer, cycle_ms: int) -> None:
        self._zero, self._cycle_ms, self._cycle = zero, cycle_ms, 1e-3 * cycle_ms
        self.sent = self.before = zero
        self.problem = ""
        self.lost = self.duplicate = self.out_of_sequence = self.not_taken = self.sessions = 0
        self._delays, self._complaints = DelayCount(), Complaints(cycle_ms)
        self._clean = 0  # packets in a row
        self._now = 0.0  # of the packet that is judged, s
        self._answered_at: float | None = None  # s, of the last answer to anybody, or of the first packet
        self._forget_packets()

    def _forget_packets(self) -> None:
        self.newest: int | None = None  # IPOC
        self._newest_at = 0.0  # s
        self._delay: int | None = None  # of the newest packet
        self._answered: tuple[int, int | None] | None = None  # IPOC and Delay of the packet answered last
        self._doubt = False  # it is not known what the controller holds
        self._paced = False  # IPOC has gone on by one cycle since packets were missing
        self._holding = False
        self._starting: tuple[int, float] | None = None  # packets that say that a session is new, and the time of the first
        self._going_on: tuple[int, float] | None = None  # and those that say that it is the one of the last answer
        self._other: _Other | None = None
        self._arrivals = Arrivals(self._cycle_ms)

    @property
    def in_session(self) -> bool:
        """Packets are being answered."""
        return self._answered is not None and not self._doubt

    def other_peer(self) -> None:
        """The next packet is the first one of another socket of the controller."""
        self._forget_packets()

    def is_newer(self, stamp: tuple[int, int | None] | None, other: tuple[int, int | None] | None) -> bool:
        """Whether another packet (IPOC, Delay) is of a later cycle; counts it where it has come twice or too late."""
        if other is None:
            return False
        newer = stamp is None or not -RESTART < self._steps(stamp[0], other[0]) <= 0
        self.duplicate += not newer
        return newer

    def judge(self, ipoc: int, delay: int | None, now: float, is_fresh: bool = False) -> Action:
        """What to do with a packet; `sent` is then what to answer, unless it is NEXT.

        Args:
            delay: None where the packet carries none.
            now: steady time of its arrival, s.
            is_fresh: the socket that it comes from was silent before for RESTART cycles or more.
        """
        self._now = now
        self._delays.hear(delay)
        if self._answered_at is None:
            self._answered_at = now
        if self.newest is None:
            self._follow(ipoc, delay, now, None)
            return self._first(delay, is_fresh, now)
        steps = self._steps(self.newest, ipoc)
        if not self._is_of_other(ipoc, now) and self._belongs(ipoc, delay, now, steps):
            return self._in_sequence(ipoc, delay, now, steps)
        self._disturbed()
        self._complaints.pace(ipoc == self.newest)
        if not self._doubt:
            self.problem = self._complaint()
        if steps == 0 and not self._is_of_other(ipoc, now):
            self.duplicate += 1
            return Action.SILENT
        return self._out_of_sequence(ipoc, delay, now, steps)

    def _disturbed(self) -> None:
        """Somebody's packets are not of the sequence: nothing moves, and what seemed sure has to be said again."""
        self._holding, self._clean, self._going_on = True, 0, None
        self._delays.forget_last()
        if self._doubt:
            self._starting = None

    def gave(self, ipoc: int, delay: int | None, answer: Answer) -> None:
        """Such an answer was sent to such a packet."""
        self._answered, self._answered_at = (ipoc, delay), self._now
        self._delays.answered()
        if answer is not self.sent:
            self.before, self.sent = self.sent, answer

    # -- packets of the sequence ---------------------------------------------------------------------------------------

    def _belongs(self, ipoc: int, delay: int | None, now: float, steps: int) -> bool:
        """Whether a packet is one of the sequence: later than the newest, in its time, and with a Delay that can be."""
        if steps < 1 or (steps > 1 and now - self._newest_at < (steps - EARLY) * self._cycle):
            return False
        return not self._arrivals.are_behind(ipoc, now) and self._delays.may_follow(self._delay, delay, steps)

    def _in_sequence(self, ipoc: int, delay: int | None, now: float, steps: int) -> Action:
        was_silent = now - self._newest_at > RESTART * self._cycle
        rose = self._follow(ipoc, delay, now, steps)
        if self._starting is not None:
            return self._while_starting(ipoc, delay, now)
        # IPOC is the controller's time: where it goes on cycle by cycle RSI has not been started anew, however long that took
        if steps >= RESTART or (was_silent and steps > SHORTEST_PAUSE):
            return self._after_silence(ipoc, delay, now)
        self.lost += steps - 1
        self._doubt = self._doubt or self._answered is None or steps > SHORTEST_PAUSE - EARLY
        if self._doubt:
            return self._in_doubt(ipoc, delay, now)
        return self._in_session(delay, steps - 1, rose)

    def _follow(self, ipoc: int, delay: int | None, now: float, steps: int | None) -> bool:
        """Take a packet as the newest; whether Delay has risen since the one before. Learns how Delay counts."""
        last, self.newest, self._newest_at, self._delay, self._other = self._delay, ipoc, now, delay, None
        self._arrivals.add(ipoc, now)
        if steps is None or steps > SHORTEST_PAUSE - EARLY:
            self._paced = False
        if steps is None:
            return False
        self._paced = self._paced or steps == 1
        self._complaints.pace(steps == 1)
        return self._delays.follow(last, delay, steps)

    def _in_session(self, delay: int | None, gap: int, rose: bool) -> Action:
        if gap == 0 and not rose:
            self._clean += 1
            self._complaints.wrong = 0
            self.problem = self._complaint()
            if self._holding and self._clean <= LAG:
                return Action.HOLD
            self._holding = False
            return Action.NEXT
        then = self._answered[1] if self._answered is not None else None
        refused = self._delays.since(then, delay) > gap
        self.not_taken += refused
        return self._hold(refused)

    def _hold(self, refused: bool) -> Action:
        """Args: refused: the last answer was not taken, or the one before it."""
        if refused and not self._holding:
            self.sent = self.before
        self._holding, self._clean = True, 0
        self._complaints.wrong += 1
        self.problem = self._complaint()
        return Action.HOLD

    # -- packets that are not of the sequence --------------------------------------------------------------------------

    def _is_of_other(self, ipoc: int, now: float) -> bool:
        """Whether a packet goes on with another sequence than the one answered, which alone came for some cycles."""
        o = self._other
        return (
            o is not None
            and o.count >= CONFIRM
            and self._steps(o.ipoc, ipoc) == 1
            and now - o.since >= (CONFIRM - 0.5) * self._cycle
        )

    def _out_of_sequence(self, ipoc: int, delay: int | None, now: float, steps: int) -> Action:
        """An IPOC of the past, or ahead of its time. See the head of this file."""
        if steps <= 0:
            self.duplicate += 1
            if self.newest is not None and self._arrivals.were_overrun(ipoc, now, self.newest, self._newest_at):
                return self._resume(ipoc, delay, now)
        else:
            self.out_of_sequence += 1
        last = self._other
        further = 0 if last is None else self._steps(last.ipoc, ipoc)
        if last is not None and 1 <= further <= SHORTEST_PAUSE:
            last.ipoc, last.count = ipoc, last.count + 1 if further == 1 else 1
        else:
            self._other = last = _Other(ipoc, 1, now, delay)
        lasted = (now - last.since) / self._cycle
        if 0 < steps <= SHORTEST_PAUSE and last.count >= CONFIRM and lasted >= CONFIRM - 1.5:
            self._arrivals.clear()  # a cell that runs faster than its time has lost a packet
            return self._in_sequence(ipoc, delay, now, steps)
        if last.count < NEW_CLOCK or lasted < NEW_CLOCK - 1 - EARLY:
            return Action.SILENT
        return self._new_clock(ipoc, delay, now, last)

    def _new_clock(self, ipoc: int, delay: int | None, now: float, other: _Other) -> Action:
        """Only packets of another sequence come: has the controller stopped before it, or do time and Delay go on?"""
        answered_at = now if self._answered_at is None else self._answered_at
        cycles = round((now - answered_at) / self._cycle)
        then = None if self._answered is None else self._answered[1]
        self._delays.follow(other.first_delay, delay, other.count - 1)
        if self._delays.same_session(then, delay, cycles) is None and other.since - answered_at < RESTART * self._cycle:
            self.problem = (
                "the controller's clock (IPOC) is another one, with no pause before it in which RSI has stopped for sure: it may "
                "hold a correction, so it gets no answer until it has stopped; then start RSI again"
            )
            return Action.SILENT
        self._follow(ipoc, delay, now, None)
        self._paced = True  # NEW_CLOCK packets, one a cycle
        if self._answered is not None:  # by the new clock
            self._answered = ipoc - cycles * self._cycle_ms, then
        return self._after_silence(ipoc, delay, now)

    def _resume(self, ipoc: int, delay: int | None, now: float) -> Action:
        self._arrivals.back_to(ipoc)
        self._follow(ipoc, delay, now, None)
        if self._doubt or self._answered is None:
            return Action.SILENT
        return self._hold(False)

    # -- sessions ------------------------------------------------------------------------------------------------------

    def _first(self, delay: int | None, is_fresh: bool, now: float) -> Action:
        """The first packet of a socket."""
        if not is_fresh and delay:
            self._doubt = True
            self.problem = (
                f"RSI was running before this process, {delay} packets late: the controller may hold a correction of an "
                "earlier one, so it gets no answer until it has stopped; then start RSI again"
            )
            return Action.SILENT
        return self._start_when_sure(now)

    def _after_silence(self, ipoc: int, delay: int | None, now: float) -> Action:
        """Packets were missing for longer than any time-out of the controller should be."""
        if self._answered is not None:
            same = self._is_same_session(*self._answered, ipoc, delay, now)
            if same:
                return self._hold_when_sure(now)  # its time-out is longer
            if same is None and self._delays.rises and delay:
                self._doubt, self._starting = True, None
                return self._in_doubt(ipoc, delay, now)
        return self._start_when_sure(now)

    def _in_doubt(self, ipoc: int, delay: int | None, now: float) -> Action:
        """After a long gap: is this the session of the last answer?"""
        same = None if self._answered is None else self._is_same_session(*self._answered, ipoc, delay, now)
        if same is None:
            if self._answered is not None:
                self.problem = (
                    f"packets of {SHORTEST_PAUSE} cycles or more did not come, and Delay does not tell whether RSI was started "
                    "anew meanwhile: no answer until it has stopped. DEF_Delay belongs into SEND of the ethernet XML (irec "
                    "rsi-config writes one)"
                )
            return Action.SILENT
        return self._hold_when_sure(now) if same else self._start_when_sure(now)

    def _while_starting(self, ipoc: int, delay: int | None, now: float) -> Action:
        if self._answered is not None and self._is_same_session(*self._answered, ipoc, delay, now):
            return self._hold_when_sure(now)
        return self._start_when_sure(now)

    def _hold_when_sure(self, now: float) -> Action:
        """Go on in the session of the last answer, after CONFIRM packets that agree."""
        self._starting, self._doubt = None, True
        self._going_on = _one_more(self._going_on, now)
        if not self._is_sure(self._going_on, now):
            return Action.SILENT
        self._going_on, self._doubt = None, False
        return self._hold(False)

    def _start_when_sure(self, now: float) -> Action:
        """Begin at once where that is no step, otherwise after CONFIRM packets that agree."""
        self._going_on, self._starting = None, _one_more(self._starting, now)
        sure = self._is_sure(self._starting, now)
        if self.sent.text == self._zero.text or (sure and self._paced):
            return self._start()
        if sure:
            self.problem = (
                f"packets were missing, and IPOC goes on by more than {self._cycle_ms} ms since then, so that Delay does not tell"
                " whether RSI was started anew: no answer until it has stopped; check parameter cycle_ms (IPO_FAST: 4, IPO: 12)"
            )
        self._doubt = True
        return Action.SILENT

    def _is_sure(self, agreed: tuple[int, float], now: float) -> bool:
        return agreed[0] >= CONFIRM and now - agreed[1] >= (CONFIRM - 1.5) * self._cycle

    def _start(self) -> Action:
        self.sent = self.before = self._zero
        self._doubt = self._holding = False
        self._starting = self._going_on = None
        self._clean = self._complaints.wrong = 0
        self.problem = self._complaint()
        self.sessions += 1
        return Action.START

    def _is_same_session(self, ipoc_then: int, delay_then: int | None, ipoc: int, delay: int | None, now: float) -> bool | None:
        """Whether RSI has been running and counting since the last answer; None: can't be told."""
        steps = self._steps(ipoc_then, ipoc)
        if self._answered_at is not None:  # a clock that was set ahead has counted no cycles
            steps = min(steps, round((now - self._answered_at) / self._cycle))
        return self._delays.same_session(delay_then, delay, steps)

    def _complaint(self) -> str:
        return self._complaints.text(self._answered is not None and self._answered[1] is None)

    def _steps(self, before: int, after: int) -> int:
        """Cycles from one IPOC to another."""
        return cycles_between(before, after, self._cycle_ms)


def _one_more(agreed: tuple[int, float] | None, now: float) -> tuple[int, float]:
    """One more packet that agrees: how many there are, and the time of the first, s."""
    return (1, now) if agreed is None else (agreed[0] + 1, agreed[1])
