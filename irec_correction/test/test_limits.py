# SPDX-License-Identifier: Apache-2.0
"""No input makes the offset step, and a target that allows it is reached."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_correction.errors import SettingsError
from irec_correction.limits import Bounds, VectorLimiter

PERIOD = 0.004
BOUNDS = Bounds(magnitude=3e-3, rate=0.02, acceleration=0.5)
anything = st.floats(allow_nan=True, allow_infinity=True)
targets = st.lists(st.tuples(st.tuples(anything, anything, anything), st.one_of(st.just(PERIOD), anything)), max_size=60)
sane = st.lists(st.tuples(*(st.floats(-0.01, 0.01) for _ in range(3))), min_size=1, max_size=60)


@settings(max_examples=200)
@given(sequence=targets)
def test_whatever_comes_in_no_step_is_above_the_rate_and_no_offset_above_the_magnitude(sequence):
    limiter = VectorLimiter(BOUNDS, PERIOD)
    for target, dt in sequence:
        before = limiter.value.copy()
        with np.errstate(all="ignore"):
            limiter.step(np.array(target), dt)
        assert np.linalg.norm(limiter.value - before) <= BOUNDS.rate * PERIOD * (1 + 1e-9)
        assert np.linalg.norm(limiter.value) <= BOUNDS.magnitude * (1 + 1e-9)


@settings(max_examples=100)
@given(sequence=sane)
def test_inside_the_allowed_ball_the_acceleration_stays_below_its_limit(sequence):
    limiter = VectorLimiter(Bounds(1.0, 0.02, 0.5), PERIOD)
    velocity = np.zeros(3)
    for target in sequence:
        before = limiter.value.copy()
        limiter.step(np.array(target), PERIOD)
        now = (limiter.value - before) / PERIOD
        assert np.linalg.norm(now - velocity) <= 0.5 * PERIOD * (1 + 1e-6) + 1e-12
        velocity = now


@settings(max_examples=60)
@given(target=st.tuples(*(st.floats(-1.5e-3, 1.5e-3) for _ in range(3))), start=sane)
def test_a_constant_target_is_reached_and_kept(target, start):
    limiter = VectorLimiter(BOUNDS, PERIOD)
    for t in start:
        limiter.step(np.array(t), PERIOD)
    for _ in range(400):
        limiter.step(np.array(target), PERIOD)
    np.testing.assert_allclose(limiter.value, target, atol=1e-9)


def test_a_target_that_moves_within_the_limits_is_followed_without_lag():
    limiter = VectorLimiter(BOUNDS, PERIOD)
    t = np.arange(0, 4, PERIOD)
    path = 8e-4 * (1 - np.cos(2 * np.pi * 0.5 * t))
    lag = []
    for x in path:
        limiter.step(np.array([x, 0.5 * x, -x]), PERIOD)
        lag.append(abs(limiter.value[0] - x))
    assert max(lag) < 2e-7


def test_a_late_tick_moves_no_further_than_a_punctual_one():
    limiter = VectorLimiter(Bounds(1.0, 0.02, 100.0), PERIOD)
    limiter.step(np.array([1.0, 0, 0]), 10.0)
    assert limiter.value[0] == pytest.approx(0.02 * PERIOD)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_that_is_no_limit_is_refused(bad):
    with pytest.raises(SettingsError, match="rate"):
        Bounds(1e-3, bad, 1.0)
