# SPDX-License-Identifier: Apache-2.0
"""When the robot is taken to stand still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_robot import FakeRobot, settings
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.procedure.settings import Checks
from irec_calibration.procedure.standstill import LOOK_BACK, Streams, Window, drift, second_largest, too_few, unsettled

STILL = settings().settling
TARGET = np.array([280.0, 0.0, -1100.0])


def window(
    marker_sd: float = 1e-5, force_sd: float = 1.0, marker_step: float = 0.0, force_step: float = 0.0, n: int = 40
) -> Window:
    rng = np.random.default_rng(1)
    marker = rng.normal(0.0, marker_sd, (n, 3))
    marker[n // 2 :, 1] += marker_step
    force = TARGET + rng.normal(0.0, force_sd, (100, 3))
    force[50:, 2] += force_step
    return Window(0.0, 0.4, force, np.zeros((100, 3)), marker, "A", np.zeros((40, 6)), np.zeros((40, 3)))


def test_a_quiet_window_is_settled() -> None:
    assert unsettled(window(), STILL, 20, TARGET) == ""


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"marker_sd": 2e-4}, "marker moves"),
        ({"marker_step": 4e-5}, "marker drifts"),
        ({"force_step": 12.0}, "force drifts"),
        ({"n": 10}, "line of sight"),
    ],
)
def test_an_unquiet_window_is_not_settled_and_says_why(changed: dict, reason: str) -> None:
    assert reason in unsettled(window(**changed), STILL, 20, TARGET)


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_of_too_few_samples_nothing_is_known(n: int) -> None:
    assert np.isinf(drift(np.zeros((n, 3)))).all()
    few = replace(window(), force_in_tool=np.tile(TARGET, (n, 1)))
    assert "force drifts inf N" in unsettled(few, STILL, 20, TARGET)


@pytest.mark.parametrize("value", [np.nan])
def test_a_number_that_is_none_is_not_settled(value: float) -> None:
    force, marker = window().force_in_tool.copy(), window().p_marker_in_station.copy()
    force[3, 0] = marker[3, 1] = value
    assert unsettled(replace(window(), force_in_tool=force), STILL, 20, TARGET)
    assert unsettled(replace(window(), p_marker_in_station=marker), STILL, 20, TARGET)


@pytest.mark.parametrize(
    ("stream", "n", "told"),
    [
        ("force_in_tool", 2, "wrench has sent 2 readings in 0.4 s, at least 20 are needed (50 Hz"),
        ("q", 4, "joint_states has sent 4 readings in 0.4 s, at least 10 are needed (25 Hz"),
        ("p_tcp_in_base", 4, "tcp_pose has sent 4 readings"),
    ],
)
def test_a_stream_that_sends_too_little_is_told(stream: str, n: int, told: str) -> None:
    found = window()
    few = replace(found, **{stream: getattr(found, stream)[:n]})
    assert told in too_few(few, Checks()) and not too_few(found, Checks())
    assert not too_few(few, Checks(least_wrench_hz=5.0, least_states_hz=5.0)) or n < 4


def test_a_wrench_at_four_hertz_gives_no_row() -> None:
    robot = FakeRobot(1)
    robot.force_every = 0.25
    robot.start().run()
    assert not robot.rows and "wrench has sent" in robot.procedure.stopped_because


def test_a_force_off_its_set_point_is_not_settled() -> None:
    assert "set point" in unsettled(window(), STILL, 20, TARGET + [0, 20, 0])


def test_a_reference_needs_no_force() -> None:
    assert unsettled(window(), STILL, 20, None) == ""


@given(st.integers(0, 10_000), st.floats(1e-7, 1e-4))
def test_noise_alone_is_hardly_ever_taken_for_drift(seed: int, sd: float) -> None:
    noise = np.random.default_rng(seed).normal(0.0, sd, (60, 3))
    assert drift(noise).max() < 0.6 * sd


def test_drift_of_quiet_samples_is_the_step_between_the_halves() -> None:
    samples = np.zeros((40, 3))
    samples[20:, 2] = 1e-5
    np.testing.assert_allclose(drift(samples), [0, 0, 1e-5])


def filled(until: float, marker_until: float | None = None) -> Streams:
    streams = Streams(5.0)
    for i in range(round(until * 100)):
        t = 0.01 * (i + 1)
        streams.add_wrench(t, (0.0, 0.0, -1.0, 0.0, 0.0, 0.0))
        streams.add_joints(t, ("joint_1",), (t,))
        streams.add_tcp(t, t, 0.0, 0.0)
        if marker_until is None or t <= marker_until:
            streams.add_marker(t, t, 0.0, 0.0, "A")
    return streams


def test_a_window_holds_only_readings_after_its_beginning() -> None:
    streams = filled(2.0)
    assert streams.window(1.7, 0.4) is None
    found = streams.window(1.5, 0.4)
    assert found is not None
    assert found.q.min() > 1.5 and found.q.max() == pytest.approx(2.0)


def test_all_streams_of_a_window_cover_the_same_time() -> None:
    streams = filled(2.0, marker_until=1.9)  # the tracker is 0.1 s late
    found = streams.window(1.0, 0.4)
    assert found is not None
    assert found.end == pytest.approx(1.9, abs=0.011)
    assert found.q[:, 0].mean() == pytest.approx(found.p_marker_in_station[:, 0].mean(), abs=1e-9)


def test_there_is_no_window_while_the_marker_is_not_seen() -> None:
    assert filled(2.0, marker_until=1.0).window(1.1, 0.4) is None


def test_points_of_two_stations_are_never_averaged() -> None:
    streams = filled(1.0)
    for i in range(10):
        streams.add_marker(1.0 + 1e-6 * i, 9.0, 9.0, 9.0, "B")
    found = streams.window(0.3, 0.4)
    assert found is not None and found.station == "A"
    assert found.p_marker_in_station.max() < 2.0


def test_a_clock_set_back_empties_the_streams() -> None:
    streams = filled(20.0)
    streams.add_tcp(0.01, 0.0, 0.0, 0.0)
    assert streams.newest()["TCP"] == 0.01


def test_a_mean_has_the_readings_of_its_time_whatever_came_between_them() -> None:
    streams = Streams(horizon_s=5.0)
    for k in range(1000):
        streams.add_wrench(0.004 * k, (1.0 if k < 990 else 3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    streams.add_wrench(3.8, (99.0,) * 6)  # a reading that comes late: of another time
    streams.add_wrench(3.998, (3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    streams.add_wrench(3.97, (14.0, 0.0, 0.0, 0.0, 0.0, 0.0))  # late too, of the time asked for
    streams.add_wrench(4.0, (3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    mean = streams.mean_force(0.0, 0.041)  # from 3.960 on: ten of the first, and three more
    assert mean is not None and mean[0] == pytest.approx((12 * 3.0 + 14.0) / 13)


@pytest.mark.parametrize(
    ("sizes", "reached"),
    [([0.0, 0.0, 900.0, 0.0], 0.0), ([900.0, 0.0, 900.0, 0.0], 900.0), ([0.0, 0.0, 900.0, 905.0], 900.0), ([900.0], 0.0)],
    ids=["spike", "every second reading is of somebody else", "plain excess", "one reading is not enough"],
)
def test_two_of_the_newest_readings_have_to_be_beyond_a_limit(sizes: list[float], reached: float) -> None:
    assert len(sizes) <= LOOK_BACK and second_largest(np.array(sizes)) == reached
