# SPDX-License-Identifier: Apache-2.0
"""A wrong tool weight cancels in differences to the reference: what a refit makes of it comes from the references' readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose.improve import add_effect, remove_effect
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.errors import SolveError
from irec_calibration.identification.identify import identify
from irec_calibration.identification.tool_weight import at_references
from irec_calibration.model import Estimate, Model, Term, blank_model
from irec_calibration.recertification.judgement import renewed
from irec_calibration.session.data import Session

WITH_WEIGHT = ("joint_torsion", "link_bending", "tool_weight")
BIAS = (3.0, -5.0, 8.0)  # N, of the sensor


def reads_too_much(mass: float, poses: int = 12, seed: int = 5) -> Session:
    """A session whose sensor has a bias and from whose readings the weight of another tool was taken off."""
    measured = synthetic.session(poses=poses, seed=seed)
    weight = np.einsum("nji,j->ni", scene_of(measured).kin.R_tool, [0.0, 0.0, -9.81 * mass])
    return replace(measured, force_in_tool=measured.force_in_tool + weight + BIAS)


def weight_of(terms: tuple[Term, ...]) -> Estimate:
    return next(t.estimates["dm"] for t in terms if t.effect.id == "tool_weight")


def model_with(mass: float) -> Model:
    session = synthetic.session(poses=12, seed=5)
    known = identify(session, blank_model(("joint_torsion", "link_bending"))).terms
    return Model((*known, Term(find_effect("tool_weight"), {"dm": Estimate(mass, 0.05, "kg")})), serial=session.serial)


def test_a_fit_takes_the_tool_weight_from_the_readings_at_the_references() -> None:
    found = weight_of(identify(reads_too_much(6.0), blank_model(WITH_WEIGHT)).terms)
    assert found.se < 0.1
    assert found.value == pytest.approx(6.0, abs=4.0 * found.se)


def test_a_renewed_model_has_the_tool_weight_that_the_new_session_reads() -> None:
    assert weight_of(renewed(reads_too_much(-2.0, seed=6), model_with(6.0)).terms).value == pytest.approx(-2.0, abs=0.1)


def test_another_effect_that_comes_or_goes_leaves_the_tool_weight_as_it_is_read() -> None:
    session = reads_too_much(6.0)
    more, _, _ = add_effect(model_with(6.0), find_effect("joint_backlash"), session)
    less, _ = remove_effect(more, "joint_backlash", session)
    for model in (more, less):
        assert weight_of(model.terms).value == pytest.approx(6.0, abs=0.1)


def test_a_tool_weight_stays_where_the_references_are_too_few_to_tell() -> None:
    terms = model_with(6.0).terms
    assert weight_of(identify(reads_too_much(-2.0).select_poses([1, 2]), terms[-2:]).terms).value == 6.0


def test_a_tool_weight_without_a_value_is_asked_for_in_vain_where_the_references_are_too_few() -> None:
    with pytest.raises(SolveError, match="'tool_weight' can't be identified from synthetic.*at 3 references at least"):
        identify(reads_too_much(6.0).select_poses([1, 2]), blank_model(("joint_torsion", "tool_weight")))


def test_a_reading_counts_once_however_many_markers_are_seen() -> None:
    session = reads_too_much(6.0)
    markers = (*session.markers, replace(session.markers[0], name="B"))
    twice = session.select(np.repeat(np.arange(len(session)), 2))
    twice = replace(twice, marker=np.tile([0, 1], len(session)), markers=markers)
    one, two = (at_references(scene_of(s), 1.0) for s in (session, twice))
    assert one is not None
    assert two is not None
    assert two.mass_se == pytest.approx(one.mass_se)
