# SPDX-License-Identifier: Apache-2.0
"""Short laws predict what has structure and no name, as far as they may be used without anybody looking at them."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import Ladder, improve
from irec_calibration.diagnose.evidence import Block
from irec_calibration.diagnose.laws import _may, helps_elsewhere, regions, within_angles
from irec_calibration.diagnose.proposals import _formulas
from irec_calibration.effects.formula import FormulaEffect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model.file import load_model, save_model
from irec_calibration.report.ladder import write_ladder_report
from test_proposals import compliance_waves_over_the_turn_of_axis_3


@pytest.fixture(scope="module")
def ladder() -> Ladder:
    return improve(synthetic.session(poses=24, seed=8, extra=compliance_waves_over_the_turn_of_axis_3))


def in_a_line(ladder) -> str:
    return FormulaEffect("law", ladder.rungs[-1].formula).in_short


@pytest.fixture(scope="module")
def warm() -> Scene:
    scene = scene_of(synthetic.session(poses=4, seed=8))
    return replace(scene, temperature={"gear_2": np.linspace(20.0, 30.0, len(scene))})


def test_a_law_predicts_what_no_effect_has(ladder):
    last, before = ladder.rungs[-1], ladder.rungs[-2]
    assert last.formula.startswith("axis 3: tau * (")
    assert last.cv_rms_m < 0.7 * before.cv_rms_m


def test_a_law_is_no_diagnosis(ladder):
    assert (ladder.before.verdict.status, ladder.before.verdict.effects) == ("unexplained", ())
    assert ladder.rungs[-1].stands_in
    said = f"the law '{in_a_line(ladder)}' to predict what has no name, which is no diagnosis"
    assert said in ladder.before.verdict.text


def test_the_ladder_has_the_formula_of_a_law_and_of_nothing_else(ladder):
    steps = json.loads(json.dumps(ladder.to_json()))["steps"]
    assert [s.get("formula", "") for s in steps] == [r.formula for r in ladder.rungs]
    assert steps[-1]["formula"] and not steps[0].get("formula")


def test_the_report_shows_the_formula(ladder, tmp_path):
    session = synthetic.session(poses=24, seed=8, extra=compliance_waves_over_the_turn_of_axis_3)
    page = write_ladder_report(ladder, session, tmp_path)[0].read_text(encoding="utf-8")
    assert f"+ {in_a_line(ladder)} (no name)" in page


def test_a_model_file_keeps_a_law(ladder, tmp_path):
    kept = load_model(save_model(ladder.model, tmp_path / "model.yaml"))
    law = kept.terms[-1].effect
    assert isinstance(law, FormulaEffect) and law.formula == ladder.rungs[-1].formula


@pytest.mark.parametrize(
    "formula",
    ["axis 3: tau * (a * cos(q_3) + b * sin(q_3))", "tool x: a * abs(f_x)", "axis 2: tau * a * (temp_gear_2 - 25)"],
)
def test_a_law_in_proportion_to_the_force_may_stand_in(formula, warm):
    assert _may(FormulaEffect("law", formula), warm)


@pytest.mark.parametrize(
    "formula",
    ["axis 3: a * tanh(tau / 50)", "tool x: a * f_x * abs(f_x)", "axis 3: a * (tanh((tau + tau_g) / 900) - tanh(tau_g / 900))"],
)
def test_a_law_that_bends_with_the_force_is_left_to_people(formula, warm):
    assert not _may(FormulaEffect("law", formula), warm)


def test_a_law_with_powers_of_a_temperature_is_left_to_people(warm):
    assert not _may(FormulaEffect("law", "axis 2: tau * (a * temp_gear_2 + b * temp_gear_2**2)"), warm)


def test_a_law_that_no_correction_could_use_is_left_to_people(warm):
    assert not _may(FormulaEffect("law", "axis 2: tau * a * temp_gear_2"), warm)


@pytest.mark.parametrize(
    ("formula", "may"),
    [
        ("axis 5: a * cos(2 * q_5) + b * sin(2 * q_5)", True),
        ("axis 5: tau_g * (a * cos(q_5) + b * sin(q_5))", True),
        ("axis 5: a * cos(q_1) + b * sin(q_1)", False),
        ("axis 5: a * cos(12.0197 * q_5) + b * sin(12.0197 * q_5)", False),
    ],
)
def test_where_nothing_presses_an_axis_turns_slowly_by_its_own_angle_and_torque_only(formula, may, warm):
    assert _may(FormulaEffect("law", formula), replace(warm, rows=replace(warm.rows, kind="absolute"))) == may


def test_a_law_of_an_angle_is_held_where_no_pose_was():
    q = np.array([[0.0, -2.207], [0.0, 0.816]])
    law = within_angles("axis 2: tau * (a * cos(2 * q_2) + b * sin(2 * q_2))", q)
    assert law == "axis 2: tau * (a * cos(2 * clip(q_2, -2.21, 0.82)) + b * sin(2 * clip(q_2, -2.21, 0.82)))"
    assert within_angles("axis 2: a * cos(q_2)", q) == "axis 2: a * cos(clip(q_2, -2.21, 0.82))"


def test_a_law_that_was_seen_to_repeat_is_carried_on():
    law = "axis 2: tau * (a * cos(9 * q_2) + b * sin(9 * q_2))"
    assert within_angles(law, np.array([[0.0, -2.207], [0.0, 0.816]])) == law


def test_a_law_that_follows_time_and_no_load_predicts_nothing(warm):
    assert not _may(FormulaEffect("law", "base z: a * t"), warm)


def test_a_compliance_that_goes_with_a_temperature_is_counted_from_its_middle(warm):
    written = list(_formulas(warm, ("temp_gear_2",), [1]))
    assert {"axis 2: tau * a * (temp_gear_2 - 25)", "tool z: f_z * a * (temp_gear_2 - 25)"} <= set(written)


def test_a_place_on_a_rail_below_zero_is_counted_from_its_middle_too(warm):
    left = replace(warm, ext={"rail": np.where(np.arange(len(warm)) % 2, -1.0, np.nan)})
    assert "axis 2: tau * a * (ext_rail + 1)" in _formulas(left, ("ext_rail",), [1])


def test_only_a_gear_that_turns_itself_has_a_compliance_that_repeats_more_than_three_times_per_turn(warm):
    written = set(_formulas(warm, ("joint_2",), [1, 2]))
    assert "axis 2: tau * (a * cos(9 * q_2) + b * sin(9 * q_2))" in written
    assert "axis 3: tau * (a * cos(9 * q_2) + b * sin(9 * q_2))" not in written
    assert "axis 3: tau * (a * cos(3 * q_2) + b * sin(3 * q_2))" in written


def test_poses_of_a_region_are_near_each_other():
    rng = np.random.default_rng(1)
    far = np.repeat(np.arange(8), 4)  # eight places, four poses in each, two rows a pose
    q = np.repeat(np.stack([far % 2, far // 2 % 2, far // 4], axis=1) + 0.01 * rng.normal(size=(32, 3)), 2, axis=0)
    found = regions(q, np.repeat(np.arange(100, 132), 2))
    assert len(found) == 16
    assert all(len(np.unique(far[part - 100])) == 1 for part in found)


def test_every_pose_is_in_one_region_and_none_is_alone():
    found = regions(np.random.default_rng(2).normal(size=(23, 6)), np.arange(23))
    assert sorted(np.concatenate(found)) == list(range(23))
    assert min(map(len, found)) >= 2


def block(*columns: np.ndarray) -> Block:
    free = np.full(len(columns), np.inf)
    return Block(np.stack(columns, axis=1), -free, free, np.full(len(columns), 10.0))


@pytest.mark.parametrize(("everywhere", "helps"), [(True, True), (False, False)])
def test_what_only_neighbours_have_in_common_is_no_law(everywhere, helps):
    rng = np.random.default_rng(3)
    pose, place = np.arange(64), np.repeat(np.arange(16), 4)
    q = np.stack([place % 4, place // 4], axis=1) + 0.01 * rng.normal(size=(64, 2))
    column = rng.choice([-1.0, 1.0], 64)
    b = 3.0 * column * (everywhere or place == 5) + 0.1 * rng.normal(size=64)
    column = column if everywhere else np.where(place == 5, column, 0.1 * column)  # next to nothing elsewhere
    study = SimpleNamespace(
        bench=SimpleNamespace(b=b, pose=pose, rounding=1e-9), base=block(np.ones(64)),
        observation=SimpleNamespace(rows=pose, pose=pose), session=SimpleNamespace(q=q),
    )  # fmt: skip
    assert helps_elsewhere(study, study.bench, study.base + block(column)) == helps
