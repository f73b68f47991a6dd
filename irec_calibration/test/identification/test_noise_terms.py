# SPDX-License-Identifier: Apache-2.0
"""What the terms under `noise:` mean, as the session format says it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.identification.noise import position_sigma
from irec_calibration.session import Noise


def at_distance(noise: Noise, distance: float) -> float:
    session = synthetic.session(poses=1)
    p = np.zeros((len(session), 3))
    p[:, 0] = distance
    return float(position_sigma(replace(session, p_marker_in_station=p, noise=noise))[0])


def test_the_terms_of_a_tracker_add_linearly_with_the_distance():
    assert at_distance(Noise(7.5e-6, 3e-6), 5.0) == pytest.approx(22.5e-6)
    assert at_distance(Noise(7.5e-6, 3e-6), 0.0) == pytest.approx(7.5e-6)


def test_settling_is_another_cause_and_adds_in_squares():
    assert at_distance(Noise(3e-6, settling_m=4e-6), 2.0) == pytest.approx(5e-6)
