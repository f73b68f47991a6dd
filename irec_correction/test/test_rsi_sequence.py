# SPDX-License-Identifier: Apache-2.0
"""What the controller sees in each cycle, whatever is lost, late, doubled or overtaken: at most one step of the limits."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from chain import PERIOD
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_correction.limits import OffsetLimiter, OffsetLimits
from irec_correction.rsi.answers import per_answer
from irec_correction.rsi.complaints import REFUSED
from irec_correction.rsi.sequence import CONFIRM, RESTART, SHORTEST_PAUSE
from irec_correction.rsi.session import RsiSession
from irec_correction.state import State

LIMITS = OffsetLimits()
RESOLUTION = 2e-7  # m, two values of 0.1 um on the wire
STEP = LIMITS.translation.rate * PERIOD + RESOLUTION
FIRST_STEP = LIMITS.translation.acceleration * PERIOD**2 + RESOLUTION  # from rest
FAR = np.array([2e-3, -1e-3, 1e-3])
REPLY = re.compile(rb'X="([^"]+)" Y="([^"]+)" Z="([^"]+)".*<IPOC>(\d+)<')


class Source:
    """Follows a target within the limits; stands in for the chain."""

    state, reason = State.ACTIVE, ""

    def __init__(self) -> None:
        self.target, self.limiter = FAR, OffsetLimiter(per_answer(LIMITS), PERIOD)

    def take(self, packet, now): ...
    def report(self, values): ...
    def start(self, now): ...
    def stop(self, now): ...

    def offset(self, now):
        self.limiter.step(self.target, np.zeros(3), PERIOD)
        return self.limiter.translation.value, self.limiter.rotation.value

    def resynchronise(self, translation, rotation):
        self.limiter.resynchronise(translation, rotation)

    def start_session(self, now):
        self.limiter.reset()


@dataclass(frozen=True)
class Counting:
    """How a controller counts late cycles, and whether an answer one cycle late acts all the same."""

    in_all: bool = False
    lag: int = 0
    takes_late: bool = False
    sent: bool = True
    counts: bool = True


IN_A_ROW = Counting()


class Link:
    """A controller and the session with it, one cycle of time per call."""

    def __init__(self, counting: Counting = IN_A_ROW, ipoc: int = 4_208_000_000) -> None:
        self.source = Source()
        self.session = RsiSession(self.source, "IREC", 4)
        self.now = 1000.0
        self.counting, self.ipoc = counting, ipoc
        self.held = np.zeros(3)
        self.acted = [np.zeros(3)]
        self.row = self.all = 0
        self.shown = [0]
        self.answers = 0
        self.sent: list[np.ndarray] = []  # translation of each answer in order, m
        self.underway: bytes | None = None
        self.before: tuple[int, int | None] | None = None

    @property
    def sequence(self):
        return self.session.sequence

    def receive(self, packet: tuple[int, int | None]) -> bytes | None:
        reply = self.session.reply(*packet, self.now)
        self.session.finish(self.now)
        if reply is not None:
            self.sent.append(1e-3 * np.array([float(v) for v in REPLY.search(reply).groups()[:3]]))
        return reply

    def cycle(self, what: str = "", intruders: Sequence[tuple[int, int | None]] = ()) -> None:
        """Args: intruders: packets of somebody else after this one's, IPOC against the running one in cycles, and Delay."""
        if self.session.wants_tick and what != "early":
            self.session.tick(self.now)
        self.ipoc += 4
        self.now += PERIOD
        c = self.counting
        delay = self.shown[-1 - min(c.lag, len(self.shown) - 1)] if c.sent else None
        packet = self.ipoc, delay
        replies = []
        if what != "lose_sent":
            replies.append(self.receive(packet))
            if what == "doubled":
                replies.append(self.receive(packet))
            if what == "old_again" and self.before is not None:
                replies.append(self.receive(self.before))
            self.before = packet
        for ahead, said in intruders:
            if self.session.wants_tick:
                self.session.tick(self.now)
            replies.append(self.receive((self.ipoc + 4 * ahead, said)))
        given = [r for r in replies if r is not None]
        self.answers += len(given)
        in_time = False
        for late, reply in ((True, self.underway), *((False, r) for r in given)):
            if reply is None or (not late and what in ("lose_answer", "late_answer")):
                continue
            *xyz, ipoc = REPLY.search(reply).groups()
            right = int(ipoc) == self.ipoc
            if right or (late and c.takes_late):
                self.held = 1e-3 * np.array([float(v) for v in xyz])
            in_time |= right
        self.underway = given[-1] if what == "late_answer" and given else None
        self.row = 0 if in_time else self.row + 1
        self.all += not in_time
        self.shown.append((self.all if c.in_all else self.row) if c.counts else 0)
        self.acted.append(self.held)

    def run(self, cycles: int, what: str = "") -> Link:
        for _ in range(cycles):
            self.cycle(what)
        return self

    def stop_and_start(self, pause: int) -> None:
        """RSI off, and on again: the correction is gone; the count goes on where it counts all."""
        self.ipoc += 4 * pause
        self.now += PERIOD * max(pause, 0)
        self.held, self.row, self.underway = np.zeros(3), 0, None
        self.shown = [self.all if self.counting.in_all else 0]
        self.acted = [np.zeros(3)]

    @property
    def steps(self) -> np.ndarray:
        """Of the correction that acts, m per cycle."""
        return np.linalg.norm(np.diff(np.array(self.acted), axis=0), axis=1)

    @property
    def largest_step_sent(self) -> float:
        """From one answer to the next, m."""
        return float(np.linalg.norm(np.diff(np.array(self.sent), axis=0), axis=1).max())


