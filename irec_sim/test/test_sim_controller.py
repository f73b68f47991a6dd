# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_sim.instruments import Delay, DropOuts, InstrumentSettings, Noise, SlowNoise
from irec_sim.servo import ForceController, OffsetChannel, Servo

DT = 0.004


def test_the_servo_reaches_its_command_within_the_velocity_limit():
    servo = Servo(0.015, np.array([1.0, 2.0]))
    q = np.zeros(2)
    for _ in range(400):
        after = servo.follow(q, np.array([0.5, -0.5]), DT)
        assert (np.abs(after - q) <= np.array([1.0, 2.0]) * DT + 1e-15).all()
        q = after
    assert np.allclose(q, [0.5, -0.5], atol=1e-9)


@given(
    st.lists(st.floats(3e5, 4e6), min_size=3, max_size=3).map(np.array),
    st.tuples(st.floats(-300, 300), st.floats(-300, 300), st.floats(-1500, -500)).map(np.array),
)
@settings(max_examples=40)
def test_the_force_controller_reaches_its_set_point_on_soft_and_hard_contacts(stiffness, wanted):
    control, x = ForceController(), np.zeros(3)
    for _ in range(2500):
        x = x + control.displacement(wanted, -stiffness * np.maximum(x, [-1, -1, 0]), DT)
    assert np.allclose(-stiffness * x, wanted, atol=1.0)


def test_without_contact_the_tool_advances_along_its_axis_at_the_set_speed():
    step = ForceController().displacement(np.array([280.0, 0.0, -1100.0]), np.zeros(3), DT)
    assert np.allclose(step, [0, 0, 0.005 * DT])


def _run(channel, seconds, start, feed=None):
    t, out = start, []
    for _ in range(round(seconds / DT)):
        t += DT
        if feed is not None:
            channel.take(np.array(feed), np.zeros(3), t)
        out.append(channel.applied(t, DT, True).copy())
    return np.array(out), t


def test_an_offset_fades_in_is_held_and_fades_out_without_a_jump():
    channel = OffsetChannel()
    given_, t = _run(channel, 1.0, 0.0, [3e-4, 0, -5e-4])
    assert np.allclose(given_[-1, :3], [3e-4, 0, -5e-4])
    silent, t = _run(channel, 1.0, t)
    held = silent[: round(channel.fade_after / DT) - 1]
    assert np.allclose(held[:, 0], 3e-4)
    assert not silent[-1].any()
    assert np.abs(np.diff(np.concatenate([given_, silent]), axis=0)).max() < 1e-5
    assert channel.late == 1


def test_an_offset_that_is_too_large_is_cut():
    channel = OffsetChannel()
    applied, _ = _run(channel, 1.0, 0.0, [0.03, 0.04, 0.0])
    assert np.allclose(applied[-1, :3], [0.003, 0.004, 0.0])


def test_nothing_is_applied_when_disabled():
    channel = OffsetChannel()
    channel.take(np.array([1e-3, 0, 0]), np.zeros(3), 0.0)
    assert not channel.applied(DT, DT, False).any()


def test_noise_repeats_with_its_seed_and_differs_without():
    def record(seed):
        noise = Noise(seed, InstrumentSettings(), 6, 2)
        return np.concatenate([noise.force(0.004), noise.encoder(), noise.tracker(1, 0.01, 1e-5)])

    assert np.array_equal(record(3), record(3))
    assert not np.array_equal(record(3), record(4))


def test_one_instrument_does_not_disturb_the_noise_of_another():
    one, other = (Noise(3, InstrumentSettings(), 6, 1) for _ in range(2))
    for _ in range(5):
        other.encoder()
    assert np.array_equal(one.force(0.1), other.force(0.1))


def test_slow_noise_has_unit_spread_and_its_correlation_time():
    noise = SlowNoise(2.0, 400, np.random.default_rng(0))
    before = noise.at(0.0)
    after = noise.at(2.0)
    assert before.std() == pytest.approx(1.0, abs=0.15)
    assert np.corrcoef(before, after)[0, 1] == pytest.approx(np.exp(-1), abs=0.15)


def test_a_delay_gives_back_what_was_put_in_that_long_ago():
    delay = Delay(0.02)
    out = [delay.pass_through(k * DT, k) for k in range(20)]
    assert out[10:] == list(range(5, 15))


def test_drop_outs_last_and_end():
    drop = DropOuts(0.02, 0.05, np.random.default_rng(1))
    silent = np.array([drop.silent(0.01 * k) for k in range(5000)])
    assert 0.02 < silent.mean() < 0.3
    assert (silent[1:] & silent[:-1]).sum() > silent.sum() / 2
