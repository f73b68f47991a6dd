# SPDX-License-Identifier: Apache-2.0
"""Filters against scipy on whole signals, and the delay that each one states."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_correction.errors import SettingsError
from irec_correction.filters import Median, delay_cost, low_pass, notch, spindle_notches
from scipy import signal

RATE = 250.0


def through(stage, samples):
    return np.array([stage.step(x) for x in samples])


@settings(max_examples=30, deadline=None)
@given(cutoff=st.floats(2.0, 110.0), order=st.integers(1, 6), seed=st.integers(0, 99))
def test_low_pass_sample_by_sample_is_scipys_on_the_whole_signal(cutoff, order, seed):
    x = np.random.default_rng(seed).normal(0, 100, (300, 6))
    sos = signal.butter(order, cutoff, fs=RATE, output="sos")
    begin = signal.sosfilt_zi(sos)[:, :, None] * x[0]
    expected, _ = signal.sosfilt(sos, x, axis=0, zi=begin)
    np.testing.assert_allclose(through(low_pass(cutoff, order, RATE), x), expected, atol=1e-7)


def test_a_constant_passes_from_the_first_sample_on():
    x = np.tile([10.0, -5.0, -900.0, 1.0, 2.0, 3.0], (20, 1))
    for stage in (low_pass(20.0, 4, RATE), notch(50.0, 5.0, RATE), Median(5, RATE)):
        np.testing.assert_allclose(through(stage, x), x, atol=1e-9)


@pytest.mark.parametrize("stage", [low_pass(20.0, 2, RATE), low_pass(60.0, 4, RATE), notch(60.0, 3.0, RATE), Median(5, RATE)])
def test_a_ramp_comes_out_later_by_the_delay_that_is_stated(stage):
    t = np.arange(500) / RATE
    out = through(stage, 100.0 * t[:, None] * np.ones(6))
    assert (100.0 * t[-1] - out[-1, 0]) / 100.0 == pytest.approx(stage.delay, abs=2e-5)


def test_notch_takes_its_frequency_away():
    t = np.arange(1000) / RATE
    x = 100.0 * np.sin(2 * np.pi * 50.0 * t)[:, None] * np.ones(6)
    assert np.abs(through(notch(50.0, 5.0, RATE), x)[-200:]).max() < 0.5


def test_spindle_harmonics_beyond_half_the_rate_are_notched_where_they_fold_to():
    assert [f.name for f in spindle_notches(200.0, 2, 5.0, RATE)] == ["notch 50 Hz", "notch 100 Hz"]


def test_a_single_spike_does_not_pass_the_median():
    x = np.zeros((50, 6))
    x[20] = 5000.0
    assert not np.any(through(Median(3, RATE), x))


def test_a_filter_that_is_reset_takes_the_next_sample_as_having_stood_for_ever():
    stage = low_pass(5.0, 2, RATE)
    through(stage, np.zeros((50, 6)))
    stage.reset()
    np.testing.assert_allclose(stage.step(np.full(6, 7.0)), 7.0)


def test_delay_is_told_as_path_and_deviation():
    stages = [Median(5, RATE), low_pass(40.0, 2, RATE)]
    cost = delay_cost(stages, feed=0.07, deflection_slope=1e-3)
    assert cost.delay == pytest.approx(stages[0].delay + stages[1].delay)
    assert cost.path == pytest.approx(0.07 * cost.delay)
    assert cost.deviation == pytest.approx(1e-3 * cost.path)
    assert "ms" in str(cost)


@pytest.mark.parametrize(("make", "text"), [
    (lambda: low_pass(125.0, 2, RATE), "125 Hz"), (lambda: low_pass(20.0, 9, RATE), "order 9"),
    (lambda: notch(200.0, 5.0, RATE), "50 Hz"), (lambda: notch(20.0, 0.1, RATE), "quality"),
    (lambda: Median(4, RATE), "4 samples"),
    (lambda: delay_cost([], float("nan"), 1.0), "numbers"),
])  # fmt: skip
def test_filters_that_can_not_be_are_refused_with_the_value(make, text):
    with pytest.raises(SettingsError, match=text):
        make()
