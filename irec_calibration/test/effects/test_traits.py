# SPDX-License-Identifier: Apache-2.0
"""What effects say about themselves, so that nobody has to know them by name."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.effects import CATALOGUE, Evidence, find_effect
from irec_calibration.effects.formula import FormulaEffect
from irec_calibration.effects.of_session import scene_of
from synthetic import session

IDS = [cls.id for cls in CATALOGUE]
ROOT = Path(__file__).parents[3]
# lists of effects by purpose: the base models, and the wear that a recertification looks for
BY_NAME_ALLOWED = ("model/model.py", "identification/absolute.py", "recertification/", "report/recertification.py")


@pytest.fixture(scope="module")
def scene():
    return scene_of(session(4, seed=3))


@pytest.mark.parametrize("effect_id", IDS)
def test_every_effect_of_the_catalogue_says_which_family_it_is_of(effect_id):
    assert find_effect(effect_id).family is not None


@pytest.mark.parametrize("effect_id", IDS)
def test_a_part_that_is_one_axis_says_which(effect_id, scene):
    for p in find_effect(effect_id).parameters(scene):
        if re.fullmatch(r"axis \d+", p.group):
            assert p.axis == int(p.group.removeprefix("axis ")) - 1


def test_a_formula_for_an_axis_says_which(scene):
    assert [p.axis for p in FormulaEffect("mine", "axis 3: c * tau**3").parameters(scene)] == [2]
    assert [p.axis for p in FormulaEffect("mine", "tool x: c * f_x").parameters(scene)] == [None]


def test_a_shift_of_the_station_is_looked_for_only_at_moments_that_part_a_reference_from_its_rows(scene):
    grid = np.array(find_effect("station_shift").parameters(scene)[-1].grid)
    start, end = scene.stamp[scene.reference], scene.stamp
    parts = [any((start < t) & (t < end)) for t in grid]
    moments = 0.5 * (np.unique(scene.stamp)[1:] + np.unique(scene.stamp)[:-1])
    others = [any((start < t) & (t < end)) for t in moments if t not in grid]
    assert all(parts) and len(grid) == 20 and not any(others)


def test_evidence_that_is_not_in_the_displacements_of_all_poses_is_declared():
    elsewhere = {cls.id: cls.evidence for cls in CATALOGUE if cls.evidence is not Evidence.DISPLACEMENTS}
    assert elsewhere == {"tool_weight": Evidence.REFERENCE_READINGS, "station_shift": Evidence.ONE_POSE}


def test_no_module_outside_the_effects_decides_by_the_id_of_one():
    package = ROOT / "irec_calibration/irec_calibration"
    named = re.compile(rf"""["']({"|".join(IDS)})["']""")
    found = {
        str(p.relative_to(package)): named.findall(p.read_text(encoding="utf-8"))
        for p in package.rglob("*.py")
        if p.relative_to(package).parts[0] != "effects" and not str(p.relative_to(package)).startswith(BY_NAME_ALLOWED)
    }
    assert {name: ids for name, ids in found.items() if ids} == {}
