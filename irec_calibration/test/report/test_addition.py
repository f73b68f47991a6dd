# SPDX-License-Identifier: Apache-2.0
"""Additions are judged by the held-out error; every result ends with what to do next; a table and its verdict agree."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from irec_calibration.effects import Parameter
from irec_calibration.effects.formula import FormulaEffect
from irec_calibration.identification.validation import HeldOut
from irec_calibration.model import Estimate, Term
from irec_calibration.report.addition import addition_of, length, probability
from irec_calibration.report.why_named import contradiction

PARAMETERS = (Parameter("c", "1", 1.0, lower=0.0, upper=10.0, plausible=(0.0, 3.0)),)


def held_out(rms: float, seed: int, poses: int = 20) -> HeldOut:
    loss = np.random.default_rng(seed).uniform(0.9, 1.1, poses) * (rms / 1e-5) ** 2
    return HeldOut(rms, 1e-6, rms, 1e-6, np.arange(poses), loss, np.zeros((poses, 3)))


def term(value: float, se: float = 0.1) -> Term:
    return Term(FormulaEffect("e", "axis 1: c * tau"), {"c": Estimate(value, se)})


def test_an_addition_that_lowers_the_held_out_error_clearly_is_supported():
    said = addition_of(held_out(4e-5, 0), held_out(2e-5, 1), term(1.0), PARAMETERS)
    assert said.supported and "falls from 40.0 um to 20.0 um" in said.sentence


def test_an_addition_that_changes_nothing_is_not_supported():
    same = held_out(4e-5, 0)
    said = addition_of(same, same, term(1.0), PARAMETERS)
    assert said.support == "not supported" and "do not support" in said.sentence


def test_an_addition_that_raises_the_error_is_not_supported():
    assert addition_of(held_out(2e-5, 0), held_out(4e-5, 1), term(1.0), PARAMETERS).support == "not supported"


def test_too_few_poses_decide_nothing():
    assert addition_of(held_out(4e-5, 0, 2), held_out(2e-5, 1, 2), term(1.0), PARAMETERS).support == "undecided"


@pytest.mark.parametrize(("value", "words"), [(0.05, "told from zero"), (10.0, "At its bound: c"), (5.0, "physically likely: c")])
def test_what_is_odd_about_the_values_is_said(value, words):
    assert words in addition_of(held_out(4e-5, 0), held_out(2e-5, 1), term(value), PARAMETERS).sentence


@pytest.mark.parametrize(
    ("metres", "text"), [(4.25e-5, "42.5 um"), (1.234e-4, "123 um"), (2.345e-3, "2.35 mm"), (math.nan, "unknown")]
)
def test_lengths_are_written_for_people(metres, text):
    assert length(metres) == text


@pytest.mark.parametrize(("p", "text"), [(3.753e-128, "p < 0.0001"), (0.0042, "p = 0.0042"), (0.91, "p = 0.91")])
def test_probabilities_are_written_as_far_as_they_mean_anything(p, text):
    assert probability(p) == text


def candidate(effect: str, cv: float, evidence: float) -> SimpleNamespace:
    return SimpleNamespace(effect=effect, cv_rms_m=cv, cv_rms_se_m=2e-6, log_evidence=evidence)


def test_a_named_effect_with_a_longer_bar_than_another_is_explained():
    shown = [candidate("joint_backlash", 3.0e-5, 20.0), candidate("joint_stiffening", 2.9e-5, 12.0)]
    (text,) = contradiction(shown, ["joint_backlash"])  # type: ignore[arg-type]
    assert "Why joint_backlash is named although joint_stiffening has the smaller bar" in text and "2,981" in text


def test_nothing_is_explained_where_bar_and_verdict_agree():
    shown = [candidate("joint_backlash", 2.9e-5, 20.0), candidate("joint_stiffening", 3.0e-5, 12.0)]
    assert contradiction(shown, ["joint_backlash"]) == []  # type: ignore[arg-type]


def test_no_odds_are_told_against_what_is_named():
    shown = [candidate("marker_offset", 1.96e-4, 30.8), candidate("external_force", 1.55e-4, 49.7)]
    (text,) = contradiction(shown, ["marker_offset"])  # type: ignore[arg-type]
    assert "factor" not in text and "alone external_force has more evidence" in text
    assert "needed beside all others of the model" in text


def test_an_effect_that_may_be_missing_beside_the_named_one_is_no_loser():
    shown = [candidate("marker_offset", 1.96e-4, 30.8), candidate("external_force", 1.55e-4, 49.7)]
    sets = [("station_shift", "external_force"), ("station_shift", "tool_compliance")]
    (text,) = contradiction(shown, ["marker_offset"], sets)  # type: ignore[arg-type]
    assert "factor" not in text and "one of station_shift, external_force is needed too" in text
