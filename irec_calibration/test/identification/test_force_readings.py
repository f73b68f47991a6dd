# SPDX-License-Identifier: Apache-2.0
"""Where force readings of a load case differ, the arm tells how much of that is force; the rest is the sensor's noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.force_readings import scatter
from irec_calibration.identification.identify import identify, observe_with_force_noise
from irec_calibration.identification.observe import observe
from irec_calibration.model import EIGHTEEN_DOF, blank_model, total_displacement
from irec_calibration.session import Noise
from irec_calibration.session.data import Session

TRUE_SCATTER = 15.0  # N, of the force itself, as synthetic.session has it
TERMS = blank_model(EIGHTEEN_DOF)


def read_with(noise: float, stated: float | None = None, poses: int = 30, seed: int = 0) -> Session:
    """A session whose sensor has a noise, N, along each axis and in every row."""
    plain = synthetic.session(poses=poses, seed=8 + seed)
    rng = np.random.default_rng(3 + seed)
    read = plain.force_in_tool + noise * rng.normal(size=plain.force_in_tool.shape)
    return replace(plain, force_in_tool=read, noise=replace(plain.noise, force_n=noise if stated is None else stated))


def scatter_within_load_cases(session: Session) -> float:
    """Of the changes of the force against the reference that are used, N."""
    used = observe_with_force_noise(session, TERMS).session
    change = used.force_in_tool - used.force_in_tool[used.reference_row()]
    off = [change[used.load_case == c] for c in range(1, 6)]
    return float(np.sqrt(np.mean([np.var(f - np.median(f, axis=0)) for f in off])))


def test_noise_of_the_sensor_is_left_out_of_the_forces_as_far_as_the_arm_does_not_follow() -> None:
    noise = 20.0
    read = np.hypot(TRUE_SCATTER, np.sqrt(2.0) * noise)
    assert scatter_within_load_cases(read_with(noise)) == pytest.approx(TRUE_SCATTER**2 / read, abs=0.15 * read)


def test_forces_of_a_sensor_that_hardly_errs_are_used_as_they_are_read() -> None:
    session = read_with(1.0)
    np.testing.assert_array_equal(observe_with_force_noise(session, TERMS).session.force_in_tool, session.force_in_tool)


def test_no_more_is_left_out_than_twice_the_stated_noise_makes() -> None:
    session = read_with(20.0, stated=0.5)
    np.testing.assert_array_equal(observe_with_force_noise(session, TERMS).session.force_in_tool, session.force_in_tool)


def test_what_was_left_out_stands_in_the_notes() -> None:
    notes = observe_with_force_noise(read_with(20.0), TERMS).session.notes
    assert any("of tool0 within a load case, and the arm follows" in n for n in notes)


def test_springs_predict_other_poses_better_without_the_noise_of_the_sensor() -> None:
    quiet = observe(synthetic.session(poses=20, seed=77, noise=Noise(tracker_m=1e-9)))
    error = np.zeros(2)
    for seed in range(3):
        session = read_with(20.0, seed=seed)
        as_read = replace(session, noise=replace(session.noise, force_n=1e-3))  # then all of it counts as force
        for i, one in enumerate((session, as_read)):
            error[i] += float(((quiet.y - quiet.of(total_displacement(identify(one, TERMS).terms, quiet.scene))) ** 2).sum())
    assert error[0] < 0.7 * error[1]


def test_noise_of_the_force_sensor_that_is_stated_too_small_is_no_unknown_cause() -> None:
    assert diagnose(read_with(25.0, stated=18.0)).verdict.status == "adequate"


def usual_across_the_tool(session: Session) -> np.ndarray:
    """What is taken for the usual x of load case 2 and y of load case 5, which press by 280 N there, N."""
    observation = observe(session)
    found = scatter(observation, 0.0 * observation.y, np.zeros((len(session), 3, 3)))
    assert found is not None
    change = session.force_in_tool - session.force_in_tool[session.reference_row()] - found.off
    return np.array([np.median(change[session.load_case == case, k]) for case, k in ((2, 0), (5, 1))])


def test_a_load_case_usually_reads_what_it_was_meant_to_be_where_its_mean_agrees_with_that() -> None:
    session = read_with(20.0, poses=10)
    off_by = [np.abs(usual_across_the_tool(s) - 280.0).max() for s in (session, replace(session, load_cases={}))]
    assert off_by[0] < 0.5 * off_by[1]


def test_a_load_case_usually_reads_the_mean_of_its_readings_where_it_was_meant_to_be_another() -> None:
    session = read_with(20.0, poses=10)
    meant = {c: (1.5 * f[0], 1.5 * f[1], f[2]) for c, f in session.load_cases.items()}
    by_mean, taken = (usual_across_the_tool(replace(session, load_cases=cases)) for cases in ({}, meant))
    np.testing.assert_allclose(taken, by_mean, atol=5.0)


def stiffens(scene: Scene) -> np.ndarray:
    """Axis 1 gives way by 1e-6 rad/(N m) more where it bears less than 600 N m."""
    return scene.J[:, :, 0] * (1e-6 * 600.0 * np.tanh(scene.tau[:, 0] / 600.0))[:, None]


def test_a_gear_that_stiffens_is_no_noise_of_the_sensor() -> None:
    session = synthetic.session(poses=30, seed=8, extra=stiffens)
    session = replace(session, noise=replace(session.noise, force_n=4.0))  # 0.14 of the scatter, and at most 0.57
    np.testing.assert_array_equal(observe_with_force_noise(session, TERMS).session.force_in_tool, session.force_in_tool)


def test_what_was_left_out_once_is_not_left_out_again() -> None:
    once = observe_with_force_noise(read_with(20.0), TERMS).session
    np.testing.assert_array_equal(observe_with_force_noise(once, TERMS).session.force_in_tool, once.force_in_tool)


def test_what_is_left_out_leaves_the_noise_that_is_stated_for_the_readings_at_the_references() -> None:
    session = read_with(20.0)
    used = observe_with_force_noise(session, TERMS).session
    assert used.noise == session.noise
    rest = session.load_case == 0
    np.testing.assert_array_equal(used.force_in_tool[rest], session.force_in_tool[rest])
