# SPDX-License-Identifier: Apache-2.0
"""The level of the noise: a claim of a few equations' worth that data overrule."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.identification.noise import Whitening, level_of, pure_error

CLAIM = 3e-5


@given(st.floats(0.02, 3.0))
def test_many_equations_overrule_the_claim(times: float) -> None:
    found = level_of(CLAIM, 400.0 * times**2, 400.0, "residual", 4.0)
    assert found.inferred_m == pytest.approx(CLAIM * times, rel=0.05)
    assert found.low_m < found.inferred_m < found.high_m


def test_without_data_the_claim_stands_within_a_factor_of_two() -> None:
    found = level_of(CLAIM, 0.0, 0.0, "claim", 4.0)
    assert found.inferred_m == pytest.approx(CLAIM)
    assert found.high_m > 2.0 * CLAIM
    assert not found.differs


def test_pure_error_does_not_depend_on_what_repeats_have_in_common() -> None:
    rng = np.random.default_rng(1)
    keys = np.repeat(np.arange(50), 3)
    scatter = rng.normal(0.0, 1.0, (150, 3))
    shared = rng.normal(0.0, 100.0, (50, 3))[keys]
    chi2, dof = pure_error(scatter + shared, keys)
    assert dof == 300
    assert chi2 == pytest.approx(300.0, rel=0.3)
    assert pure_error(scatter, np.arange(150)) == (0.0, 0)


def test_a_scaled_level_scales_whitened_rows_and_remembers_the_claim() -> None:
    whiten = Whitening(np.full(4, 2e-5), np.full(4, 1e-5), np.array([0, 0, 1, 1]))
    twice = whiten.scaled(2.0)
    x = np.arange(12.0).reshape(4, 3)
    assert np.allclose(twice(x), whiten(x) / 2.0)
    assert twice.claimed_floor == pytest.approx(whiten.floor)
    assert twice.only(np.array([0, 1])).level == 2.0
