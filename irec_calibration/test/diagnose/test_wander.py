# SPDX-License-Identifier: Apache-2.0
"""Tracker noise that wanders within minutes is noise: it is told, and nothing is found in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from absolute_sessions import THREE_MARKERS, session, torsion
from irec_calibration.diagnose import diagnose
from irec_calibration.diagnose.wander import wandering
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.marker_noise import by_marker
from irec_calibration.identification.noise import Wander, Whitening
from irec_calibration.identification.observe import observe
from irec_calibration.session import Marker, Noise, Session
from numpy.typing import NDArray

Array = NDArray[np.float64]
NOISE = Noise(tracker_m=1.5e-5)
LOADED_NOISE = Noise(tracker_m=8e-6, tracker_m_per_m=2e-6)
SIZE, TIME = 4e-5, 40.0  # m, s; of what wanders in the sessions here


def course(stamp: Array, seed: int, time: float = TIME) -> Array:
    """A stationary course of unit variance with an exponential correlation in time, (n, 3)."""
    rng = np.random.default_rng(seed)
    times, of_row = np.unique(stamp, return_inverse=True)
    out = rng.standard_normal((len(times), 3))
    for i in range(1, len(times)):
        keep = np.exp(-(times[i] - times[i - 1]) / time)
        out[i] = keep * out[i - 1] + np.sqrt(1.0 - keep**2) * out[i]
    return np.asarray(out[of_row])


def wandered(seed: int, poses: int = 100) -> Session:
    """Two markers of a robot with wrong geometry alone, seen by a tracker that wanders, poses in an order that was planned."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.3, 1.3, (poses, 6))
    q = q[np.lexsort((q[:, 1], np.round(2.0 * q[:, 0])))]
    markers = (Marker("M", "tool0", (0.03, -0.02, 0.1), known=False), Marker("B", "base_link", (0.3, 0.1, 0.0), known=False))
    return session(
        poses=poses, seed=seed, noise=NOISE, q=q, markers=markers, moved=lambda s, p: SIZE * course(s.stamp, seed)
    )  # fmt: skip


