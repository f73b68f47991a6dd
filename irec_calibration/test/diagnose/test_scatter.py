# SPDX-License-Identifier: Apache-2.0
"""Readings under columns and scatter of unknown size are as likely as the normal distribution says."""

from __future__ import annotations

import numpy as np
import pytest
from irec_calibration.diagnose.scatter import LEVELS, Scattered
from scipy.stats import multivariate_normal


@pytest.mark.parametrize(("rows", "columns"), [(20, 8), (6, 30)])
def test_the_evidence_is_that_of_a_normal_distribution_averaged_over_the_scatter(rows: int, columns: int) -> None:
    rng = np.random.default_rng(1)
    A = 1e-4 * rng.normal(size=(rows, 3, columns))
    values = np.einsum("nip,p->ni", A, rng.normal(size=columns)) + rng.normal(0.0, 3e-5, (rows, 3))
    flat = A.reshape(-1, columns)
    each = [multivariate_normal(cov=flat @ flat.T + s**2 * np.eye(3 * rows)).logpdf(values.ravel()) for s in LEVELS]
    constant = 1.5 * rows * np.log(2.0 * np.pi)
    expected = np.logaddexp.reduce(each) - np.log(len(LEVELS)) + constant
    assert Scattered(A).log_evidence(values) == pytest.approx(expected, abs=1e-6)


def test_the_values_of_the_columns_are_found_beside_the_scatter() -> None:
    rng = np.random.default_rng(2)
    A, x = 1e-3 * rng.normal(size=(60, 3, 5)), np.array([1.0, -2.0, 0.5, 0.0, 1.5])
    values = A @ x + rng.normal(0.0, 4e-5, (60, 3))
    np.testing.assert_allclose(Scattered(A).fitted(values)[1], x, atol=0.03)


def test_large_columns_beside_small_scatter_lose_no_digits() -> None:
    rng = np.random.default_rng(3)
    A = np.concatenate([np.tile(np.eye(3), (40, 1, 1)), 1e-4 * rng.normal(size=(40, 3, 4))], axis=2)
    values = np.array([0.7, -0.4, 0.2]) + A[:, :, 3:] @ np.ones(4) + rng.normal(0.0, 2e-5, (40, 3))
    with_all, without = (Scattered(A[:, :, :n]).log_evidence(values) for n in (7, 3))
    np.testing.assert_allclose(Scattered(A).fitted(values)[1][3:], 1.0, atol=0.1)
    assert with_all > without + 50.0
