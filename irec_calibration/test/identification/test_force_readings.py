# SPDX-License-Identifier: Apache-2.0
"""Where force readings of a load case differ, the arm tells how much of that is force; the rest is the sensor's noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose
from irec_calibration.identification.identify import identify, observe_with_force_noise
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.session.data import Session

TRUE_SCATTER = 15.0  # N, of the force itself, as synthetic.session has it
TERMS = blank_model(EIGHTEEN_DOF)


def read_with(noise: float, stated: float | None = None, poses: int = 30) -> Session:
    """A session whose sensor has a noise, N, along each axis and in every row."""
    plain = synthetic.session(poses=poses, seed=8)
    rng = np.random.default_rng(3)
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


def test_springs_are_known_better_without_the_noise_of_the_sensor() -> None:
    session = read_with(20.0)
    as_read = replace(session, noise=replace(session.noise, force_n=1e-3))  # then all of it counts as force
    truth = synthetic.COMPLIANCE
    first = [identify(s, TERMS).terms[0] for s in (session, as_read)]
    error = [np.linalg.norm([t.estimates[f"c_{k + 1}"].value / truth[k] - 1.0 for k in range(3)]) for t in first]
    assert error[0] < error[1]


def test_noise_of_the_force_sensor_that_is_stated_too_small_is_no_unknown_cause() -> None:
    assert diagnose(read_with(25.0, stated=18.0)).verdict.status == "adequate"
