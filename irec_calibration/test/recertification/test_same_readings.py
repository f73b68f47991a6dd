# SPDX-License-Identifier: Apache-2.0
"""What scatters between visits of a pose is told from what comes again at each of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.identification.identify import identify, observe_with_force_noise
from irec_calibration.model import EIGHTEEN_DOF, blank_model, total_displacement
from irec_calibration.recertification.quick_check import check, reference_of
from irec_calibration.recertification.quick_plan import plan
from irec_calibration.recertification.same_readings import Level, covariance_of_rows, level_of, places, same_readings
from irec_calibration.session import Session

PLACES, VISITS = 8, 6


def visits(seed: int = 3, misfit: float = 0.0, places_seed: int = 1) -> Session:
    """Some poses, each measured several times; a misfit (m) that belongs to pose and load case comes again each time."""
    q = np.random.default_rng(places_seed).uniform(*synthetic.JOINTS, (PLACES, 6))
    session = synthetic.session(PLACES * VISITS, seed, q_of_poses=np.repeat(q, VISITS, axis=0))
    rng = np.random.default_rng(places_seed + 100)
    own = rng.normal(0.0, misfit, (PLACES, 1 + session.load_case.max(), 3)) if misfit else np.zeros((PLACES, 9, 3))
    own[:, 0] = 0.0
    marker = session.p_marker_in_station + own[(session.pose - 1) // VISITS, session.load_case]
    return replace(session, p_marker_in_station=marker, q=session.q + rng.normal(0.0, 1e-5, session.q.shape))


def level(session: Session) -> Level | None:
    fit = identify(session, blank_model(EIGHTEEN_DOF)).terms
    observation = observe_with_force_noise(session, fit)
    left = observation.y - observation.of(total_displacement(fit, observation.scene))
    total = float(np.sqrt(np.mean(observation.whiten(left) ** 2)))
    return level_of(observation, same_readings(observation), left, total)


def test_readings_of_one_pose_and_load_case_are_the_same_though_the_robot_stands_a_little_off() -> None:
    session = visits()
    observation = observe_with_force_noise(session, blank_model(EIGHTEEN_DOF))
    assert len(np.unique(places(observation))) == PLACES
    numbers, counts = np.unique(same_readings(observation), return_counts=True)
    assert len(numbers) == PLACES * len(np.unique(session.load_case[session.load_case > 0])) and set(counts.tolist()) == {VISITS}


def test_white_noise_is_all_scatter_and_a_misfit_of_the_model_is_none() -> None:
    plain, misfit = level(visits()), level(visits(misfit=6e-5))
    assert plain is not None and misfit is not None
    assert plain.scatter == pytest.approx(1.0, abs=0.1) and plain.lasting < 0.4
    assert misfit.scatter == pytest.approx(plain.scatter, rel=0.05), "the misfit comes again, it does not scatter"
    assert misfit.lasting > 1.0
    assert misfit.of_means(VISITS) > plain.of_means(VISITS)


def test_without_readings_taken_again_nothing_is_told_apart() -> None:
    assert level(synthetic.session(12, 3)) is None


def test_more_visits_make_the_scatter_smaller_and_not_what_comes_again() -> None:
    own, same = np.diag([4e-10, 4e-10]), np.array([0, 1])
    once = covariance_of_rows(Level(1.0, 0.5), own, same)
    often = covariance_of_rows(Level(1.0, 0.5), own, same, np.array([4.0, 4.0]))
    np.testing.assert_allclose(np.diag(once), 4e-10 * 1.25)
    np.testing.assert_allclose(np.diag(often), 4e-10 * (0.25 + 0.25))
    together = covariance_of_rows(Level(1.0, 0.5), own, np.array([0, 0]))
    assert together[0, 1] == pytest.approx(0.25 * 4e-10)


def test_a_misfit_that_was_there_when_the_robot_was_calibrated_raises_no_alarm_however_often_its_poses_are_visited() -> None:
    """Poses of the calibration, each with something in each load case that no effect describes, then and now."""
    rng = np.random.default_rng(8)
    misfit = rng.normal(0.0, 4e-5, (25, 9, 3))
    misfit[:, 0] = 0.0
    session = synthetic.session(25, 5)
    session = replace(session, p_marker_in_station=session.p_marker_in_station + misfit[session.pose - 1, session.load_case])
    q = session.q[:: len(session.q) // 25]
    reference = reference_of(identify(session, blank_model(EIGHTEEN_DOF)).terms, session, 3e-4)
    chosen = plan(reference)
    at = np.array(chosen.poses) - 1
    for seed in range(3):
        now = synthetic.session(len(at), 70 + seed, q_of_poses=q[at])
        now = replace(now, p_marker_in_station=now.p_marker_in_station + misfit[at[now.pose - 1], now.load_case])
        for n in chosen.looks:
            assert check(reference, now.select_poses(list(range(1, n + 1))), chosen.sizes).decision != "changed"
