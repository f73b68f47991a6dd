# SPDX-License-Identifier: Apache-2.0
"""Selection: what COVER, IOOPS, D- and I-optimality promise."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import PlanError
from irec_calibration.poses.blocks import identifiable_subspace, observability, predicted_uncertainty
from irec_calibration.poses.select import METHODS, Candidates, cover, cover_distance, select_poses


def random_candidates(seed, n=40, p=6, rank=None):
    """Pose blocks of 15 rows and p columns; where rank < p, columns are linear in each other."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(n, 15, rank or p)) * rng.exponential(size=(n, 1, 1))
    if rank:
        rows = rows @ rng.normal(size=(rank, p))
    grams = rows.swapaxes(1, 2) @ rows
    subspace = identifiable_subspace(grams)
    reduced = subspace.reduce(grams)
    points = rng.uniform(size=(n, 3))
    return rows, subspace, Candidates(points, None, reduced, reduced, reduced.mean(axis=0))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 60), k=st.integers(1, 60), d_max=st.floats(0.0, 0.8))
def test_cover_stops_at_n_poses_or_when_every_candidate_is_within_d_max(seed, n, k, d_max):
    points = np.random.default_rng(seed).uniform(size=(n, 3))
    chosen = cover(points, min(k, n), d_max)
    assert len(set(chosen)) == len(chosen) <= min(k, n)
    reached = cover_distance(Candidates(points), chosen)
    if len(chosen) < min(k, n):
        assert reached <= d_max
    if len(chosen) > 1:
        assert cover_distance(Candidates(points), chosen[:-1]) > d_max  # no pose was spent that d_max did not ask for


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_cover_begins_nearest_the_centroid_and_each_pose_is_the_farthest_from_all_before(seed):
    points = np.random.default_rng(seed).uniform(size=(50, 3))
    chosen = cover(points, 12)
    assert chosen[0] == np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1))
    for i in range(1, 12):
        nearest = np.linalg.norm(points[:, None] - points[chosen[:i]], axis=2).min(axis=1)
        assert nearest[chosen[i]] == pytest.approx(nearest.max())


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_cover_is_at_most_twice_as_wide_as_the_best_cover(seed):
    points = np.random.default_rng(seed).uniform(size=(12, 3))
    best = min(cover_distance(Candidates(points), np.array(s)) for s in itertools.combinations(range(12), 3))
    assert cover_distance(Candidates(points), cover(points, 3)) <= 2 * best + 1e-12


def test_cover_measures_with_the_distance_that_it_is_given():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    table = np.array([[0, 1, 9, 1], [1, 0, 9, 1], [9, 9, 0, 9], [1, 1, 9, 0.0]])  # index 2 lies on the far side of a gap
    assert list(cover(points, 2, first=np.array([0]))) == [0, 1]
    assert list(cover(points, 2, first=np.array([0]), distance=lambda i: table[i])) == [0, 2]


def ioops_with_one_svd_per_candidate(rows, n, seed):
    """Pseudocode 1 to the letter: the product of singular values of every candidate set."""

    def o1(poses):
        s = np.linalg.svd(np.concatenate(rows[poses]), compute_uv=False)
        return np.sum(np.log(s))

    chosen = list(np.random.default_rng(seed).choice(len(rows), size=n, replace=False))
    while True:
        others = [i for i in range(len(rows)) if i not in chosen]
        chosen.append(max(others, key=lambda i: o1([*chosen, i])))
        worst = max(range(n + 1), key=lambda k: o1(chosen[:k] + chosen[k + 1 :]))
        last = worst == n
        chosen.pop(worst)
        if last:
            return chosen


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_ioops_chooses_what_one_svd_per_candidate_chooses(seed):
    rows, _, candidates = random_candidates(seed)
    chosen = select_poses("ioops", candidates, 8, seed=seed)
    assert set(chosen) == set(ioops_with_one_svd_per_candidate(rows, 8, seed))


