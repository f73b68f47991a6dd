# SPDX-License-Identifier: Apache-2.0
"""A driver that does something else with the offset than it is sent is told apart from one that is late."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from irec_correction.obedience import LASTS, Obedience

OFFSET = np.array([0.0, -0.2e-3, 0.4e-3])
PERIOD, REPORT = 0.004, 25  # s, and ticks from report to report: 10 Hz


def said(does: Callable[[Callable[[float], np.ndarray], float], np.ndarray], late_stamp: float = 0.0) -> str:
    """What is told of a driver within three seconds: `does` gives what it applies from the offsets sent by time, and now."""
    watched, told = Obedience(), ""

    def sent(t: float) -> np.ndarray:
        """Ramped in over half a second after a fifth of one, then swaying as under a process force."""
        share = min(max((t - 0.2) / 0.5, 0.0), 1.0)
        return share * OFFSET * (1.0 + 0.5 * np.sin(2.0 * np.pi * 0.7 * t))

    for k in range(round(3.0 / PERIOD)):
        now = k * PERIOD
        watched.sent(100.0 + now, sent(now))
        if k % REPORT == 0:
            told = watched.wrong(100.0 + now - late_stamp, 100.0 + now, does(sent, now)) or told
    return told


@pytest.mark.parametrize("latency", [0.0, 0.05, 0.15])
def test_a_driver_that_is_late_obeys(latency):
    assert said(lambda sent, now: sent(now - latency)) == ""
    assert said(lambda sent, now: sent(now - latency), late_stamp=0.1) == ""


def test_a_driver_that_fades_in_and_smooths_obeys():
    def smooth(sent, now):
        return min(now / 0.5, 1.0) * np.mean([sent(now - d) for d in np.arange(0.0, 0.1, PERIOD)], axis=0)

    assert said(smooth) == ""


def test_a_driver_that_reports_by_a_clock_of_its_own_obeys():
    assert said(lambda sent, now: sent(now - 0.05), late_stamp=1e9) == ""


@pytest.mark.parametrize(
    ("does", "words"),
    [
        (lambda sent, now: np.zeros(3), "it ignores it"),
        (lambda sent, now: 2.0 * sent(now), "it doubles it"),
        (lambda sent, now: -sent(now), "it applies it the other way round"),
        (lambda sent, now: sent(now)[[1, 0, 2]] * [1.0, 1.0, -1.0], "it turns it"),
        (lambda sent, now: sent(now) * 0.1e-3 / max(float(np.linalg.norm(sent(now))), 0.1e-3), "it cuts it"),
        (lambda sent, now: np.array([5e-3, 0.0, 0.0]), "it applies another one"),
        (lambda sent, now: np.full(3, np.nan), "it reports no number"),
    ],
)  # fmt: skip
def test_what_it_does_instead_is_told(does, words):
    text = said(does)
    assert words in text and "the driver reports offset (" in text and "mm was sent" in text


def test_a_moment_is_not_told():
    assert said(lambda sent, now: np.zeros(3) if 1.5 < now < 1.5 + LASTS - 0.2 else sent(now)) == ""


def test_an_offset_that_nobody_can_see_is_not_told_to_be_ignored():
    watched = Obedience()
    for k in range(1000):
        watched.sent(k * PERIOD, np.array([2e-5, 0.0, 0.0]))
        assert watched.wrong(k * PERIOD, k * PERIOD, np.zeros(3)) == ""


def test_nothing_is_expected_of_a_driver_that_is_sent_nothing():
    watched = Obedience()
    assert watched.wrong(0.0, 0.0, OFFSET) == ""
    watched.sent(0.0, np.zeros(3))
    watched.reset()
    assert watched.wrong(0.0, 0.0, OFFSET) == "" and watched.wrong(5.0, 5.0, OFFSET) == ""
