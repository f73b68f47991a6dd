# SPDX-License-Identifier: Apache-2.0
"""Sentences of a verdict: of which effect they speak, and how often a proposed sample has to be taken."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from irec_calibration.diagnose import wording
from irec_calibration.diagnose.part_sets import Parts
from irec_calibration.diagnose.result import Measurement
from irec_calibration.effects import find_effect
from irec_calibration.identification.noise import InferredNoise
from irec_calibration.identification.validation import HeldOut, rms
from irec_calibration.model import GEOMETRIC
from irec_calibration.report.next_steps import after_diagnosis

AS_STATED = InferredNoise(41e-6, 41e-6, 38e-6, 44e-6, "residual", 300.0)


def made(rows: list[int], sizes: list[float]) -> SimpleNamespace:
    residual = np.outer(sizes, (1.0, 0.0, 0.0))
    nan = float("nan")
    held_out = HeldOut(rms(residual), nan, nan, nan, np.arange(3), np.zeros(3), residual)
    return SimpleNamespace(held_out=held_out, study=SimpleNamespace(observation=SimpleNamespace(rows=np.array(rows))))


def missing(
    *names: str,
    asked: SimpleNamespace | None = None,
    after: SimpleNamespace | None = None,
    aside: tuple[int, ...] = (),
    usual: tuple[str, ...] = (),
) -> str:
    parts = {i: Parts(proven=("axis 1",), perhaps=("axis 3",)) for i in names}
    bad = [SimpleNamespace(structure=SimpleNamespace(rows=aside))] if aside else []
    found = SimpleNamespace(names=names, parts=parts, stand_out=bad, usual=usual)
    same = made([1, 2], [5e-5, 5e-5])
    return " ".join(wording._missing(found, SimpleNamespace(asked=asked or same, after=after or same), (), {}))  # type: ignore[arg-type]


def test_a_reading_that_stands_out_does_not_hide_how_far_the_error_falls() -> None:
    asked, after = made([1, 2, 3], [1e-4, 1e-4, 1e-3]), made([1, 2, 3], [5e-5, 5e-5, 1e-3])
    text = missing("joint_backlash", asked=asked, after=after, aside=(3,))
    assert "falls from 100 um to 50.0 um without the readings that stand out, from 583 um to 579 um with them." in text
    assert "falls from 583 um to 579 um." in missing("joint_backlash", asked=asked, after=after)


def test_a_reading_that_one_of_two_models_leaves_out_does_not_make_the_error_fall() -> None:
    asked, after = made([1, 2, 3], [1e-4, 1e-4, 1e-3]), made([1, 2], [5e-5, 5e-5])
    assert "falls from 100 um to 50.0 um without" in missing("joint_backlash", asked=asked, after=after)


def test_an_error_that_does_not_fall_is_not_said_to_fall() -> None:
    text = missing("joint_backlash", asked=made([1, 2], [5e-5, 5e-5]), after=made([1, 2], [6e-5, 6e-5]))
    assert "the error on held-out poses goes from 50.0 um to 60.0 um." in text


def test_a_tool_weight_that_differences_and_references_show_is_named_once() -> None:
    found = SimpleNamespace(names=("tool_weight", "creep"), weight_wrong=True)
    assert wording._named(found) == ("tool_weight", "creep")  # type: ignore[arg-type]


def test_of_several_effects_it_is_said_whose_axes_are_not_sure() -> None:
    text = missing("joint_backlash", "joint_torsion")
    assert "Joint backlash: perhaps also axis 3" in text and "Joint torsion: perhaps also axis 3" in text
    assert "Perhaps also axis 3" in missing("joint_backlash")


def sample(repeats: int, separates: tuple[str, ...] = ("tool_compliance", "base_compliance")) -> Measurement:
    return Measurement(4, "normal", separates, 41e-6, 0.5, repeats=repeats)


def test_what_every_robot_has_is_said_to_be_part_of_how_far_the_error_falls() -> None:
    assert "Added, with what every robot has, the error" in missing("joint_backlash", usual=("geometry_error",))
    assert "Added, the error" in missing("joint_backlash")


def apart(repeats: int, rivals: tuple[str, ...] = ("base_compliance",), usual: tuple[str, ...] = (), kind: str = "loaded") -> str:
    built = SimpleNamespace(rivals={"tool_compliance": tuple((r, 0.1) for r in rivals)})
    study = SimpleNamespace(ready=SimpleNamespace(kind=kind))
    assessment = SimpleNamespace(built=built, usual=usual, study=study)
    return " ".join(wording._rivals_apart(assessment, [sample(repeats)]))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("repeats", "words"),
    [
        (1, "at pose 4 separates"),
        (9, "at pose 4 9 times separates"),
        (0, "No single load case at these poses or near them tells"),
    ],
)
def test_how_often_a_sample_is_to_be_taken_is_said(repeats: int, words: str) -> None:
    text = apart(repeats)
    assert words in text and "tool compliance" in text and "base compliance" in text


def test_where_no_sample_tells_a_plan_on_the_tooling_is_proposed_for_loaded_sessions() -> None:
    assert "--to-tell" in apart(0) and "--to-tell" not in apart(0, kind="absolute") and "--to-tell" not in apart(1)


def test_nobody_is_sent_to_tell_what_every_robot_has_from_its_rival() -> None:
    assert apart(1) and apart(1, usual=("tool_compliance",)) == ""


def test_a_sample_that_separates_others_is_not_said_to_separate_the_rivals() -> None:
    assert apart(1, rivals=("station_shift",)) == "" and apart(1, rivals=()) == ""


def steps(
    repeats: int, one_of: tuple[tuple[str, ...], ...] = (), effects: tuple[str, ...] = ("joint_torsion",)
) -> list[tuple[str, str]]:
    verdict = SimpleNamespace(status="unexplained", depends_on=(), one_of=one_of)
    model = SimpleNamespace(effects=effects)
    found = SimpleNamespace(verdict=verdict, proposals=(), next_measurements=(sample(repeats),), noise=AS_STATED, model=model)
    return after_diagnosis(found, "SESSION")  # type: ignore[arg-type]


@pytest.mark.parametrize(("repeats", "words"), [(9, "load case normal, 9 repeats: it separates"), (0, "")])
def test_the_next_step_says_how_often_or_is_not_proposed(repeats: int, words: str) -> None:
    said = [text for text, _ in steps(repeats) if text.startswith("Measure next")]
    assert len(said) == bool(words) and all(words in text for text in said)


def test_where_the_data_do_not_tell_poses_that_do_are_the_next_step() -> None:
    sets = (("joint_backlash", "joint_stiffening"),)
    assert any(command == "irec plan CELL --to-tell SESSION" for _, command in steps(0, sets))
    assert not any("--to-tell" in command for _, command in [*steps(0), *steps(0, sets, GEOMETRIC)])


@pytest.mark.parametrize(
    ("effect_id", "also", "said"),
    [
        ("encoder_harmonics", "joint_backlash", "On which side of its play"),
        ("counterbalance", "encoder_harmonics", "What a balancer carries"),
        ("station_registration", "geometry_error", "A station turned"),
    ],
)
def test_why_two_effects_are_not_told_apart_goes_with_what_they_are(monkeypatch, effect_id, also, said) -> None:
    monkeypatch.setattr(wording, "also_called", lambda term, scene: also)
    final = SimpleNamespace(added=(SimpleNamespace(effect=find_effect(effect_id)),))
    found = SimpleNamespace(study=SimpleNamespace(ready=None), built=SimpleNamespace(final=final), one_of=((effect_id, also),))
    (sentence,) = wording._why_either(found)  # type: ignore[arg-type]
    assert sentence.startswith(said)