def test_o1_is_the_geometric_mean_of_the_singular_values_over_the_root_of_the_number_of_rows():
    rows, subspace, candidates = random_candidates(3)
    chosen = np.arange(5)
    s = np.linalg.svd(np.concatenate(rows[chosen]), compute_uv=False)
    expected = np.prod(s) ** (1 / 6) / np.sqrt(75)
    assert observability(candidates.gram[chosen].sum(axis=0), subspace, 75) == pytest.approx(expected, rel=1e-9)


def test_o1_of_rank_deficient_columns_takes_the_identifiable_singular_values_only():
    rows, subspace, candidates = random_candidates(4, p=9, rank=6)
    s = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    assert subspace.rank == 6
    o1 = observability(candidates.gram.sum(axis=0), subspace, rows.shape[0] * 15)
    assert o1 == pytest.approx(np.prod(s[:6]) ** (1 / 6) / np.sqrt(rows.shape[0] * 15), rel=1e-6)


def test_a_column_of_rounding_errors_is_not_taken_for_an_identifiable_parameter():
    grams = np.array([np.diag([1e6, 4e6, 1e-18]), np.diag([3e6, 1e6, 2e-18])])
    assert identifiable_subspace(grams).rank == 2


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_d_optimal_poses_hold_at_least_the_information_of_ioops_and_random_ones(seed):
    _, _, candidates = random_candidates(seed)

    def information(method):
        chosen = select_poses(method, candidates, 8, seed=seed)
        return np.linalg.slogdet(candidates.information[chosen].sum(axis=0))[1]

    assert information("d_optimal") >= information("ioops") - 1e-9
    assert information("d_optimal") >= information("random") - 1e-9


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_i_optimal_poses_predict_the_work_poses_at_least_as_well_as_d_optimal_ones(seed):
    _, _, candidates = random_candidates(seed)

    def variance(method):
        S = candidates.information[select_poses(method, candidates, 8, seed=seed)].sum(axis=0)
        return np.trace(np.linalg.solve(S, candidates.work))

    assert variance("i_optimal") <= variance("d_optimal") * (1 + 1e-9)


def test_predicted_uncertainty_is_the_scatter_of_predictions_over_repeated_calibrations():
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(10, 15, 4))
    work = rng.normal(size=(3, 2, 3, 4))
    sigma = 0.3
    grams = rows.swapaxes(1, 2) @ rows
    subspace = identifiable_subspace(grams)
    predicted = predicted_uncertainty(subspace.reduce(grams.sum(axis=0)) / sigma**2, subspace, work)
    A = np.concatenate(rows)
    errors = np.linalg.lstsq(A, sigma * rng.normal(size=(len(A), 4000)), rcond=None)[0]
    scatter = np.sqrt(np.mean(np.sum((work @ errors) ** 2, axis=2), axis=2))
    np.testing.assert_allclose(predicted, scatter, rtol=0.05)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_returns_as_many_different_poses_as_asked_for(method):
    _, _, candidates = random_candidates(6)
    for n in (1, 7, 40):
        chosen = select_poses(method, candidates, n)
        assert len(set(chosen.tolist())) == n


@pytest.mark.parametrize(
    ("method", "n", "said"),
    [
        ("cover", 41, "41 poses were asked for, the pool has 40"),
        ("cover", 0, "0 poses were asked for"),
        ("simplex", 3, "unknown method 'simplex'"),
    ],
)
def test_a_selection_that_is_not_possible_is_refused_with_the_counts(method, n, said):
    _, _, candidates = random_candidates(7)
    with pytest.raises(PlanError, match=said):
        select_poses(method, candidates, n)


def test_an_empty_pool_is_refused():
    with pytest.raises(PlanError, match="pool is empty"):
        select_poses("cover", Candidates(np.empty((0, 3))), 3)
    with pytest.raises(PlanError, match="pool is empty"):
        identifiable_subspace(np.empty((0, 6, 6)))
