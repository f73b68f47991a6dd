# SPDX-License-Identifier: Apache-2.0
"""The score of a blind run counts a wrongly named axis as a wrong name. Truths and answers are written out here."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

HIDDEN = Path(__file__).resolve().parents[1] / "tools" / "hidden"


@pytest.fixture
def axes(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(HIDDEN))
    return importlib.import_module("axes")


@pytest.fixture
def score(axes) -> ModuleType:
    sys.modules.pop("score", None)
    return importlib.import_module("score")


@pytest.fixture
def answers(axes) -> ModuleType:
    return importlib.import_module("answers")


@pytest.fixture
def calibration(axes) -> ModuleType:
    return importlib.import_module("calibration")


def diagnosis(proven: list[str], one_of: list[list[str]], perhaps: list[str]) -> dict[str, Any]:
    parts = {"joint_backlash": {"proven": proven, "one_of": one_of, "perhaps": perhaps}}
    return {"verdict": {"parts": parts}, "candidates": [{"effect": "joint_backlash", "groups": proven}]}


def scored(axes: ModuleType, hidden: set[str], proven=(), one_of=(), perhaps=(), text=(), model=()) -> Any:
    said = diagnosis(list(proven), [list(s) for s in one_of], list(perhaps))
    ladder = {"steps": [{"parts": said["verdict"]["parts"]}]}
    return axes.score_axes("joint_backlash", frozenset(hidden), said, frozenset(text), frozenset(model), ladder)


@pytest.mark.parametrize(
    ("effect", "parameters", "expected"),
    [
        ("joint_stiffening", {"joint": 1, "share": 1.0}, {"axis 1"}),
        ("joint_settling", {"per_joint": [0.0, 0.0, 1e-3, 0.0, 2e-3, 0.0]}, {"axis 3", "axis 5"}),
        ("joint_coupling", {"c_45": 4e-7, "c_56": -3e-7}, {"axes 4-5", "axes 5-6"}),
        ("encoder_harmonics", {"sin": [[0.0] * 6] * 2}, {f"axis {k}" for k in range(1, 7)}),
        ("encoder_harmonics", {"sin": [[0.0] * 7] * 2}, {f"axis {k}" for k in range(1, 8)}),
        ("geometry_error", {"joint_zero": [0.0] * 7}, {f"axis {k}" for k in range(1, 8)}),
    ],
)
def test_the_hidden_axes_are_read_from_the_truth(axes, effect: str, parameters: dict[str, Any], expected: set[str]) -> None:
    assert axes.hidden_axes(effect, parameters) == expected


@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("tracker_scale", {"scale": 5e-3}),
        ("creep", {"per_joint": [0.2] * 6, "time": 12.0}),  # all gears together: the tool names no axis
        ("counterbalance", {"stiffness": 2.5e7, "angle": -2.6}),  # axis 2 by its nature
    ],
)
def test_effects_that_are_in_no_particular_axis_are_not_scored(axes, effect: str, parameters: dict[str, Any]) -> None:
    assert axes.hidden_axes(effect, parameters) is None


def test_the_hidden_axis_alone_is_right(axes) -> None:
    found = scored(axes, {"axis 1"}, proven=["axis 1"], model=["axis 1"])
    assert (found.kind, found.right, found.wrong, found.missed) == ("all", {"axis 1"}, set(), set())


def test_an_axis_too_many_is_wrong(axes) -> None:
    found = scored(axes, {"axis 1"}, proven=["axis 1", "axis 3"])
    assert (found.kind, found.wrong) == ("a wrong axis", {"axis 3"})


def test_an_axis_that_only_the_text_names_is_wrong_too(axes) -> None:
    assert scored(axes, {"axis 1"}, proven=["axis 1"], text=["axis 1", "axis 4"]).is_wrong


def test_an_axis_too_few_is_missed_not_wrong(axes) -> None:
    found = scored(axes, {"axis 1", "axis 4"}, proven=["axis 4"])
    assert (found.kind, found.missed) == ("some", {"axis 1"})


def test_axes_not_told_apart_are_no_wrong_name_where_the_hidden_one_is_among_them(axes) -> None:
    found = scored(axes, {"axis 3"}, one_of=[["axis 2"], ["axis 3"]], model=["axis 2"])
    assert (found.kind, found.model_wrong, found.model_unsure) == ("not told apart", set(), {"axis 2"})


def test_axes_not_told_apart_are_wrong_where_the_hidden_one_is_not_among_them(axes) -> None:
    assert scored(axes, {"axis 5"}, one_of=[["axis 2"], ["axis 3"]]).is_wrong


def test_an_answer_that_knows_no_proof_claims_every_part_of_its_fit(axes) -> None:
    old = {"verdict": {}, "candidates": [{"effect": "joint_backlash", "groups": ["axis 1", "axis 3"]}]}
    found = axes.score_axes("joint_backlash", frozenset({"axis 1"}), old, frozenset(), frozenset(), {"steps": [{}]})
    assert found.wrong == {"axis 3"}


def test_the_axes_of_a_model_are_those_of_its_parameters(axes) -> None:
    model = {"effects": [
        {"effect": "joint_stiffening", "parameters": {"a_1": {}, "a_5": {}, "x_0": {}}},
        {"effect": "joint_coupling", "parameters": {"c_45": {}, "c_54": {}}},
    ]}  # fmt: skip
    assert axes.axes_in_model(model, "joint_stiffening") == {"axis 1", "axis 5"}
    assert axes.axes_in_model(model, "joint_coupling") == {"axes 4-5"}


def test_the_axes_of_the_text_are_those_of_the_sentence_on_what_is_missing(axes) -> None:
    text = "Axis 2 moves. Missing: joint stiffening (axis 1, axis 3) and creep. Added, it falls. Perhaps also axis 6."
    assert axes.axes_in_text(text, "joint stiffening") == {"axis 1", "axis 3"}
    assert axes.axes_in_text(text, "creep") == set()


def test_the_right_effect_in_a_wrong_axis_counts_as_a_wrong_name(axes, answers) -> None:
    case = told(answers, hidden=["joint_backlash"], named=["joint_backlash"])
    case.axes = [scored(axes, {"axis 1"}, proven=["axis 1"])]
    assert case.right and not case.wrong_name
    case.axes = [scored(axes, {"axis 1"}, proven=["axis 1", "axis 3"])]
    assert case.wrong_name and not case.right


def told(answers: ModuleType, hidden=(), named=(), kind="single", **more: Any) -> Any:
    """A session in which everything hidden is visible unless told otherwise."""
    status = more.pop("status", "missing_effect" if named else "adequate")
    more.setdefault("visible", list(hidden))
    return answers.Case("s1", kind, more.pop("strength", 0.08), list(hidden), status=status, named=list(named), **more)


def share(score: ModuleType, key: str, *cases: Any, column: int = 0) -> float:
    return {r.key: r for r in score.rates(list(cases))}[key].share(column)


def test_a_wrong_name_is_wrong_although_the_truth_stands_among_what_is_confusable(answers, score) -> None:
    case = told(answers, ["creep"], ["thermal_drift"])
    case.said = {"candidates": [{"effect": "thermal_drift", "confusable_with": ["creep"]}]}
    assert case.wrong_name and not case.right
    assert share(score, "wrong_name", case) == 1.0 and share(score, "first_8", case) == 0.0


def test_a_right_name_with_a_wrong_one_beside_it_is_a_wrong_name(answers, score) -> None:
    case = told(answers, ["creep"], ["creep", "joint_backlash"])
    assert case.first_right and case.wrong_name and not case.right
    assert share(score, "wrong_name", case) == 1.0


def test_anything_but_adequate_is_a_false_alarm_on_a_clean_cell(answers, score) -> None:
    quiet, unexplained = told(answers, kind="clean"), told(answers, kind="clean", status="unexplained")
    named = told(answers, kind="robust", named=["station_shift"])
    assert share(score, "false_alarm", quiet, unexplained, named) == pytest.approx(2 / 3)
    assert share(score, "wrong_name", quiet, unexplained, named) == pytest.approx(1 / 3)


def test_what_the_oracle_does_not_see_need_not_be_found_but_must_not_be_misnamed(answers, score) -> None:
    unseen = told(answers, ["creep"], visible=[])
    assert unseen.right
    assert "first_8" not in {r.key for r in score.rates([unseen])}
    assert not told(answers, ["creep"], ["joint_backlash"], visible=[]).right


def test_precision_counts_every_name_and_recall_only_what_is_visible(answers, score) -> None:
    case = told(
        answers, ["creep", "sensor_gain", "joint_coupling", "tool_weight"], ["creep", "sensor_gain", "joint_backlash"],
        kind="many", visible=["creep", "joint_coupling"],
    )  # fmt: skip
    assert share(score, "many_precision", case) == pytest.approx(2 / 3)
    assert share(score, "many_recall", case) == pytest.approx(1 / 2)


def test_what_the_base_model_has_anyway_is_no_mistake_and_no_find(answers, score) -> None:
    case = told(answers, ["creep"], ["creep", "geometry_error"], kind="many", background=["geometry_error"])
    assert not case.wrong_name and share(score, "many_precision", case) == 1.0


@pytest.mark.parametrize(("kind", "wrong"), [("clean", True), ("absolute", False)])
def test_a_name_for_what_is_too_small_to_show_is_wrong(answers, tmp_path, kind, wrong) -> None:
    row = dict.fromkeys(("effects", "visible", "variables", "mishap"), "") | {"name": "s", "kind": kind, "claim": "right"}
    row |= {"background": "geometry_error", "tail": "normal", "slow": "0", "strength": "0", "oracle_m": "1e-5", "base_m": "1e-5"}
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "truth.yaml").write_text("effects: []")
    case = answers.read_case(row, tmp_path, tmp_path)
    case.named = ["geometry_error"]
    assert case.wrong_name is wrong


def test_a_pair_needs_both_names_and_no_third(answers, score) -> None:
    both = ["creep", "sensor_gain"]
    right, one, three = (told(answers, both, named, kind="pair") for named in (both, both[:1], [*both, "joint_backlash"]))
    assert [c.all_named for c in (right, one, three)] == [True, False, False]
    assert share(score, "pairs", right, one, three) == pytest.approx(1 / 3)


def test_rates_are_apart_for_noise_stated_as_it_is_and_wrongly(answers, score) -> None:
    cases = [told(answers, kind="clean", status=s, claim_right=r) for s, r in (("adequate", True), ("unexplained", False))]
    assert [share(score, "false_alarm", *cases, column=k) for k in range(3)] == [0.5, 0.0, 1.0]


def test_outside_the_catalogue_the_answer_is_unexplained_with_a_variable_that_matters(answers, score) -> None:
    outside = [
        told(answers, ["taper"], kind="outside", status="unexplained", depends_on=d, variables=["force_x", "load_case"])
        for d in (["tau_2", "load_case"], ["joint_3"])
    ]
    named = told(answers, ["taper"], ["creep"], kind="outside", variables=["force_x"])
    assert share(score, "unexplained", *outside, named) == pytest.approx(2 / 3)
    assert share(score, "variable", *outside, named) == pytest.approx(1 / 2)
    assert share(score, "outside_named", *outside, named) == pytest.approx(1 / 3)


def test_the_named_effect_has_to_stand_first_among_the_candidates(answers, score) -> None:
    first, second = (told(answers, ["creep"], ["creep"], ranked=r) for r in (["creep", "tool_weight"], ["tool_weight", "creep"]))
    assert share(score, "sorted", first, second) == 0.5


@pytest.mark.parametrize("key", ["outliers", "bad_rows", "rows_set_aside"])
def test_a_doubtful_row_is_found_under_whatever_key_lists_it(answers, key) -> None:
    said = {"verdict": {"status": "adequate"}, key: [{"pose": 12, "load_case": 3}], "next_measurements": [{"pose": 5}]}
    assert answers.accused_poses(said) == {12}


def test_a_command_that_fails_is_counted_and_never_right(answers, score) -> None:
    case = told(answers, kind="clean", failed=True)
    assert not case.right and share(score, "failed", case) == 1.0
    assert "irec improve" not in score.table([case])


def test_the_error_is_set_against_the_oracles(answers, score) -> None:
    cases = [told(answers, ["creep"], ["creep"], base=8e-5, after=a, oracle=1e-5) for a in (1e-5, 1.2e-5, 4e-5)]
    (line,) = score.ratios(cases)
    assert line["all"] == {"median": pytest.approx(1.2), "worst": pytest.approx(4.0)} and line["base_over_oracle"] == 8.0


def test_of_an_absolute_session_only_what_the_session_can_tell_is_scored(answers, tmp_path) -> None:
    rng = np.random.default_rng(0)
    p, turns = rng.normal(0, 1, (30, 3)), np.linalg.qr(rng.normal(0, 1, (30, 3, 3)))[0]
    wrong = rng.normal(0, 1e-4, (30, 3))
    gauge = np.cross([1e-3, 2e-3, -1e-3], p) + [0.1, 0.2, 0.3] + turns @ [1e-3, 2e-3, 3e-3]
    names = [*(f"deflection_{a}" for a in "xyz"), *(f"tcp_{a}" for a in "xyz"), *(f"R_{i}{j}" for i in "xyz" for j in "xyz")]

    def write(path: Path, deflection: np.ndarray, more: bool) -> Path:
        lines = ["pose,load_case,repeat," + ",".join(names if more else names[:3])]
        for i, d in enumerate(deflection):
            values = [*d, *p[i], *turns[i].ravel()] if more else d
            lines.append(f"{i + 1},0,0," + ",".join(repr(float(v)) for v in values))
        path.write_text("\n".join(lines))
        return path

    true = write(tmp_path / "t.csv", np.zeros((30, 3)), True)
    assert answers.absolute_error(write(tmp_path / "a.csv", gauge, False), true) < 1e-12
    off = [answers.absolute_error(write(tmp_path / "b.csv", x, False), true) for x in (wrong, wrong + gauge)]
    assert off[0] == pytest.approx(off[1], rel=1e-9) and 5e-5 < off[0] < 3e-4


def test_stated_p_values_are_set_against_how_often_they_come_up(calibration) -> None:
    rng = np.random.default_rng(0)
    right = [calibration.Clean(str(i), True, "adequate", [float(rng.uniform()), 1.0]) for i in range(200)]
    bold = [calibration.Clean(str(i), False, "adequate", [float(rng.uniform() ** 2), 1.0]) for i in range(200)]
    found = calibration.summary(right)
    assert found["smallest_p_value"]["0.01"]["low"] <= 0.01 <= found["smallest_p_value"]["0.01"]["high"]
    assert found["smallest_p_value"]["0.05"]["low"] <= 0.05 <= found["smallest_p_value"]["0.05"]["high"]
    assert calibration.summary(bold)["smallest_p_value"]["0.01"]["low"] > 0.05


def test_odds_of_100_to_1_may_come_up_in_a_hundredth_of_the_clean_sessions(calibration) -> None:
    cases = [calibration.Clean(str(i), True, "adequate", odds=[-3.0, 5.0 if i < 2 else 1.0]) for i in range(100)]
    assert calibration.summary(cases)["odds"]["0.01"]["k"] == 2 and calibration.summary(cases)["odds"]["0.001"]["k"] == 0


def test_a_diagnosis_without_a_range_of_the_noise_is_no_miss(calibration, tmp_path) -> None:
    (tmp_path / "s").mkdir()
    said = {"verdict": {"status": "adequate"}, "candidates": [{"effect": "creep", "p_value": 0.2, "log_evidence": -1.0}]}
    (tmp_path / "s" / "diagnosis.json").write_text(json.dumps(said))
    case = calibration.read({"name": "s", "claim": "factor", "claim_factor": "1.5"}, tmp_path)
    assert case.covered is None and not case.claim_right and case.p_values == [0.2] and case.odds == [-1.0]
    said["noise"] = {"claimed_m": 3e-5, "inferred_m": 2.2e-5, "inferred_low_m": 1.8e-5, "inferred_high_m": 2.6e-5}
    (tmp_path / "s" / "diagnosis.json").write_text(json.dumps(said))
    case = calibration.read({"name": "s", "claim": "factor", "claim_factor": "1.5"}, tmp_path)
    assert case.covered and case.noise_ratio == pytest.approx(1.1)
    assert calibration.summary([case])["noise_covered"]["rate"] == 1.0
    assert "true noise within" in calibration.in_words({"all": calibration.summary([case])})
