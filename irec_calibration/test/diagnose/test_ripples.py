# SPDX-License-Identifier: Apache-2.0
"""How often an error repeats per turn of a joint, by what a residual shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.diagnose.ripples import _power, _strongest


def seen(seed: int, rows: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles of a joint, displacement by it, and a residual."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-2.0, 2.0, rows), rng.normal(size=(rows, 3)), rng.normal(size=(rows, 3))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), many=st.integers(2, 40), first=st.floats(3.0, 90.0), step=st.floats(0.05, 2.0))
def test_the_power_of_a_frequency_is_what_the_squared_residual_falls_by(seed, many, first, step):
    q, by_angle, residual = seen(seed)
    frequency = first + step * np.arange(many)
    fall = []
    for n in frequency:
        A = np.stack([by_angle * np.sin(n * q)[:, None], by_angle * np.cos(n * q)[:, None]], axis=2).reshape(-1, 2)
        left = residual.ravel() - A @ np.linalg.lstsq(A, residual.ravel(), rcond=None)[0]
        fall.append((residual**2).sum() - (left**2).sum())
    np.testing.assert_allclose(_power(q, by_angle, residual, frequency), fall, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("often", [10.5, 97.3, 160.0])
def test_a_ripple_is_found_at_its_frequency(often):
    q, by_angle, residual = seen(7, 400)
    residual = 0.3 * residual + by_angle * np.cos(often * q + 0.4)[:, None]
    found, _ = _strongest(q, by_angle, residual, np.arange(3.0, 400.0, 0.39))
    assert found == pytest.approx(often, abs=0.05)
