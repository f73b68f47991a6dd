# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of absolute sessions starts from the geometric model and tells what is missing beyond it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from absolute_sessions import session, torsion
from irec_calibration.diagnose import compare, diagnose, improve
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.session import Noise

NOISE = Noise(tracker_m=1.5e-5)


def test_a_robot_with_geometric_errors_only_is_explained_by_the_geometric_model():
    found = diagnose(session(poses=80, noise=NOISE))
    assert found.verdict.status == "adequate"


def test_missing_joint_torsion_is_named():
    c = np.array([0.0, 8e-6, 1.2e-5, 0.0, 0.0, 0.0])
    found = diagnose(session(poses=80, noise=NOISE, moved=torsion(c)))
    assert found.verdict.status == "missing_effect"
    assert found.verdict.effects[0] == "joint_torsion"


def test_a_reflector_that_is_seated_anew_is_listed_where_it_happened_and_is_no_cause():
    def moved(measured, p):
        return measured.robot.kinematics(measured.q).R_tool @ [8e-5, -6e-5, 4e-5] * (np.arange(len(p)) >= 50)[:, None]

    verdict = diagnose(session(poses=80, noise=NOISE, moved=moved)).verdict
    assert verdict.status == "adequate", verdict.text
    assert "the reflector seated anew at pose 51," in verdict.text


def test_a_reflector_that_is_seated_anew_by_millimetres_is_another_one_from_there_on_and_bends_no_geometry():
    def moved(measured, p):
        there = np.where(np.arange(len(p))[:, None] >= 50, [2e-3, -1e-3, 1.5e-3], 0.0)
        return np.einsum("nij,nj->ni", measured.robot.kinematics(measured.q).R_tool, there)

    whole, stepped = (improve(session(poses=80, noise=NOISE, moved=m)) for m in (None, moved))
    assert stepped.before.verdict.status == "adequate", stepped.before.verdict.text
    assert "Taken as another reflector: the reflector seated anew at pose 51," in stepped.before.verdict.text
    assert stepped.rungs[-1].cv_rms_m < 1.2 * whole.rungs[-1].cv_rms_m


def test_a_model_is_compared_with_another_session_of_the_robot_whose_station_stands_elsewhere():
    model = model_of(identify(session(noise=NOISE), default_terms(session(poses=5))))
    other = session(poses=30, seed=9, noise=NOISE)
    result = compare(other, model.terms)
    assert result.rms_m < 1.5 * result.noise_floor_m


@pytest.mark.parametrize(("off", "said"), [(5e-4, []), (5e-3, ["Station T stands 5.00 mm from where the session states it"])])
def test_a_known_station_that_stands_far_from_where_it_is_stated_is_said(off: float, said: list[str]) -> None:
    made = session(poses=40, noise=NOISE, stated=True, moved=lambda s, p: np.tile([off, 0.0, 0.0], (len(p), 1)))
    verdict = diagnose(made).verdict
    assert verdict.status == "adequate"
    assert re.findall("Station [^:]*", verdict.text) == said
