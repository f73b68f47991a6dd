# SPDX-License-Identifier: Apache-2.0
"""Sentences of a verdict: of which effect they speak, and how often a proposed sample has to be taken."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from irec_calibration.diagnose import wording
from irec_calibration.diagnose.part_sets import Parts
from irec_calibration.diagnose.result import Measurement
from irec_calibration.identification.noise import InferredNoise
from irec_calibration.identification.validation import HeldOut, rms
from irec_calibration.report.next_steps import after_diagnosis

AS_STATED = InferredNoise(41e-6, 41e-6, 38e-6, 44e-6, "residual", 300.0)
TWICE = InferredNoise(41e-6, 82e-6, 78e-6, 86e-6, "residual", 300.0)


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
    return " ".join(wording._missing(found, SimpleNamespace(asked=asked or same, after=after or same), ()))  # type: ignore[arg-type]


def test_a_reading_that_stands_out_does_not_hide_how_far_the_error_falls() -> None:
    asked, after = made([1, 2, 3], [1e-4, 1e-4, 1e-3]), made([1, 2, 3], [5e-5, 5e-5, 1e-3])
    text = missing("joint_backlash", asked=asked, after=after, aside=(3,))
    assert "falls from 100 um to 50.0 um without the readings that stand out, from 583 um to 579 um with them." in text
    assert "falls from 583 um to 579 um." in missing("joint_backlash", asked=asked, after=after)


def test_a_reading_that_one_of_two_models_leaves_out_does_not_make_the_error_fall() -> None:
    asked, after = made([1, 2, 3], [1e-4, 1e-4, 1e-3]), made([1, 2], [5e-5, 5e-5])
    assert "falls from 100 um to 50.0 um without" in missing("joint_backlash", asked=asked, after=after)


def test_of_several_effects_it_is_said_whose_axes_are_not_sure() -> None:
    text = missing("joint_backlash", "joint_torsion")
    assert "Joint backlash: perhaps also axis 3" in text and "Joint torsion: perhaps also axis 3" in text
    assert "Perhaps also axis 3" in missing("joint_backlash")


def sample(difference_m: float, separates: tuple[str, ...] = ("tool_compliance", "base_compliance")) -> Measurement:
    return Measurement(4, "normal", separates, difference_m, 0.5 * (difference_m / 41e-6) ** 2)


def test_what_every_robot_has_is_said_to_be_part_of_how_far_the_error_falls() -> None:
    assert "Added, with what every robot has, the error" in missing("joint_backlash", usual=("geometry_error",))
    assert "Added, the error" in missing("joint_backlash")


def apart(
    difference_m: float,
    noise: InferredNoise = AS_STATED,
    rivals: tuple[str, ...] = ("base_compliance",),
    usual: tuple[str, ...] = (),
) -> str:
    built = SimpleNamespace(rivals={"tool_compliance": tuple((r, 0.1) for r in rivals)})
    assessment = SimpleNamespace(built=built, noise=noise, usual=usual)
    return " ".join(wording._rivals_apart(assessment, [sample(difference_m)]))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("difference_m", "noise", "words"),
    [
        (200e-6, AS_STATED, "they differ there by 200 um."),
        (41e-6, AS_STATED, "they differ there by 41.0 um, so take at least 9 repeats."),
        (200e-6, TWICE, "they differ there by 200 um, so take at least 2 repeats."),
        (8.7e-6, AS_STATED, "they differ by 8.7 um at most, too little for 20 repeats"),
        (41e-6, TWICE, "they differ by 41.0 um at most, too little for 20 repeats"),
    ],
)
def test_how_often_a_sample_is_to_be_taken_is_said(difference_m: float, noise: InferredNoise, words: str) -> None:
    text = apart(difference_m, noise)
    assert words in text and "tool compliance" in text and "base compliance" in text


def test_nobody_is_sent_to_tell_what_every_robot_has_from_its_rival() -> None:
    assert apart(200e-6) and apart(200e-6, usual=("tool_compliance",)) == ""


def test_a_sample_that_separates_others_is_not_said_to_separate_the_rivals() -> None:
    assert apart(200e-6, rivals=("station_shift",)) == "" and apart(200e-6, rivals=()) == ""


@pytest.mark.parametrize(("difference_m", "words"), [(41e-6, "load case normal, 9 repeats: it separates"), (8.7e-6, "")])
def test_the_next_step_says_how_often_or_is_not_proposed(difference_m: float, words: str) -> None:
    verdict = SimpleNamespace(status="unexplained", depends_on=())
    found = SimpleNamespace(verdict=verdict, proposals=(), next_measurements=(sample(difference_m),), noise=AS_STATED)
    said = [text for text, _ in after_diagnosis(found, "SESSION") if text.startswith("Measure next")]  # type: ignore[arg-type]
    assert len(said) == bool(words) and all(words in text for text in said)
