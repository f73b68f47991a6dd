# SPDX-License-Identifier: Apache-2.0
"""What courses have in common is told apart by time and by place, and a touch-down at its mean time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import RecordingError
from irec_calibration.sensors.force_profile import ForcedCourse, common_force, smoothed

PERIOD = 0.004


def step(t: np.ndarray, width: float) -> np.ndarray:
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(t / width, -50.0, 50.0))))


def made(seconds: float, late: float = 0.0, seed: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Share of the way and force: a touch-down by time, a corner at 30 % of the way, lift-off by the time that is left."""
    t = np.arange(round(seconds / PERIOD)) * PERIOD
    share = t / t[-1]
    pressed = step(t - 0.5 - late, 0.04) * step(t[-1] - t - 0.3, 0.03)
    corner = np.exp(-0.5 * ((share - 0.3) / 0.06) ** 2)
    force = np.stack([-60.0 * pressed, -80.0 * corner, 850.0 * pressed + 200.0 * corner], axis=1)
    if seed is not None:
        force = force + np.random.default_rng(seed).normal(0.0, 5.0, force.shape)
    return share, force


def test_touch_down_and_corner_are_foretold_for_a_course_of_another_length() -> None:
    courses = [ForcedCourse(*made(s, seed=i)) for i, s in enumerate((6.0, 8.0, 10.0, 13.0))]
    found = common_force(courses, PERIOD)
    share, force = made(9.0)
    left = found.along(share, PERIOD) - force
    assert float(np.sqrt((left**2).mean())) < 12.0
    assert float(np.abs(left).max()) < 60.0  # by one alone (850 N over 0.1 s, 200 N at another time) it would be hundreds
    assert found.left == pytest.approx(5.0, abs=6.0)


def test_a_touch_down_that_comes_sooner_or_later_is_not_blurred() -> None:
    late = np.array([-0.03, 0.03, -0.02, 0.02, 0.0])
    found = common_force([ForcedCourse(*made(9.0, x, seed=i)) for i, x in enumerate(late)], PERIOD)
    assert found.spread == pytest.approx(float(late.std()), abs=0.003)
    share, force = made(9.0)
    head = slice(0, round(1.0 / PERIOD))
    assert float(np.abs(found.along(share, PERIOD) - force)[head].max()) < 60.0


def test_what_comes_by_time_ends_without_a_step() -> None:
    """A cut at the same place of courses of one length may be told by time: where the time ends it goes over to the place."""
    courses = []
    for i in range(6):
        share, force = made(8.0, seed=i)
        force[:, 1] += 300.0 * np.exp(-0.5 * ((share - 0.25) / 0.03) ** 2)  # at its highest where the head ends, after 2 s
        courses.append(ForcedCourse(share, force))
    found = common_force(courses, PERIOD)
    steps = np.abs(np.diff(found.along(courses[0].share, PERIOD)[:, 1]))
    assert float(steps[round(1.9 / PERIOD) : round(2.1 / PERIOD)].max()) < 6.0  # N in 4 ms; the cut itself rises by 3


def test_what_is_as_quick_as_the_arm_is_left_to_the_readings() -> None:
    t = np.arange(2500) * PERIOD
    middle = slice(500, 2000)
    for hertz, low, high in ((0.5, 0.98, 1.0), (4.0, 0.55, 0.65), (10.0, 0.0, 0.05)):
        wave = np.sin(2.0 * np.pi * hertz * t)[:, None]
        left = smoothed(wave, PERIOD)[middle]
        assert low <= float(left.std() / wave[middle].std()) <= high
        assert float((left * wave[middle]).sum()) > -1e-6  # not moved in time
    np.testing.assert_array_equal(smoothed(wave, PERIOD, 0.0), wave)


@settings(max_examples=10, deadline=None)
@given(level=st.lists(st.floats(-500.0, 500.0), min_size=3, max_size=3), seconds=st.floats(5.0, 12.0))
def test_a_constant_force_is_foretold_as_it_is(level: list[float], seconds: float) -> None:
    n = round(seconds / PERIOD)
    share = np.linspace(0.0, 1.0, n)
    found = common_force([ForcedCourse(share, np.tile(level, (n, 1)))], PERIOD)
    np.testing.assert_allclose(found.along(share, PERIOD), np.tile(level, (n, 1)), atol=1e-2 * (1.0 + np.abs(level).max()))


def test_courses_that_cannot_be_used_are_refused_with_what_is_needed() -> None:
    with pytest.raises(RecordingError, match="one recording"):
        common_force([], PERIOD)
    with pytest.raises(RecordingError, match="course 1 has 500 samples; 800 are needed"):
        common_force([ForcedCourse(np.linspace(0, 1, 500), np.zeros((500, 3)))], PERIOD)
    bad = np.zeros((1000, 3))
    bad[10, 1] = np.nan
    with pytest.raises(RecordingError, match="not finite"):
        common_force([ForcedCourse(np.linspace(0, 1, 1000), bad)], PERIOD)
