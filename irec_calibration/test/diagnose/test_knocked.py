# SPDX-License-Identifier: Apache-2.0
"""What was knocked within a pose and is as before in the next one: its rows are put aside, and the other poses tell the cause."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import Diagnosis, diagnose
from irec_calibration.diagnose.knocked import _step
from irec_calibration.effects.scene import Scene
from irec_calibration.session import Session
from numpy.typing import NDArray

Array = NDArray[np.float64]
POSE, BY = 9, np.array([9e-4, -7e-4, 5e-4])


def play_of_axis_4(scene: Scene) -> Array:
    side = np.tanh((scene.tau + scene.tau_gravity)[:, 3] / 4.0)
    return np.asarray(0.5 * 4e-4 * scene.kin.jacobian(scene.p_observed)[:, :, 3] * side[:, None])


def measured(later: bool = False) -> Session:
    """From the second load case of a pose on all its readings are moved alike, or those of later poses too."""
    session = synthetic.session(poses=22, seed=3, extra=play_of_axis_4)
    at = (session.pose == POSE) & (session.load_case >= 2)
    if later:
        at |= session.stamp > session.stamp[at].max()
    return replace(session, p_marker_in_station=session.p_marker_in_station + at[:, None] * BY)


@cache
def knocked() -> Diagnosis:
    return diagnose(measured())


@pytest.mark.long
def test_the_cause_that_other_poses_show_is_named() -> None:
    assert knocked().verdict.effects == ("joint_backlash",)
    assert knocked().verdict.parts["joint_backlash"].proven == ("axis 4",)


def test_the_pose_is_told_as_knocked_and_not_as_a_cause() -> None:
    assert not any("station_shift" in several for several in knocked().verdict.one_of)
    assert f"pose {POSE}" in knocked().verdict.text and "knocked" in knocked().verdict.text


@pytest.mark.long
def test_a_step_that_later_readings_have_too_is_named() -> None:
    assert set(diagnose(measured(later=True)).verdict.effects) == {"station_shift", "joint_backlash"}


@pytest.mark.parametrize("first", [1, 3])
def test_a_step_is_found_where_it_begins(first: int) -> None:
    residual = np.random.default_rng(1).normal(0.0, 2e-5, (7, 3))
    residual[first:] += [3e-4, 0.0, -2e-4]
    found = _step(residual)
    assert found is not None and found[0] == first
    np.testing.assert_allclose(found[1], [3e-4, 0.0, -2e-4], atol=4e-5)


def test_what_goes_with_the_load_is_no_step() -> None:
    """Five load cases: normal, and to four sides."""
    load = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [-1.0, 0.0, 1.0], [0.0, -1.0, 1.0]])
    assert _step(3e-4 * load) is None


def test_a_pose_of_which_all_readings_are_moved_may_be_bent_by_its_load() -> None:
    assert _step(np.full((12, 3), 3e-4)) is None
