# SPDX-License-Identifier: Apache-2.0
"""Gears that creep alike, gears of which each creeps by its own share, gears that creep under the weight of the arm from pose to
pose, and a force sensor whose reading creeps, which no gear does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import Ladder, diagnose, improve
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Model, Term
from irec_calibration.typing import Array
from test_diagnose import session, turned

ALIKE = np.full(6, 0.15)
APART = np.array([0.05, 0.25, 0.1, 0.3, 0.05, 0.3])


def creeping(share: Array) -> Callable[[Scene], Array]:
    """Each gear goes on by its share within some 6 s, and back as slowly; rows are 4 s apart."""

    def moved(scene: Scene) -> Array:
        in_the_end = share * synthetic.COMPLIANCE * scene.tau
        angle = np.zeros_like(in_the_end)
        for row in range(1, len(angle)):
            if row % 6:
                angle[row] = angle[row - 1] + (in_the_end[row] - angle[row - 1]) * (1.0 - np.exp(-4.0 / 6.0))
        return turned(scene, angle)

    return moved


def found(share: Array) -> tuple[Ladder, dict[str, float]]:
    ladder = improve(session(creeping(share)))
    creep = next(t for t in ladder.rungs[-1].model.terms if t.effect.id == "creep")
    return ladder, {n: e.value for n, e in creep.estimates.items()}


@pytest.mark.parametrize(("share", "apart"), [(ALIKE, False), (APART, True)])
def test_creep_is_named_and_gears_creep_apart_where_the_session_shows_it(share: Array, apart: bool) -> None:
    ladder, values = found(share)
    assert ladder.before.verdict.effects == ("creep",)
    assert values["apart"] == float(apart)
    assert ("d_2" in values) == apart


def test_a_gear_that_creeps_more_than_another_has_more_compliance_of_its_own() -> None:
    _, values = found(APART)
    assert values["d_2"] / synthetic.COMPLIANCE[1] > values["d_1"] / synthetic.COMPLIANCE[0] + 0.1


def creeping_under_the_weight(scene: Scene) -> Array:
    """Each gear goes on within some 20 s, whatever turns it, also from one pose to the next."""
    in_the_end = APART * synthetic.COMPLIANCE * (scene.tau + scene.tau_gravity)
    angle = in_the_end.copy()
    for row in range(1, len(angle)):
        kept = np.exp(-(scene.stamp[row] - scene.stamp[row - 1]) / 20.0)
        angle[row] = in_the_end[row] + (angle[row - 1] - in_the_end[row]) * kept
    return turned(scene, angle)


@pytest.mark.slow
@pytest.mark.long
def test_gears_that_creep_under_the_weight_from_pose_to_pose_creep_and_have_no_friction() -> None:
    ladder = improve(session(creeping_under_the_weight))
    creep = next(t for t in ladder.rungs[-1].model.terms if t.effect.id == "creep")
    assert ladder.before.verdict.effects == ("creep",), ladder.before.verdict.text
    assert creep.estimates["apart"].value == 2.0


@pytest.mark.parametrize(("between_rows", "moves"), [(4.0, True), (1000.0, False)])
def test_a_prediction_has_what_gears_still_creep_under_the_weight_between_reference_and_row(between_rows, moves) -> None:
    made = synthetic.session(6)
    n = len(made)
    made = replace(made, force_in_tool=np.zeros((n, 3)), stamp=between_rows * np.arange(n))
    scene = scene_of(made, observe="tcp")
    values = {"T": 20.0, "memory": 1.0, "apart": 2.0} | {f"d_{k + 1}": 1e-7 for k in range(6)}
    model = Model((Term(find_effect("creep"), {name: Estimate(v) for name, v in values.items()}),))
    assert (np.abs(model.predict(scene)).max() > 1e-6) == moves


def read_too_high_the_longer_it_lasts(scene: Scene) -> Array:
    """The force sensor reads 0.3 of each load too much within some 6 s: what acts falls behind what is read."""
    return np.asarray(-creeping(np.full(6, 0.3))(scene))


@pytest.mark.long
def test_a_force_sensor_whose_reading_creeps_is_no_creep_of_gears() -> None:
    verdict = diagnose(session(read_too_high_the_longer_it_lasts)).verdict
    assert "creep" not in verdict.effects and not any("creep" in s for s in verdict.one_of), verdict.text
    assert verdict.status == "unexplained", verdict.text
