# SPDX-License-Identifier: Apache-2.0
"""Formulas that a diagnosis proposes for what has no name."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
from irec_calibration.cli import main
from irec_calibration.diagnose import diagnose
from irec_calibration.diagnose.improve import improve
from irec_calibration.diagnose.proposals import _formulas, _is_readable
from irec_calibration.diagnose.result import Diagnosis
from irec_calibration.effects.formula import FormulaEffect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.report.next_steps import after_diagnosis
from irec_calibration.session import write_table
from irec_calibration.workbench.formula import undeclared
from numpy.typing import NDArray

Array = NDArray[np.float64]


def compliance_waves_over_the_turn_of_axis_3(scene: Scene) -> Array:
    angle = np.zeros_like(scene.tau)
    angle[:, 2] = 5e-7 * scene.tau[:, 2] * np.cos(3.0 * scene.q[:, 2])
    return np.einsum("nik,nk->ni", scene.kin.jacobian(scene.p_observed), angle)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return diagnose(synthetic.session(poses=24, seed=8, extra=compliance_waves_over_the_turn_of_axis_3))


def test_a_law_that_no_effect_has_is_proposed_as_a_formula_in_its_variables(found: Diagnosis) -> None:
    assert found.verdict.status == "unexplained"
    best = found.proposals[0]
    assert best.formula.startswith("axis 3: tau * (") and "3 * q_3" in best.formula
    assert best.cv_rms_m < 0.7 * found.cv_rms_m


def axes_2_and_3_give_way_to_each_others_torque(scene: Scene) -> Array:
    angle = np.zeros_like(scene.tau)
    angle[:, 1], angle[:, 2] = 1.5e-7 * scene.tau[:, 2], -1.5e-7 * scene.tau[:, 1]
    return np.einsum("nik,nk->ni", scene.kin.jacobian(scene.p_observed), angle)


def gear_3_softens_while_it_is_measured(scene: Scene) -> Array:
    angle = np.zeros_like(scene.tau)
    angle[:, 2] = 2e-7 * scene.tau[:, 2] * scene.stamp / scene.stamp.max()
    return np.einsum("nik,nk->ni", scene.kin.jacobian(scene.p_observed), angle)


@pytest.mark.long
def test_a_gear_that_gives_way_to_the_torque_of_another_axis_is_proposed_and_stands_in() -> None:
    ladder = improve(synthetic.session(poses=30, seed=8, extra=axes_2_and_3_give_way_to_each_others_torque))
    laws = {r.formula for r in ladder.rungs if r.formula}
    assert laws == {"axis 2: a * tau_3", "axis 3: a * tau_2"}
    assert ladder.rungs[-1].cv_rms_m < 1.2 * ladder.noise_floor_m < 0.6 * ladder.rungs[0].cv_rms_m


@pytest.mark.long
def test_a_gear_that_softens_in_the_course_of_a_session_is_described() -> None:
    found = diagnose(synthetic.session(poses=30, seed=8, extra=gear_3_softens_while_it_is_measured))
    assert any(p.formula.startswith("axis 3: tau * a * (t - ") for p in found.proposals)


def test_proposals_are_few_and_the_best_comes_first(found: Diagnosis) -> None:
    odds = [p.log_evidence for p in found.proposals]
    assert 1 <= len(odds) <= 3 and odds == sorted(odds, reverse=True)
    assert found.to_json()["proposals"][0]["formula"] == found.proposals[0].formula


def test_nothing_is_proposed_where_nothing_is_missing() -> None:
    assert diagnose(synthetic.session(poses=24, seed=9)).proposals == ()


def test_the_proposed_formula_can_be_added_as_it_stands(
    found: Diagnosis, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = synthetic.session(poses=24, seed=8, extra=compliance_waves_over_the_turn_of_axis_3)
    write_table(session, tmp_path / "s")
    assert main(["solve", str(tmp_path / "s"), "-o", str(tmp_path / "m.yaml")]) == 0
    capsys.readouterr()
    words = ["add", str(tmp_path / "m.yaml"), found.proposals[0].formula, str(tmp_path / "s"), "-o", str(tmp_path / "m2.yaml")]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)
    assert found.proposals[0].formula in (tmp_path / "m2.yaml").read_text()


def test_every_formula_that_may_be_proposed_can_be_read_by_the_command_that_adds_it() -> None:
    scene = scene_of(synthetic.session(poses=4, seed=8))
    warm, along = np.linspace(20.0, 30.0, len(scene)), np.linspace(-1.0, 3.0, len(scene))
    scene = replace(scene, temperature={"gear_2": warm}, ext={"rail": along})
    variables = ("tau_2", "joint_3", "force_x", "load_case", "stamp", "temp_gear_2", "ext_rail")
    written = list(_formulas(scene, variables, [2]))
    assert len(written) > 50
    assert all(undeclared(text, []) == () for text in written)


def test_the_command_that_adds_the_best_formula_is_among_the_next_steps(found: Diagnosis) -> None:
    commands = [shlex.split(command) for _, command in after_diagnosis(found, "SESSION", "m.yaml") if command]
    assert ["irec", "add", "m.yaml", found.proposals[0].formula, "SESSION", "-o", "model_formula.yaml"] in commands


@pytest.mark.parametrize(
    ("formula", "is_readable"),
    [
        ("axis 1: a * tau * tau_5 / load", True),
        ("link 4a: a * load * (tanh((900 * tau / load + tau_g) / 90) - tanh(tau_g / 90))", True),
        ("axis 4: a * load * (tanh((900 * tau / load + tau_g) / 90) - tanh(tau_g / 90))", False),
        ("axis 1: tau_5 * (a + b * cos(q_4) + c * sin(q_4)) + d * abs(tau_5)", False),
    ],
)
def test_people_are_proposed_short_formulas_each_law_once(formula: str, is_readable: bool) -> None:
    assert _is_readable(FormulaEffect("formula", formula), scene_of(synthetic.session(poses=3, seed=8))) == is_readable