def test_correlated_noise_is_whitened_across_groups_that_share_more() -> None:
    rng = np.random.default_rng(1)
    n, draws = 12, 20000
    stamp, group = np.repeat(np.arange(n / 2) * 7.0, 2), np.repeat(np.arange(n // 2), 2)
    sigma, shared = rng.uniform(1e-5, 3e-5, n), np.repeat(rng.uniform(1e-5, 3e-5, n // 2), 2)
    wander = Wander(0.7, 20.0, stamp, np.zeros(n, dtype=np.int64), sigma)
    whiten = Whitening(sigma, shared, group, wander=wander)
    slow = np.stack([course(stamp, i, 20.0) for i in range(draws)], axis=2)
    fast = rng.standard_normal((n, 3, draws))
    together = rng.standard_normal((n // 2, 3, draws))[group]
    noise = sigma[:, None, None] * (np.sqrt(0.7) * slow + np.sqrt(0.3) * fast) + shared[:, None, None] * together
    white = whiten(noise)
    covariance = np.einsum("iad,jad->ij", white, white) / (3 * draws)
    np.testing.assert_allclose(covariance, np.eye(n), atol=0.03)
    np.testing.assert_allclose(whiten.undo(white), noise, atol=1e-12)
    np.testing.assert_allclose(whiten.scaled(2.0)(noise), white / 2.0, atol=1e-9)


def test_what_the_markers_of_a_pose_have_in_common_is_whitened_where_it_wanders() -> None:
    rng = np.random.default_rng(1)
    n, draws = 12, 20000
    stamp, group = np.repeat(np.arange(n / 2) * 7.0, 2), np.repeat(np.arange(n // 2), 2)
    sigma, shared = rng.uniform(1e-5, 3e-5, n), np.full(n, 2.5e-5)
    wander = Wander(0.7, 20.0, stamp, np.zeros(n, dtype=np.int64), shared, common=group)
    whiten = Whitening(sigma, shared, group, wander=wander)
    slow = np.stack([course(stamp, i, 20.0) for i in range(draws)], axis=2)
    once = rng.standard_normal((n // 2, 3, draws))[group]
    own = sigma[:, None, None] * rng.standard_normal((n, 3, draws))
    white = whiten(own + shared[:, None, None] * (np.sqrt(0.7) * slow + np.sqrt(0.3) * once))
    covariance = np.einsum("iad,jad->ij", white, white) / (3 * draws)
    np.testing.assert_allclose(covariance, np.eye(n), atol=0.03)


def test_noise_that_wanders_is_found_in_what_several_markers_have_in_common() -> None:
    rng = np.random.default_rng(3)
    markers = tuple(Marker(n, "tool0", (0.1 * i, -0.02, 0.1), known=False) for i, n in enumerate("ABC"))
    plain = observe(session(poses=100, noise=NOISE, markers=markers))
    stamp = plain.session.stamp[plain.rows]
    noise = SIZE * course(stamp, 5) + NOISE.tracker_m * rng.standard_normal((len(stamp), 3))
    wander = wandering(by_marker(plain, noise), noise).whiten.wander
    assert wander is not None
    assert wander.common is not None
    assert wander.share > 0.8  # truly 1
    assert 12.0 <= wander.time <= 75.0  # truly 40


def test_the_size_of_noise_that_wanders_is_what_is_left_in_differences() -> None:
    stamp, sigma, group = np.array([10.0, 20.0, 30.0]), np.full(3, 2e-5), np.zeros(3, dtype=np.int64)
    wander = Wander(0.8, 40.0, stamp, group, sigma, np.zeros(3), sigma)
    whiten = Whitening(sigma, sigma, group, wander=wander)
    draws = np.stack([course(np.array([0.0, 10.0, 20.0, 30.0]), i) for i in range(20000)], axis=2)
    rng = np.random.default_rng(0)
    noise = 2e-5 * (np.sqrt(0.8) * draws + np.sqrt(0.2) * rng.standard_normal(draws.shape))
    differences = noise[1:] - noise[0]
    assert np.isclose(whiten.floor, np.sqrt((differences**2).sum(axis=1).mean()), rtol=0.01)
    assert np.isclose(whiten.scaled(3.0).floor, 3.0 * whiten.floor)


def test_noise_of_an_absolute_session_that_wanders_is_found_with_its_time() -> None:
    observation = observe(wandered(3))
    rng = np.random.default_rng(2)
    fast = NOISE.tracker_m * rng.standard_normal((len(observation.rows), 3))
    slow = SIZE * course(observation.session.stamp[observation.rows], 5)
    found = wandering(observation, fast + slow).whiten.wander
    assert found is not None
    assert 0.7 <= found.share <= 0.95  # truly 0.88
    assert 12.0 <= found.time <= 75.0
    assert wandering(observation, fast).whiten.wander is None


@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.long) for s in (2, 13, 14))])
def test_nothing_is_found_in_an_absolute_session_whose_tracker_wanders(seed: int) -> None:
    found = diagnose(wandered(seed))
    assert found.verdict.status == "adequate"
    assert found.noise is not None
    assert found.noise.wander_share > 0.5


def test_a_slow_drift_of_an_absolute_session_does_not_pass_for_noise_that_wanders() -> None:
    def drift(s: Session, p: Array) -> Array:
        return 2e-4 * (s.stamp / s.stamp.max())[:, None] * np.array([0.6, 0.0, 0.8])

    found = diagnose(session(poses=100, noise=NOISE, moved=drift))
    assert found.verdict.status != "adequate"


def slow(course_of: Callable[[Array], Array], seed: int) -> Session:
    """Three markers of a robot on soft gears, poses 45 s apart, displaced besides by a course (n, 3), m, of the share of time."""
    bends = torsion(np.array([2e-6, 3e-6, 4e-6, 1e-5, 1e-5, 2e-5]))

    def moved(s: Session, p: Array) -> Array:
        return np.asarray(bends(s, p) + course_of(s.stamp / s.stamp.max()))

    found = session(poses=45, seed=seed, noise=Noise(tracker_m=1.2e-5), markers=THREE_MARKERS, moved=moved)
    return replace(found, stamp=9.0 * found.stamp)


@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.long)])
def test_a_step_beside_springs_that_are_not_known_yet_does_not_pass_for_noise_that_wanders(seed: int) -> None:
    found = diagnose(slow(lambda share: 2e-4 * np.outer(share > 0.5, [0.6, 0.5, -0.62]), seed))
    assert set(found.verdict.effects) == {"joint_torsion", "station_shift"}


@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.long)])
def test_a_cell_that_warms_up_beside_springs_that_are_not_known_yet_does_not_pass_for_noise_that_wanders(seed: int) -> None:
    found = diagnose(slow(lambda share: 4e-4 * np.outer(-np.expm1(-1.3 * share), [0.6, 0.5, -0.62]), seed))
    assert set(found.verdict.effects) == {"joint_torsion", "thermal_drift"}


@pytest.mark.parametrize(("times", "evidence", "depends_on"), [(2.0, (), ()), (5.0, ("wandering",), ("stamp",))])
def test_what_wanders_far_beyond_the_stated_noise_while_the_robot_stands_still_is_something_that_moves(
    times, evidence, depends_on
) -> None:
    stated = LOADED_NOISE.tracker_m + 2.5 * LOADED_NOISE.tracker_m_per_m

    def sways(scene: Scene) -> Array:
        return times * stated * course(scene.stamp, 3, 60.0)

    verdict = diagnose(synthetic.session(poses=40, seed=3, noise=LOADED_NOISE, extra=sways)).verdict
    assert (verdict.status, verdict.evidence) == ("unexplained" if evidence else "adequate", evidence), verdict.text
    assert verdict.depends_on == depends_on
    assert (verdict.remaining_m > 3.0 * stated) == bool(evidence)