COUNTINGS = [Counting(in_all, lag, late) for in_all in (False, True) for lag in (0, 1) for late in (False, True)]
UNCOUNTED = [Counting(sent=False), Counting(counts=False)]
FAULTS = ["lose_sent", "lose_answer", "late_answer", "doubled", "old_again", "early"]


@pytest.mark.parametrize("counting", COUNTINGS)
def test_the_offset_arrives_with_any_way_of_counting(counting):
    link = Link(counting).run(200)
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)
    assert link.steps.max() <= STEP
    assert link.sequence.sessions == 1


@pytest.mark.parametrize("counting", COUNTINGS)
@pytest.mark.parametrize("packets", [1, 2, 5, 60, 200])
@pytest.mark.parametrize("fault", FAULTS)
def test_no_step_above_the_rate_limit_in_any_cycle(counting, fault, packets):
    link = Link(counting)
    for cycles, what in ((25, ""), (packets, fault), (20, ""), (packets, fault), (300, "")):
        link.run(cycles, what)
    assert link.steps.max() <= STEP
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)
    assert link.sequence.sessions == 1


@settings(max_examples=150)
@given(
    st.sampled_from(COUNTINGS),
    st.lists(st.sampled_from(["", "", "", *FAULTS]), max_size=120),
    st.lists(st.tuples(*(st.floats(-3e-3, 3e-3) for _ in range(3))), min_size=1, max_size=4),
)
def test_no_step_above_the_rate_limit_with_any_sequence_of_faults(counting, faults, targets):
    link = Link(counting).run(8)
    for i, what in enumerate(faults):
        link.source.target = np.array(targets[i * len(targets) // len(faults)])
        link.cycle(what)
    link.run(10)
    assert link.steps.max() <= STEP


@settings(max_examples=100)
@given(st.booleans(), st.lists(st.sampled_from(["", "", "", "lose_sent", "lose_answer", "early", "doubled"]), max_size=120))
def test_after_a_cycle_in_which_the_robot_stood_it_starts_within_the_limit_of_acceleration(in_all, faults):
    link = Link(Counting(in_all)).run(20)
    for what in faults:
        link.cycle(what)
    steps = link.steps
    stood = steps[:-1] == 0.0
    assert np.all(steps[1:][stood] <= FIRST_STEP)


@pytest.mark.parametrize("counting", COUNTINGS)
@pytest.mark.parametrize("pause", [20, 120, 4000])
def test_a_new_session_begins_at_zero(counting, pause):
    link = Link(counting).run(300)
    link.stop_and_start(pause)
    link.run(300)
    assert link.steps.max() <= STEP
    assert link.sequence.sessions == 2
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)


@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
def test_a_pause_of_the_line_in_which_ipoc_goes_on_by_one_cycle_is_no_new_session(counting):
    link = Link(counting).run(200)
    link.now += 2 * RESTART * PERIOD
    link.run(50)
    assert link.steps.max() <= STEP
    assert link.sequence.sessions == 1


def test_a_controller_that_was_switched_off_begins_at_zero():
    link = Link().run(200)
    link.ipoc, link.all = 4_000, 0
    link.now += 2 * RESTART * PERIOD
    link.stop_and_start(0)
    link.run(300)
    assert link.steps.max() <= STEP
    assert link.sequence.sessions == 2


def test_a_packet_that_was_held_up_for_long_is_no_new_session():
    link = Link().run(200)
    old = link.before
    link.run(100, "lose_sent").run(100, "lose_sent").run(50)
    assert link.receive(old) is None
    link.run(50)
    assert link.steps.max() <= STEP
    assert link.sequence.sessions == 1


@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
@pytest.mark.parametrize("back", [60, 10_000])
def test_a_controller_whose_clock_began_anew_after_it_had_stopped_begins_at_zero(counting, back):
    link = Link(counting).run(100)
    link.now += 2 * RESTART * PERIOD
    link.stop_and_start(-back)
    link.run(300)
    assert link.steps.max() <= STEP
    assert link.sequence.sessions == 2
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)


