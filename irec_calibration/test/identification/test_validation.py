# SPDX-License-Identifier: Apache-2.0
"""Poses predicted from all others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.identification import validation
from irec_calibration.identification.bounded import solve_bounded_gram
from irec_calibration.identification.validation import floored, predicted_from_others
from irec_calibration.typing import Array, IntArray


@given(seed=st.integers(0, 10_000), bounded=st.floats(0.0, 1.0), rows_at_most=st.integers(1, 4))
def test_a_pose_is_predicted_as_a_fit_to_all_others_predicts_it(seed, bounded, rows_at_most):
    A, b, of_pose, lower, upper, precision = _problem(np.random.default_rng(seed), bounded, rows_at_most)
    left = predicted_from_others(A, b, of_pose, lower, upper, precision)
    assert left == pytest.approx(_one_by_one(A, b, of_pose, lower, upper, precision), rel=1e-6, abs=1e-8)


def test_a_parameter_that_one_pose_alone_tells_is_told_by_its_prior_there():
    A = np.zeros((12, 2))
    A[:, 0], A[:3, 1] = 1.0, 1e4
    b = A @ np.array([1.0, 2.0])
    of_pose = [np.arange(3 * k, 3 * k + 3) for k in range(4)]
    free = np.full(2, np.inf)
    left = predicted_from_others(A, b, of_pose, -free, free, np.array([0.0, 1.0]))
    assert left[:3] == pytest.approx(np.full(3, 2e4), rel=1e-3)


def test_many_poses_and_parameters_are_predicted_from_one_solution(monkeypatch):
    solved = []

    def counted(G, *others):
        solved.append(int(np.prod(np.shape(G)[:-2])))
        return solve_bounded_gram(G, *others)

    monkeypatch.setattr(validation, "solve_bounded_gram", counted)
    A, b, of_pose, lower, upper, precision = _problem(np.random.default_rng(1), 0.0, 2, poses=200, parameters=20)
    predicted_from_others(A, b, of_pose, lower, upper, precision)
    assert sum(solved) == 1


def _one_by_one(A: Array, b: Array, of_pose: list[IntArray], lower: Array, upper: Array, precision: Array) -> Array:
    ridge = np.diag(floored(precision, A.T @ A))
    out = np.empty_like(b)
    for rows in of_pose:
        others = np.setdiff1d(np.arange(len(b)), rows)
        x = solve_bounded_gram(A[others].T @ A[others] + ridge, A[others].T @ b[others], lower, upper)
        out[rows] = b[rows] - A[rows] @ x
    return out


def _problem(rng, bounded: float, rows_at_most: int, poses: int = 12, parameters: int = 9):
    sizes = 3 * rng.integers(1, rows_at_most + 1, poses)
    ends = np.cumsum(sizes)
    of_pose = [np.arange(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    A = rng.standard_normal((ends[-1], parameters))
    b = A @ rng.standard_normal(parameters) + rng.standard_normal(ends[-1])
    lower = np.where(rng.random(parameters) < bounded, -0.1, -np.inf)
    upper = np.where(rng.random(parameters) < 0.5 * bounded, 0.1, np.inf)
    return A, b, of_pose, lower, upper, np.where(rng.random(parameters) < 0.7, 1.0, 0.0)
