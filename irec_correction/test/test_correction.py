# SPDX-License-Identifier: Apache-2.0
"""The chain as a whole: it follows the model, and nothing that goes wrong makes the offset step."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from chain import PERIOD, ROBOT, WRENCH, Q, Rig, model
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_correction.correction import Correction, CorrectionSettings
from irec_correction.deflection import Deflection
from irec_correction.errors import ActivationError, SettingsError
from irec_correction.state import State
from irec_correction.watchdog import Fault

RATE = CorrectionSettings().limits.translation.rate
STEP = RATE * PERIOD * (1 + 1e-9)
TIMES = CorrectionSettings().times
LONG = TIMES.hold + TIMES.fade + 0.6


def test_active_offset_is_minus_the_deflection_of_the_model():
    rig = Rig().active()
    expected, _ = Deflection(model(), ROBOT)(rig.q, WRENCH[:3], WRENCH[3:], PERIOD)
    assert rig.outputs[-1].state is State.ACTIVE
    assert np.linalg.norm(rig.outputs[-1].translation + expected) < 5e-6
    assert np.linalg.norm(expected) > 2e-4


def test_rotation_is_corrected_only_where_asked():
    assert not np.any(Rig().active().outputs[-1].rotation)
    rig = Rig(with_rotation=True).active()
    _, turn = Deflection(model(), ROBOT)(rig.q, WRENCH[:3], WRENCH[3:], PERIOD)
    assert np.linalg.norm(rig.outputs[-1].rotation + turn) < 5e-6


def lose_wrench(rig: Rig) -> None:
    rig.run(LONG, wrench=False)


def lose_joints(rig: Rig) -> None:
    rig.run(LONG, joints=False)


def freeze_wrench(rig: Rig) -> None:
    rig.rng = type("Still", (), {"normal": staticmethod(lambda *_: np.zeros(6))})()
    rig.run(LONG)


def not_a_number(rig: Rig) -> None:
    rig.wrench = np.full(6, np.nan)
    rig.run(LONG)


def joints_not_a_number(rig: Rig) -> None:
    rig.q = np.full(6, np.nan)
    rig.run(LONG)


def wrench_ahead_of_the_clock(rig: Rig) -> None:
    for _ in range(round(LONG / PERIOD)):
        rig.now += PERIOD
        rig.correction.take_joints(rig.now, rig.now, rig.q)
        rig.correction.take_wrench(rig.now + 10.0, rig.now, "tool0", rig.wrench)
        rig.tick()


def sensor_complains(rig: Rig) -> None:
    for _ in range(round(LONG / PERIOD)):
        rig.now += PERIOD
        rig.correction.take_joints(rig.now, rig.now, rig.q)
        rig.correction.take_wrench(rig.now, rig.now, "tool0", rig.wrench, status="supply voltage low")
        rig.tick()


LOSSES = {
    lose_wrench: Fault.WRENCH_STALE, lose_joints: Fault.JOINTS_STALE, freeze_wrench: Fault.WRENCH_FROZEN,
    not_a_number: Fault.WRENCH_NOT_FINITE, joints_not_a_number: Fault.JOINTS_NOT_FINITE,
    wrench_ahead_of_the_clock: Fault.WRENCH_CLOCK, sensor_complains: Fault.SENSOR_STATUS,
}  # fmt: skip


@pytest.mark.parametrize("lose", LOSSES, ids=lambda f: f.__name__)
def test_a_lost_input_is_held_then_faded_and_waits_for_the_operator_without_a_step(lose):
    rig = Rig().active()
    began = len(rig.outputs)
    lose(rig)
    states = [o.state for o in rig.outputs[began:]]
    assert [s for i, s in enumerate(states) if i == 0 or s is not states[i - 1]][-3:] == [State.HOLD, State.FADE, State.FAULT]
    assert rig.correction.watchdog.counters[LOSSES[lose]] == 1
    assert rig.largest_step <= STEP
    assert not np.any(np.abs(rig.outputs[-1].translation) > 1e-8)
    assert rig.outputs[-1].reason
    assert states.count(State.HOLD) * PERIOD <= TIMES.hold + 2 * PERIOD


def test_a_short_loss_is_bridged_by_holding():
    rig = Rig().active()
    rig.run(0.1, wrench=False)
    assert rig.outputs[-1].state is State.HOLD
    rig.run(1.0)
    assert rig.outputs[-1].state is State.ACTIVE
    assert rig.largest_step <= STEP


def test_a_spike_is_not_believed_but_a_level_that_stays_is():
    rig = Rig().active()
    before = rig.outputs[-1].wrench_at_tcp[2]
    rig.wrench = WRENCH + [0, 0, -450, 0, 0, 0]
    rig.run(PERIOD)
    assert abs(rig.outputs[-1].wrench_at_tcp[2] - before) < 5
    assert rig.correction.watchdog.counters[Fault.WRENCH_JUMP] == 1
    rig.run(1.5)
    assert rig.outputs[-1].state is State.ACTIVE
    assert abs(rig.outputs[-1].wrench_at_tcp[2] - rig.wrench[2]) < 10
    assert rig.largest_step <= STEP


def test_outside_the_joints_of_the_model_the_offset_fades_and_comes_back_by_itself():
    rig = Rig().active()
    inside = rig.q.copy()
    for share in np.linspace(0, 1, 300):
        rig.q = inside + [0.9 * share, 0, 0, 0, 0, 0]
        rig.run(PERIOD)
    rig.run(TIMES.fade + 0.3)
    assert rig.outputs[-1].state is State.FADE
    assert "joint_1" in rig.outputs[-1].reason
    assert not np.any(np.abs(rig.outputs[-1].translation) > 1e-8)
    for share in np.linspace(1, 0, 300):
        rig.q = inside + [0.9 * share, 0, 0, 0, 0, 0]
        rig.run(PERIOD)
    rig.run(1.0)
    assert rig.outputs[-1].state is State.ACTIVE
    assert rig.largest_step <= STEP


def test_a_force_beyond_what_the_model_was_identified_for_fades():
    rig = Rig().active()
    for share in np.linspace(0, 1, 300):
        rig.wrench = WRENCH * (1 + share)
        rig.run(PERIOD)
    assert rig.outputs[-1].state is State.FADE
    assert rig.correction.watchdog.counters[Fault.OUTSIDE_WRENCH] == 1


def test_a_joint_that_moves_faster_than_it_can_is_not_believed():
    rig = Rig().active()
    rig.q = rig.q + [0, 0, 0, 0.3, 0, 0]
    rig.run(2 * PERIOD)
    assert rig.correction.watchdog.counters[Fault.JOINTS_JUMP] == 1


def test_a_gap_in_the_joint_states_hides_no_jump_that_the_joint_could_not_have_made():
    rig = Rig().active()
    before = rig.q
    rig.run(0.1, joints=False)
    assert rig.outputs[-1].state is State.HOLD
    rig.q = before + [0, 0, 0, 1.0, 0, 0]
    rig.run(2 * PERIOD)
    assert rig.outputs[-1].state is State.HOLD
    assert "joint_4 jumped by 1.0000 rad" in rig.correction.watchdog.newest.text


def test_after_a_gap_a_joint_is_believed_where_it_can_have_got_to():
    rig = Rig().active()
    before = rig.q
    rig.run(0.1, joints=False)
    rig.q = before + [0, 0, 0, 0.1, 0, 0]
    rig.run(1.0)
    assert rig.outputs[-1].state is State.ACTIVE
    assert not rig.correction.watchdog.counters[Fault.JOINTS_JUMP]


def test_a_wrench_in_the_wrong_frame_is_refused_by_name():
    wanted = replace(CorrectionSettings().watchdog, wrench_frame="ft_sensor")
    rig = Rig(watchdog=wanted)
    rig.run(0.1)
    rig.correction.start(rig.now)
    rig.run(0.1)
    assert rig.outputs[-1].state is State.HOLD
    assert "'tool0'" in rig.outputs[-1].reason and "'ft_sensor'" in rig.outputs[-1].reason


@pytest.mark.parametrize(("rail", "reason"), [(3.0, "its range is -1.5 .. 1.5 m"), (-1e9, "its range is"), (100.0, "in mm")])
def test_a_rail_beyond_its_range_is_held_and_faded_with_the_reason(rail, reason):
    rig = Rig().active()
    rig.rail = rail
    rig.run(0.1)
    assert rig.outputs[-1].state is State.HOLD and reason in rig.outputs[-1].reason
    rig.run(1.5)
    assert rig.outputs[-1].state is State.FAULT and rig.largest_step <= STEP


def test_a_rail_that_jumps_is_not_believed_before_it_can_be_there():
    rig = Rig().active()
    rig.rail = 0.9  # 5 m/s take 0.18 s for it
    rig.run(0.1)
    assert rig.outputs[-1].state is State.HOLD and "the rail jumped by 0.9000 m" in rig.outputs[-1].reason
    rig.run(1.0)
    assert rig.outputs[-1].state is State.ACTIVE and rig.largest_step <= STEP


def test_a_rail_that_moves_as_fast_as_it_can_is_followed():
    rig = Rig().active()
    for _ in range(100):
        rig.rail += 4.0 * PERIOD * (rig.rail < 1.4)
        rig.run(PERIOD)
        assert rig.outputs[-1].state is State.ACTIVE


def test_a_process_that_was_held_up_says_so_afterwards():
    rig = Rig().active()
    assert Fault.HELD_UP not in rig.correction.watchdog.counters
    rig.now += 2.5
    rig.run(0.02)
    assert rig.outputs[-1].state is State.HOLD and "no tick for 2.50 s, limit 0.1 s" in rig.outputs[-1].reason
    rig.run(1.0)
    assert rig.outputs[-1].state is State.ACTIVE and rig.largest_step <= STEP
    assert rig.correction.watchdog.counters[Fault.HELD_UP] == 1


def test_a_process_that_was_held_up_while_it_fades_out_goes_on_fading():
    rig = Rig().active()
    rig.correction.stop(rig.now)
    rig.run(0.1)
    rig.now += 0.3
    rig.run(2.0)
    assert rig.outputs[-1].state is State.INACTIVE and rig.correction.watchdog.counters[Fault.HELD_UP] == 1
    assert rig.largest_step <= STEP


def test_another_model_blends_over_without_a_step():
    rig = Rig().active()
    rig.correction.put_in_force(model(scale=2.0), rig.now)
    rig.run(1.0)
    expected, _ = Deflection(model(scale=2.0), ROBOT)(rig.q, WRENCH[:3], WRENCH[3:], PERIOD)
    assert np.linalg.norm(rig.outputs[-1].translation + expected) < 1e-5
    assert rig.largest_step <= STEP


def test_stopping_fades_to_inactive_and_starting_again_works():
    rig = Rig().active()
    rig.correction.stop(rig.now)
    rig.run(1.3)
    assert rig.outputs[-1].state is State.INACTIVE
    rig.active()
    assert rig.outputs[-1].state is State.ACTIVE


def test_after_a_fault_the_operator_starts_again():
    rig = Rig().active()
    rig.run(LONG, wrench=False)
    assert rig.outputs[-1].state is State.FAULT
    rig.run(1.0)
    assert rig.outputs[-1].state is State.FAULT
    rig.active()
    assert rig.outputs[-1].state is State.ACTIVE


def test_a_clock_that_is_set_back_makes_no_step():
    rig = Rig().active()
    rig.now -= 50.0
    rig.run(3.0)
    assert rig.outputs[-1].state is State.ACTIVE
    assert rig.correction.watchdog.counters[Fault.WRENCH_CLOCK] == 1
    assert rig.largest_step <= STEP


def test_starting_without_a_model_is_refused():
    from irec_correction.conditioning import Conditioner

    with pytest.raises(ActivationError, match="no model"):
        Correction(CorrectionSettings(), ROBOT, Conditioner([])).start(0.0)


def test_a_model_without_envelope_is_refused_where_one_is_needed():
    from irec_correction.conditioning import Conditioner

    correction = Correction(CorrectionSettings(need_envelope=True), ROBOT, Conditioner([]))
    with pytest.raises(ActivationError, match="envelope"):
        correction.put_in_force(model(envelope=False), 0.0)


def test_lead_makes_up_for_a_known_delay_of_a_steady_change():
    lag = {}
    for lead in (0.0, 0.02):
        rig = Rig(lead=lead).active()
        rig.rng = np.random.default_rng(2)
        for i in range(250):
            rig.wrench = WRENCH + np.array([0, 0, -0.5 * i, 0, 0, 0])
            rig.run(PERIOD)
        ahead = Deflection(model(), ROBOT)(rig.q, rig.wrench[:3] + [0, 0, -0.5 * 5], rig.wrench[3:], PERIOD)[0]
        lag[lead] = np.linalg.norm(np.mean([o.translation for o in rig.outputs[-5:]], axis=0) + ahead)
    assert lag[0.02] < 0.6 * lag[0.0]


@pytest.mark.parametrize("bad", [{"period": 0.0}, {"lead": 1.0}, {"lead_smoothing": 0.0}])
def test_settings_out_of_range_are_refused(bad):
    with pytest.raises(SettingsError):
        CorrectionSettings(**bad)


number = st.one_of(st.floats(-2000, 2000), st.floats(allow_nan=True, allow_infinity=True))
events = st.one_of(
    st.tuples(st.just("wrench"), st.lists(number, min_size=6, max_size=6), st.floats(-1, 1)),
    st.tuples(st.just("joints"), st.lists(st.floats(-4, 4), min_size=6, max_size=6), st.floats(-1, 1)),
    st.tuples(st.just("good"), st.integers(1, 60), st.just(0.0)),
    st.tuples(st.just("silence"), st.integers(1, 60), st.just(0.0)),
    st.tuples(st.just("clock"), st.floats(-20, 20), st.just(0.0)),
    st.tuples(st.sampled_from(["start", "stop", "model"]), st.just(0), st.just(0.0)),
)


@settings(max_examples=60, deadline=None)
@given(sequence=st.lists(events, max_size=25))
def test_whatever_happens_no_offset_step_is_above_the_rate_limit(sequence):
    rig = Rig().active()
    for kind, value, away in sequence:
        match kind:
            case "wrench":
                with np.errstate(all="ignore"):
                    rig.correction.take_wrench(rig.now + away, rig.now, "tool0", np.array(value))
            case "joints":
                rig.correction.take_joints(rig.now + away, rig.now, np.array(value))
            case "good":
                rig.run(value * PERIOD)
            case "silence":
                rig.run(value * PERIOD, wrench=False, joints=False)
            case "clock":
                rig.now += value
            case "start":
                rig.correction.start(rig.now)
            case "stop":
                rig.correction.stop(rig.now)
            case "model":
                rig.correction.put_in_force(model(scale=1.7), rig.now)
        rig.now += PERIOD
        rig.tick()
    assert rig.largest_step <= STEP


def test_a_raw_reading_is_freed_of_the_tools_weight_at_the_orientation_of_its_own_time():
    from irec_calibration.sensors.tool_load import ToolLoad
    from irec_correction.conditioning import Conditioner, sensor_in_tool, to_tcp

    load = ToolLoad(120.0, (0.0, 0.01, 0.2), (18.0, -11.0, 25.0), (1.2, -0.8, 0.5))
    R_sensor, p_sensor = sensor_in_tool(ROBOT, "ft_sensor")
    correction = Correction(CorrectionSettings(), ROBOT, Conditioner([], (R_sensor, p_sensor), load))
    correction.put_in_force(model(), 0.0)
    process = np.array([50.0, -20.0, -700.0, 1.0, 2.0, 3.0])
    for i, q in enumerate((Q, Q + [0, 0, 0, 0.002, 0.003, 0])):
        R = ROBOT.kinematics(q[None]).R_tool[0] @ R_sensor
        reading = process + load.reading(R, np.array([0.0, 0.0, -9.81]))
        now = 10.0 + i * PERIOD
        correction.take_joints(now, now, q)
        correction.take_wrench(now, now, "ft_sensor", reading)
        out = correction.tick(now)
        np.testing.assert_allclose(out.wrench_at_tcp, to_tcp(process, R_sensor, p_sensor), atol=1e-9)


def test_another_robot_stays_refused_while_healthy_wrenches_come_in():
    rig = Rig().active()
    rig.correction.watchdog.refuse("robot_description", Fault.ROBOT_CHANGED, "robot_description is another one")
    rig.run(LONG)
    assert rig.outputs[-1].state is State.FAULT
    assert "robot_description" in rig.outputs[-1].reason
    assert not np.any(np.abs(rig.outputs[-1].translation) > 1e-8)
    rig.correction.watchdog.clear("robot_description")
    assert rig.active().outputs[-1].state is State.ACTIVE


@pytest.mark.parametrize("broken", ["raises", "gives NaN"])
def test_a_model_that_fails_under_way_fades_out_without_a_step_until_the_operator_starts_again(broken, monkeypatch):
    rig = Rig().active()
    sound = rig.correction.deflection

    def fail(*arguments):
        if broken == "raises":
            raise ValueError("math domain error")
        return np.full(3, np.nan), np.zeros(3)

    rig.correction.deflection = fail
    rig.run(LONG)
    assert rig.outputs[-1].state is State.FAULT
    assert rig.correction.watchdog.counters[Fault.PREDICTION] == 1
    assert rig.largest_step <= STEP and not np.any(np.abs(rig.sent[-1]) > 1e-8)
    rig.correction.deflection = sound
    assert rig.active().outputs[-1].state is State.ACTIVE


def test_an_internal_error_fades_out_and_waits_for_the_operator():
    rig = Rig().active()
    rig.correction.fail("topic wrench", "ValueError: something")
    rig.run(LONG)
    assert rig.outputs[-1].state is State.FAULT and "something" in rig.outputs[-1].reason
    assert rig.active().outputs[-1].state is State.ACTIVE


def test_a_limit_that_is_lowered_while_the_offset_is_beyond_it_is_reached_without_a_step():
    rig = Rig().active()
    before = np.linalg.norm(rig.sent[-1])
    limits = rig.settings.limits
    rig.correction.set_limits(replace(limits, translation=replace(limits.translation, magnitude=0.5 * before)))
    rig.run(1.0)
    assert np.linalg.norm(rig.sent[-1]) == pytest.approx(0.5 * before, rel=1e-3)
    assert rig.largest_step <= STEP
    rig.correction.set_limits(limits)
    rig.run(1.0)
    assert np.linalg.norm(rig.sent[-1]) == pytest.approx(before, abs=1e-5)


@pytest.mark.parametrize("rail", [math.nan, math.inf])
def test_a_rail_position_that_is_no_number_is_held_and_named(rail: float) -> None:
    rig = Rig().active()
    before = rig.correction.present.copy()
    for _ in range(10):
        rig.now += PERIOD
        rig.correction.take_joints(rig.now, rig.now, rig.q, rail)
        rig.correction.take_wrench(rig.now, rig.now, "tool0", rig.wrench + rig.rng.normal(0, 1, 6))
        rig.tick()
    assert rig.outputs[-1].state is State.HOLD
    assert f"the position of the rail is {rail}" in rig.outputs[-1].reason
    np.testing.assert_allclose(rig.correction.present, before, atol=1e-5)
