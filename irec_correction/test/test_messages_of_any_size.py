# SPDX-License-Identifier: Apache-2.0
"""Messages of the correction stay lines that can be read, whatever a value is."""

import numpy as np
import pytest
from irec_correction.obedience import Obedience
from irec_correction.watchdog import Watchdog, WatchdogSettings


@pytest.mark.parametrize("value", [1e7, 1e308])
def test_a_value_of_any_size_is_told_in_a_line_that_can_be_read(value):
    watchdog = Watchdog(WatchdogSettings(), np.full(6, 2.0))
    reading = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert watchdog.accept_wrench(0.0, 0.0, "tool0", reading) and watchdog.accept_joints(0.0, 0.0, np.zeros(6))
    texts = []
    watchdog.accept_wrench(0.004, 0.004, "tool0", value * reading)
    texts.append(watchdog.untrusted(0.004).text)
    watchdog.accept_wrench(0.008, 0.008, "tool0", reading)
    watchdog.accept_joints(0.008, 0.008, np.full(6, value))
    texts.append(watchdog.untrusted(0.008).text)
    watchdog.accept_joints(value, 0.012, np.zeros(6))
    texts.append(watchdog.untrusted(0.012).text)
    assert [f"{value:.3g} N" in texts[0], f"{value:.3g} rad" in texts[1], f"+{value:.3g} s" in texts[2]] == [True] * 3, texts
    assert max(map(len, texts)) < 140


def test_a_driver_that_reports_an_offset_of_any_size_is_told_in_a_line_that_can_be_read():
    obedience = Obedience(lasts=0.0)
    obedience.sent(0.0, np.array([1e-4, 0.0, 0.0]))
    text = obedience.wrong(0.0, 0.0, np.array([1e100, 0.0, 0.0]))
    assert "1e+103" in text and len(text) < 250
