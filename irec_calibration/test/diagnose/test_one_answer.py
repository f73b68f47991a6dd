# SPDX-License-Identifier: Apache-2.0
"""The same question has the same answer everywhere: the error of one model on one session, whichever command is asked."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from irec_calibration.cli import main
from irec_calibration.diagnose import prepare, validated
from irec_calibration.identification.validation import ESTIMATOR
from irec_calibration.model import EIGHTEEN_DOF, Model, Term, blank_model
from irec_calibration.model.file import load_model, save_model
from irec_calibration.session import read_session, write_table
from irec_calibration.workbench.desk import Desk
from irec_calibration.workbench.plain import Version
from test_diagnose import play_of_axis_4, session

SAME = 1e-3  # relative; the values that a fit starts from, and the digits of a file


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    there = tmp_path_factory.mktemp("one_answer")
    write_table(session(play_of_axis_4), there / "session")
    return there


@pytest.fixture(scope="module")
def improved(folder) -> dict[str, Any]:
    """ladder.json and diagnosis.json of `irec improve`."""
    assert main(["improve", str(folder / "session"), "-o", str(folder / "improved"), "--json"]) == 0
    return {name: json.loads((folder / "improved" / f"{name}.json").read_text()) for name in ("ladder", "diagnosis")}


def test_a_fit_that_stopped_short_of_a_minimum_is_told() -> None:
    made = validated(session(play_of_axis_4), blank_model(EIGHTEEN_DOF))
    assert made.notes == made.study.session.notes
    short = replace(made, study=replace(made.study, fit=replace(made.study.fit, converged=False)))
    assert "joint_torsion + link_bending did not reach a minimum" in short.notes[-1]


@pytest.fixture(scope="module")
def solved(folder) -> Model:
    assert main(["solve", str(folder / "session"), "-o", str(folder / "model.yaml")]) == 0
    return load_model(folder / "model.yaml")


def as_json(capsys, *arguments: object) -> dict[str, Any]:
    capsys.readouterr()
    assert main([str(a) for a in arguments] + ["--json"]) == 0
    return json.loads(capsys.readouterr().out)


def without_backlash(folder: Path) -> tuple[Term, ...]:
    """Terms, without values, of what `irec improve` found but for the effect that is missing."""
    return blank_model([e for e in load_model(folder / "improved" / "model.yaml").effects if e != "joint_backlash"])


def with_backlash(model: Path, capsys) -> dict[str, Any]:
    made = model.with_name(f"more_than_{model.name}")
    return as_json(capsys, "add", model, "joint_backlash", model.parent / "session", "-o", made, "--quick")


def opened(folder: Path, model: Path) -> Version:
    return Desk().start(str(folder / "session"), str(model), str(folder / "desk"), lambda share, what: None, lambda: False)


def test_solve_diagnose_improve_add_and_the_workbench_give_one_held_out_error_of_one_model(folder, solved, improved, capsys):
    said = with_backlash(folder / "model.yaml", capsys)
    told = {
        "diagnose": improved["diagnosis"]["model"]["cv_rms_m"],
        "improve": improved["ladder"]["steps"][0]["cv_rms_m"],
        "add, before": said["cv_rms_before_m"],
        "workbench": opened(folder, folder / "model.yaml").cv_rms_m,
    }
    assert told == pytest.approx(dict.fromkeys(told, solved.figures["cv_rms_m"]), rel=SAME)


def test_what_an_effect_brings_is_the_same_by_improve_diagnose_add_the_workbench_and_a_new_diagnosis(folder, improved, capsys):
    save_model(Model(without_backlash(folder)), folder / "blank.yaml")
    said = with_backlash(folder / "blank.yaml", capsys)
    model = folder / "improved" / "model.yaml"
    told = {
        "diagnose": improved["diagnosis"]["verdict"]["cv_rms_after_m"],
        "add, after": said["cv_rms_after_m"],
        "model.yaml": load_model(model).figures["cv_rms_m"],
        "its history": load_model(model).history[-1]["cv_rms_m"],
        "workbench": opened(folder, model).cv_rms_m,
        "again": validated(read_session(folder / "session"), load_model(model).terms).held_out.rms_m,
    }
    assert told == pytest.approx(dict.fromkeys(told, improved["ladder"]["steps"][-1]["cv_rms_m"]), rel=SAME)


def test_a_removed_effect_leaves_the_error_of_the_model_without_it(folder, improved, capsys):
    made = folder / "improved" / "model.yaml"
    said = as_json(capsys, "remove", made, "joint_backlash", folder / "session", "-o", folder / "m4.yaml")
    without = validated(read_session(folder / "session"), without_backlash(folder)).held_out.rms_m
    assert said["cv_rms_after_m"] == pytest.approx(without, rel=SAME)


def test_the_residual_of_a_model_is_the_same_by_solve_compare_diagnose_and_the_workbench(folder, solved, improved, capsys):
    told = {
        "compare": as_json(capsys, "compare", folder / "model.yaml", folder / "session")["rms_m"],
        "diagnose": improved["diagnosis"]["model"]["fit_rms_m"],
        "improve": improved["ladder"]["steps"][0]["fit_rms_m"],
        "workbench": opened(folder, folder / "model.yaml").fit_rms_m,
    }
    assert told == pytest.approx(dict.fromkeys(told, solved.figures["fit_rms_m"]), rel=SAME)


def test_every_file_with_a_held_out_error_names_its_estimator(folder, solved, improved):
    assert solved.figures["estimator"] == ESTIMATOR == improved["ladder"]["estimator"]
    assert improved["diagnosis"]["model"]["estimator"] == ESTIMATOR
    assert ESTIMATOR in improved["diagnosis"]["candidates_estimator"] != ESTIMATOR


def test_the_error_of_a_model_does_not_depend_on_the_values_that_its_fit_starts_from(folder, solved):
    data = read_session(folder / "session")
    assert validated(data, blank_model(EIGHTEEN_DOF)).held_out.rms_m == pytest.approx(solved.figures["cv_rms_m"], rel=SAME)
    assert prepare(data, solved.terms).fit.rms == pytest.approx(solved.figures["fit_rms_m"], rel=SAME)