CLOCK_SET = [-10_000, -60, 60, 10_000]  # cycles


@pytest.mark.parametrize("counting", COUNTINGS)
@pytest.mark.parametrize("cycles", [*CLOCK_SET, 4, 6, 7, 8, 9, 10, 12, -4, -9])
def test_a_clock_set_anew_in_a_session_that_goes_on_by_its_delay_goes_on_from_what_the_controller_holds(counting, cycles):
    link = Link(counting).run(100)
    link.ipoc += 4 * cycles
    link.run(50)
    assert link.answers > 120 and link.steps.max() <= STEP
    assert link.sequence.sessions == 1


@pytest.mark.parametrize("counting", COUNTINGS)
@pytest.mark.parametrize("cycles", CLOCK_SET)
@pytest.mark.parametrize("pause", [SHORTEST_PAUSE + 1, 50])
def test_a_clock_set_anew_with_a_pause_that_delay_has_not_counted_begins_at_zero(counting, cycles, pause):
    link = Link(counting).run(100)
    link.stop_and_start(pause)
    link.ipoc += 4 * cycles
    link.run(50)
    assert link.answers > 120 and link.steps.max() <= STEP
    assert link.sequence.sessions == 2


@pytest.mark.parametrize("counting", UNCOUNTED)
@pytest.mark.parametrize("cycles", CLOCK_SET)
@pytest.mark.parametrize("stopped", [False, True])
def test_without_a_count_a_clock_set_anew_gets_no_answer_since_nobody_knows_what_the_controller_holds(counting, cycles, stopped):
    link = Link(counting).run(100)
    if stopped:
        link.stop_and_start(20)
    link.ipoc += 4 * cycles
    answers = link.answers
    link.run(30)  # fewer than the jump, and than its time-out
    assert link.answers == answers and link.steps.max() <= STEP
    assert "clock" in link.sequence.problem


def test_ipoc_that_comes_to_its_end_is_no_new_session():
    link = Link(ipoc=(1 << 32) - 4 * 50).run(50)
    link.ipoc -= 1 << 32
    link.run(50)
    assert link.sequence.sessions == 1 and link.sequence.lost == 0
    assert link.steps.max() <= STEP


def test_a_session_that_was_running_before_gets_no_answer_until_it_has_ended():
    link = Link()
    link.held, link.acted, link.row, link.shown = FAR, [FAR], 12, [12]
    link.run(RESTART)
    assert link.steps.max() == 0.0
    assert "running before this process" in link.sequence.problem
    link.stop_and_start(400)
    link.run(200)
    assert link.steps.max() <= STEP and link.sequence.problem == ""
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)


@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
def test_each_cycle_is_answered_from_the_first_on(counting):
    link = Link(counting).run(300)
    assert link.answers == 300 and link.session.unanswered == 0


@pytest.mark.parametrize("counting", UNCOUNTED)
@pytest.mark.parametrize("fault", ["lose_sent", "late_answer", "lose_answer", "doubled", "old_again", "early"])
def test_without_a_count_a_single_fault_makes_no_step_above_the_rate_limit(counting, fault):
    link = Link(counting)
    for _ in range(10):
        link.run(25).run(1, fault)
    link.run(300)
    assert link.steps.max() <= STEP
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)


@pytest.mark.parametrize("counting", UNCOUNTED)
def test_without_a_count_a_long_gap_ends_the_answers_since_any_of_them_could_be_a_jump(counting):
    link = Link(counting).run(200).run(30, "lose_sent")
    held = link.held
    link.run(60)
    assert "DEF_Delay" in link.sequence.problem
    assert np.all(link.held == held)


def test_a_missing_count_is_said():
    assert "DEF_Delay" in Link(Counting(sent=False)).run(5).sequence.problem


