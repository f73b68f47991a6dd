# SPDX-License-Identifier: Apache-2.0
"""What makes the correction worse without being a fault is told: old readings, another rate than that of the filters."""

from __future__ import annotations

import numpy as np
import pytest
from irec_correction.input_quality import LASTS, WINDOW, InputQuality

RATE = 250.0


def told(rate: float, age: float, seconds: float = 6.0, jitter: float = 0.0, expected: float = RATE) -> list[str]:
    """After readings at a rate, each as old as that when it comes in; `jitter`: now and then one is older by up to so much, s."""
    quality, rng = InputQuality({"wrench": expected}), np.random.default_rng(0)
    now = 100.0
    for k in range(round(rate * seconds)):
        stamp = 100.0 + k / rate
        now = max(now, stamp + age + (jitter * rng.random() if rng.random() < 0.01 else 0.0))
        quality.take("wrench", stamp, now)
    return list(quality.cautions(now))


def test_sound_readings_are_not_told_whatever_a_loaded_machine_does_to_some_of_them():
    assert told(RATE, 0.005) == []
    assert told(RATE, 0.02, jitter=0.2) == []


def test_readings_that_are_all_old_are_told():
    assert "wrench is 80 ms old when it comes in, more than 50 ms" in told(RATE, 0.08)[0]


@pytest.mark.parametrize("rate", [100.0, 55.0, 500.0])
def test_a_rate_that_the_filters_are_not_designed_for_is_told_after_some_seconds(rate):
    (text,) = told(rate, 0.0)
    assert f"wrench comes {rate:.0f} times a second, the filters are designed for 250 (wrench_rate)" in text
    assert told(rate, 0.0, seconds=(LASTS - 0.5) * WINDOW) == []
    assert told(rate, 0.0, expected=0.0) == []


@pytest.mark.parametrize("rate", [200.0, 330.0])
def test_a_rate_near_that_is_not_told(rate):
    assert told(rate, 0.0) == []


def test_after_a_silence_or_a_clock_that_was_set_nothing_old_is_told():
    quality = InputQuality({"wrench": RATE})
    for begin in (0.0, 100.0, 50.0):
        for k in range(120):
            quality.take("wrench", begin + 0.01 * k - 0.1, begin + 0.01 * k)
        assert len(quality.cautions(begin + 1.2)) == 1
        assert quality.cautions(begin + 10.0) == [] and quality.cautions(begin - 10.0) == []
        quality.take("wrench", begin + 20.0, begin + 20.0)
        assert quality.cautions(begin + 20.0) == []
