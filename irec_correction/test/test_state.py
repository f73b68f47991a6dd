# SPDX-License-Identifier: Apache-2.0
"""The state machine of the correction by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_correction.errors import SettingsError
from irec_correction.state import RETURNS, TRANSITIONS, WITHIN, Event, State, StateTimes, Supervisor
from irec_correction.watchdog import Fault, Finding

TIMES = StateTimes(ramp_in=0.5, hold=0.25, fade=1.0, recover=0.05)
WANTED = np.array([1e-3, 0, 0, 0, 0, 0])
LOST, OUTSIDE = Finding(Fault.WRENCH_STALE, "no wrench"), Finding(Fault.OUTSIDE_JOINTS, "joint_1")
PERIOD = 0.004


class Run:
    """A supervisor whose target is followed at once."""

    def __init__(self) -> None:
        self.supervisor, self.now, self.present = Supervisor(TIMES), 0.0, np.zeros(6)

    def go(self, seconds: float, finding: Finding | None = None) -> State:
        for _ in range(round(seconds / PERIOD)):
            self.now += PERIOD
            self.present = self.supervisor.tick(self.now, finding, WANTED, self.present)
        return self.supervisor.state

    def active(self):
        self.supervisor.start(self.now, self.present)
        assert self.go(0.6) is State.ACTIVE
        return self


def test_values_are_those_of_the_message():
    assert [s.value for s in State] == list(range(6))
    assert [s.name for s in State] == ["INACTIVE", "RAMP_IN", "ACTIVE", "HOLD", "FADE", "FAULT"]


def test_every_state_can_be_left_and_every_one_but_the_first_can_be_entered():
    assert {s for s, _ in TRANSITIONS} == set(State)
    assert set(TRANSITIONS.values()) == set(State)


def test_every_running_state_can_be_stopped():
    for state in (State.RAMP_IN, State.ACTIVE, State.HOLD):
        assert TRANSITIONS[state, Event.STOP] is State.FADE
        assert TRANSITIONS[state, Event.OUTSIDE] is State.FADE


def test_loss_leads_to_hold_and_after_its_time_to_fade_and_fault():
    run = Run().active()
    assert run.go(0.2, LOST) is State.HOLD
    np.testing.assert_allclose(run.present, WANTED)
    assert run.go(0.1, LOST) is State.FADE
    assert run.go(1.1, LOST) is State.FAULT
    assert not np.any(run.present)
    assert run.go(5.0) is State.FAULT


def test_input_that_comes_back_while_fading_after_a_loss_does_not_end_the_fading():
    run = Run().active()
    run.go(0.4, LOST)
    assert run.go(1.1) is State.FAULT


def test_input_that_flickers_does_not_come_back():
    run = Run().active()
    for _ in range(10):
        run.go(0.02, LOST)
        run.go(0.02)
    assert run.supervisor.state in (State.HOLD, State.FADE)


def test_outside_the_envelope_comes_back_by_itself_but_not_after_a_loss_meanwhile():
    run = Run().active()
    run.go(3.0, OUTSIDE)
    assert run.go(0.7) is State.ACTIVE
    run.go(1.5, OUTSIDE)
    run.go(0.1, LOST)
    assert run.go(1.0) is State.FAULT


def test_stop_while_lost_ends_inactive():
    run = Run().active()
    run.go(0.1, LOST)
    run.supervisor.stop(run.now, run.present)
    assert run.go(1.2, LOST) is State.INACTIVE


@pytest.mark.parametrize("bad", [-1.0, float("nan"), 1e9])
def test_times_that_can_not_be_are_refused(bad):
    with pytest.raises(SettingsError, match="fade"):
        StateTimes(fade=bad)


findings = st.sampled_from([None, None, LOST, OUTSIDE])
steps = st.lists(st.tuples(st.sampled_from(["tick", "start", "stop"]), findings, st.floats(0, 0.3)), max_size=60)


@given(steps)
def test_reason_is_given_whenever_the_offset_does_not_follow_the_model(sequence):
    run = Run()
    for what, finding, dt in sequence:
        run.now += dt
        if what == "start":
            run.supervisor.start(run.now, run.present)
        elif what == "stop":
            run.supervisor.stop(run.now, run.present)
        run.present = run.supervisor.tick(run.now, finding, WANTED, run.present)
        assert run.supervisor.reason or run.supervisor.state is State.ACTIVE
        assert np.all(np.abs(run.present) <= np.abs(WANTED) + 1e-12)


def flap(run: Run, times: int, every: float) -> State:
    """Outside the model's range for a moment, again and again."""
    for _ in range(times):
        run.go(0.1, OUTSIDE)
        state = run.go(every - 0.1)
    return state


def test_what_comes_and_goes_by_itself_again_and_again_ends_in_a_fault_for_the_operator():
    run = Run().active()
    assert flap(run, RETURNS, 0.2) is State.RAMP_IN
    assert flap(run, 1, 0.2) is State.FADE
    assert run.go(1.5) is State.FAULT
    assert "faded out 4 times within 10 s, 3 are possible: joint_1" in run.supervisor.reason
    assert "press the tool into what it touches" in run.supervisor.reason
    assert not np.any(run.present)
    run.supervisor.stop(run.now, run.present)
    run.active()  # the operator's activation counts from none
    assert flap(run, RETURNS, 0.2) is State.RAMP_IN


def test_what_is_outside_seldom_comes_back_for_ever():
    run = Run().active()
    assert flap(run, 5 * RETURNS, WITHIN / RETURNS + 0.2) is State.ACTIVE


def test_a_clock_that_was_set_back_forgets_how_often_it_came_back():
    run = Run().active()
    flap(run, RETURNS, 0.2)
    run.now -= 1000.0
    assert run.go(0.7) is State.ACTIVE
    assert flap(run, 1, 0.2) is State.RAMP_IN
