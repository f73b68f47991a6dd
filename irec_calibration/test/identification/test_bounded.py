# SPDX-License-Identifier: Apache-2.0
"""The bounded solver on the Gram matrix does what scipy's solver of the stacked system does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import SolveError
from irec_calibration.identification import bounded
from irec_calibration.identification.bounded import solve_bounded_gram
from scipy.optimize import lsq_linear


def problem(seed, rows, p, kind):
    """A least-squares problem with bounds of one of four kinds; columns scaled to length 1."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, p)) @ (np.eye(p) + 0.5 * rng.normal(size=(p, p)))
    A /= np.linalg.norm(A, axis=0)
    d = A @ rng.normal(size=p) + 0.1 * rng.normal(size=rows)
    lower = {"none": np.full(p, -np.inf), "lower": np.zeros(p)}.get(kind, rng.normal(size=p) - 0.5)
    upper = lower + rng.exponential(size=p) + 1e-3 if kind == "both" else np.full(p, np.inf)
    return A, d, lower, upper


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    p=st.integers(1, 20),
    extra=st.integers(3, 60),
    kind=st.sampled_from(["none", "lower", "both", "shifted"]),
)
def test_it_agrees_with_bounded_least_squares_of_the_stacked_system(seed, p, extra, kind):
    A, d, lower, upper = problem(seed, 2 * p + extra, p, kind)
    x = solve_bounded_gram(A.T @ A, A.T @ d, lower, upper)
    reference = lsq_linear(A, d, (lower, upper), method="bvls", tol=1e-15, max_iter=500)

    def cost(v):
        return np.sum((A @ v - d) ** 2)

    assert ((x >= lower) & (x <= upper)).all()
    assert cost(x) <= cost(reference.x) * (1 + 1e-9) + 1e-15
    if np.linalg.cond(A) < 1e3:
        np.testing.assert_allclose(x, reference.x, rtol=1e-6, atol=1e-8 * np.abs(reference.x).max())


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), p=st.integers(1, 20), log_ridge=st.floats(-9, -2))
def test_the_optimality_conditions_hold_for_rank_deficient_columns_with_a_ridge(seed, p, log_ridge):
    A, d, lower, upper = problem(seed, 3 * p, p, "both")
    A = np.hstack([A, A[:, : (p + 1) // 2]])  # every second column twice: rank p of 1.5 p
    lower, upper = np.append(lower, lower[: (p + 1) // 2]), np.append(upper, upper[: (p + 1) // 2])
    G = A.T @ A + 10**log_ridge * np.eye(A.shape[1])
    h = A.T @ d
    x = solve_bounded_gram(G, h, lower, upper)
    gradient = G @ x - h
    tolerance = 1e-12 * (np.abs(G) @ np.abs(x) + np.abs(h)).max()
    assert ((x >= lower) & (x <= upper)).all()
    assert (np.abs(gradient[(x > lower) & (x < upper)]) <= tolerance).all()
    assert (gradient[x == lower] >= -tolerance).all()
    assert (gradient[x == upper] <= tolerance).all()


def test_many_problems_at_once_give_what_each_gives_alone():
    problems = [problem(seed, 40, 6, kind) for seed in range(10) for kind in ("lower", "both")]
    G = np.array([A.T @ A for A, *_ in problems])
    h = np.array([A.T @ d for A, d, *_ in problems])
    lower, upper = (np.array([q[i] for q in problems]) for i in (2, 3))
    together = solve_bounded_gram(G, h, lower, upper)
    alone = [solve_bounded_gram(*args) for args in zip(G, h, lower, upper, strict=True)]
    np.testing.assert_allclose(together, alone, rtol=1e-10, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_start_does_not_change_the_result(seed):
    A, d, lower, upper = problem(seed, 40, 8, "both")
    start = np.where(np.random.default_rng(seed).random(8) < 0.5, lower, upper)
    cold = solve_bounded_gram(A.T @ A, A.T @ d, lower, upper)
    warm = solve_bounded_gram(A.T @ A, A.T @ d, lower, upper, start=start)
    np.testing.assert_allclose(warm, cold, rtol=1e-9, atol=1e-11)


def test_a_variable_with_equal_bounds_keeps_its_value():
    A, d, *_ = problem(1, 20, 4, "none")
    lower, upper = np.full(4, -np.inf), np.full(4, np.inf)
    lower[2] = upper[2] = 0.7
    x = solve_bounded_gram(A.T @ A, A.T @ d, lower, upper)
    others = np.linalg.lstsq(A[:, [0, 1, 3]], d - 0.7 * A[:, 2], rcond=None)[0]
    assert x[2] == 0.7
    np.testing.assert_allclose(x[[0, 1, 3]], others, rtol=1e-9)


@pytest.mark.parametrize(
    ("G", "h", "lower", "upper", "said"),
    [
        (np.ones((2, 2)), np.ones(2), 0.0, 1.0, "not positive definite"),
        (np.eye(2), np.ones(2), [0.0, 2.0], [1.0, 1.0], "parameter 1: lower bound 2 and upper bound 1"),
        (np.eye(2), np.array([np.nan, 1.0]), 0.0, 1.0, "not finite"),
        (np.eye(3), np.ones(2), 0.0, 1.0, "do not match"),
    ],
)
def test_a_problem_without_a_solution_is_refused_with_its_reason(G, h, lower, upper, said):
    with pytest.raises(SolveError, match=said):
        solve_bounded_gram(G, h, lower, upper)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), p=st.integers(1, 20), kind=st.sampled_from(["none", "lower", "both", "shifted"]))
def test_a_problem_that_exchanges_do_not_settle_has_the_same_solution(seed, p, kind):
    A, d, lower, upper = problem(seed, 3 * p + 5, p, kind)
    if kind != "none":
        lower[0] = upper[0] = 0.1
    usual = solve_bounded_gram(A.T @ A, A.T @ d, lower, upper)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bounded, "_MAX_SWEEPS", 0)
        x = solve_bounded_gram(A.T @ A, A.T @ d, lower, upper)
    np.testing.assert_allclose(x, usual, rtol=1e-6, atol=1e-7)
    assert ((x >= lower) & (x <= upper)).all() and (kind == "none" or x[0] == 0.1)
