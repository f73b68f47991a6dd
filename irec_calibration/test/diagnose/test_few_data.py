# SPDX-License-Identifier: Apache-2.0
"""What is said of data that are too few, and of models that the data do not bear out."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from irec_calibration.diagnose import diagnose, solved, start_terms, validated
from irec_calibration.diagnose.held_out import fitted_truly
from irec_calibration.errors import SolveError
from irec_calibration.report.next_steps import after_diagnosis
from test_diagnose import play_of_axis_4, session


@pytest.mark.parametrize("poses", [1, 2])
def test_a_session_of_few_poses_says_so_and_names_nothing(poses: int) -> None:
    found = diagnose(session(play_of_axis_4).select_poses(list(range(1, poses + 1))))
    assert found.verdict.effects == ()
    assert found.verdict.in_short == "too few data to judge"
    assert "Measure more poses" in found.verdict.text
    assert "Nothing shows" not in found.verdict.text
    assert "irec plan" in after_diagnosis(found, "SESSION")[0][1]
    json.dumps(found.to_json(), allow_nan=False)


def test_a_model_that_leaves_far_more_than_its_linear_problem_promises_is_no_result() -> None:
    made = validated(session(), start_terms(session()))
    assert fitted_truly(made) is made
    spoiled = replace(made, study=replace(made.study, fit=replace(made.study.fit, rms=20.0 * made.held_out.rms_m)))
    with pytest.raises(SolveError, match="could not be fitted.*check masses"):
        fitted_truly(spoiled)


@pytest.mark.parametrize(("poses", "words"), [(2, "measure more"), (None, None)])
def test_a_model_of_few_poses_carries_a_caution(poses: int | None, words: str | None) -> None:
    whole = session()
    model, _ = solved(whole if poses is None else whole.select_poses(list(range(1, poses + 1))), start_terms(whole))
    assert ("caution" in model.made) == (words is not None)
    assert words is None or words in model.made["caution"]


def test_a_model_that_leaves_much_of_the_deflection_carries_a_caution() -> None:
    whole = session()
    model, _ = solved(replace(whole, force_in_tool=whole.force_in_tool * [-1.0, -1.0, 1.0]), start_terms(whole))
    assert "of a deflection of" in model.made["caution"]