def test_a_wrong_cycle_time_is_named():
    link = Link()
    for _ in range(REFUSED + 2):
        link.ipoc += 8
        link.cycle()
    assert "cycle_ms" in link.sequence.problem
    assert not np.any(link.acted)


@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
@pytest.mark.parametrize("lost", [0, 1, 3, 9, 60])
@pytest.mark.parametrize("cycle_ms", [12, 40])
def test_a_controller_whose_cycle_has_become_longer_is_never_taken_for_a_new_session(counting, lost, cycle_ms):
    link = Link(counting).run(20)
    link.run(60 if counting in COUNTINGS else 0, "lose_answer").run(120)  # Delay, where there is one, has been seen to rise
    for what in [""] * 20 + ["lose_sent"] * lost + [""] * 100:
        link.ipoc += cycle_ms - 4
        link.now += 1e-3 * cycle_ms - PERIOD
        link.cycle(what)
    assert link.steps.max() <= STEP
    assert link.sequence.sessions == 1
    assert np.linalg.norm(link.held) > 1e-3
    assert "cycle_ms" in link.sequence.problem or (not link.sequence.in_session and "no answer" in link.sequence.problem)


def test_a_cycle_time_that_is_too_long_is_named():
    link = Link()
    link.sequence._cycle_ms = 12
    link.run(3 * REFUSED)
    assert "cycle_ms" in link.sequence.problem
    assert link.steps.max() <= STEP


def test_answers_that_the_controller_never_takes_are_complained_of_until_it_does():
    link = Link().run(60, "lose_answer")
    assert "sentype" in link.sequence.problem
    assert not np.any(link.acted)
    link.run(300)
    assert link.sequence.problem == ""
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)


ONE_AHEAD_OF_ITS_TIME = [(10, 0)]
FAR_AHEAD = [(1000, 0)]
OLD_ONES_IN_STEP = [(-60 + k, 0) for k in range(30)]
IN_STEP_AHEAD = [(k, 0) for k in range(1, 80)]


@pytest.mark.parametrize("intruders", [ONE_AHEAD_OF_ITS_TIME, FAR_AHEAD, OLD_ONES_IN_STEP, IN_STEP_AHEAD])
@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
def test_packets_of_somebody_else_make_no_step_and_end_no_session(counting, intruders):
    link = Link(counting).run(300)
    link.cycle("", intruders)
    link.run(300)
    assert max(link.largest_step_sent, link.steps.max()) <= STEP
    assert link.sequence.sessions == 1
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)


@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
def test_old_packets_replayed_at_the_pace_of_the_controller_make_no_step(counting):
    link = Link(counting).run(300)
    for _ in range(100):
        link.cycle("", [(-200, 0)])
    assert max(link.largest_step_sent, link.steps.max()) <= STEP
    assert link.sequence.sessions == 1
    np.testing.assert_allclose(link.held, FAR, atol=RESOLUTION)


ahead = st.one_of(st.integers(-20, 20), st.integers(-300, 300), st.integers(-(10**9), 10**9))
bursts = st.tuples(ahead, st.sampled_from([0, 0, 1, 40]), st.one_of(st.none(), st.integers(0, 200)), st.integers(0, 1))
attacks = st.one_of(
    st.just([]),
    st.lists(st.tuples(ahead, st.one_of(st.none(), st.integers(0, 200))), max_size=3),
    bursts.map(lambda b: [(b[0] + k, None if b[2] is None else b[2] + b[3] * k) for k in range(b[1])]),
)


@settings(max_examples=150)
@given(
    st.sampled_from([*COUNTINGS, *UNCOUNTED]),
    st.lists(st.tuples(st.sampled_from(["", "", "", "doubled", "early", "lose_sent", "lose_answer"]), attacks), max_size=80),
)
def test_whatever_packets_arrive_two_successive_answers_never_differ_by_more_than_one_step(counting, cycles):
    link = Link(counting).run(120)
    for i, (what, intruders) in enumerate(cycles):
        link.cycle(what if i % 3 else "", intruders)  # the controller's own packets go on
    link.run(10)
    assert max(link.largest_step_sent, link.steps.max()) <= STEP
    assert link.sequence.sessions == 1


@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
def test_a_new_session_is_answered_after_as_many_packets_as_confirm_it(counting):
    link = Link(counting).run(300)
    link.stop_and_start(2 * RESTART)
    answered = link.answers
    link.run(20)
    assert link.answers == answered + 20 - (CONFIRM - 1)
