# SPDX-License-Identifier: Apache-2.0
"""Samples of a normal distribution that is cut at bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import SolveError
from irec_calibration.identification.cut_normal import samples

NOWHERE = np.inf


def drawn(mean, covariance, lower, upper, count=20000, seed=0):
    mean, lower, upper = (np.asarray(v, dtype=float) for v in (mean, lower, upper))
    start = np.clip(mean, lower, upper)
    return samples(mean, np.linalg.inv(covariance), lower, upper, start, count, np.random.default_rng(seed))


def test_without_bounds_mean_and_covariance_are_those_of_the_normal_distribution() -> None:
    covariance = np.array([[2.0, 1.2], [1.2, 1.0]])
    x = drawn([1.0, -3.0], covariance, [-NOWHERE] * 2, [NOWHERE] * 2)
    np.testing.assert_allclose(x.mean(axis=0), [1.0, -3.0], atol=0.05)
    np.testing.assert_allclose(np.cov(x.T), covariance, atol=0.08)


@pytest.mark.parametrize("mean, expected, square", [(0.0, 0.79788, 1.0), (-2.0, 0.37322, 0.25357)])
def test_cut_at_zero_the_moments_are_those_of_the_cut_distribution(mean: float, expected: float, square: float) -> None:
    """Of N(mean, 1) above 0: mean + phi(mean) / Phi(mean), and 1 + mean times that."""
    x = drawn([mean], np.eye(1), [0.0], [NOWHERE], count=50000)
    np.testing.assert_allclose([x.mean(), (x**2).mean()], [expected, square], rtol=0.04)


def test_two_that_are_not_negative_and_whose_sum_is_known_are_each_no_larger_than_the_sum() -> None:
    wide, narrow = 100.0, 0.1  # standard deviations of their difference and of their sum
    turn = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
    covariance = turn.T @ np.diag([narrow**2, wide**2]) @ turn
    x = drawn([1.0, 1.0], covariance, [0.0, 0.0], [NOWHERE] * 2)
    assert x.max() < 2.6
    np.testing.assert_allclose(x.std(axis=0), 2.0 / np.sqrt(12.0), rtol=0.1)  # all over the line between both ends


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 8), st.integers(0, 2**31), st.floats(-3.0, 3.0))
def test_no_sample_is_outside_of_the_bounds(p: int, seed: int, off: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((p, p)) + 0.3 * np.eye(p)
    lower = np.where(rng.uniform(size=p) < 0.7, rng.uniform(-1.0, 0.0, p), -np.inf)
    upper = np.where(rng.uniform(size=p) < 0.5, rng.uniform(0.0, 1.0, p), np.inf)
    x = drawn(np.full(p, off), root @ root.T + 1e-3 * np.eye(p), lower, upper, count=200, seed=seed)
    assert ((x >= lower - 1e-12) & (x <= upper + 1e-12)).all() and np.isfinite(x).all()


def test_a_value_that_is_held_between_equal_bounds_stays_there() -> None:
    x = drawn([0.5, 0.0], np.eye(2), [0.5, -NOWHERE], [0.5, NOWHERE], count=500)
    assert np.all(x[:, 0] == 0.5) and x[:, 1].std() > 0.3


def test_what_is_no_precision_is_refused() -> None:
    nothing, one = np.zeros(2), np.ones(2)
    with pytest.raises(SolveError, match="not positive definite"):
        samples(nothing, np.array([[1.0, 2.0], [2.0, 1.0]]), nothing, one, nothing, 10, np.random.default_rng(0))
