# SPDX-License-Identifier: Apache-2.0
"""The score of a blind run counts a wrongly named axis as a wrong name. Truths and answers are written out here."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

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


def test_the_right_effect_in_a_wrong_axis_counts_as_a_wrong_name(axes, score) -> None:
    case = score.Case("s1", "single", 0.08, ["joint_backlash"], status="missing_effect", named=["joint_backlash"])
    case.axes = [scored(axes, {"axis 1"}, proven=["axis 1"])]
    assert case.right and not case.wrong_with_confidence
    case.axes = [scored(axes, {"axis 1"}, proven=["axis 1", "axis 3"])]
    assert case.wrong_with_confidence and not case.right
    assert "a wrong one 1" in score.summary([case])
