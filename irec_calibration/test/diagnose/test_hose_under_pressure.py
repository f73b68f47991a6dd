# SPDX-License-Identifier: Apache-2.0
"""A hose between forearm and flange through which coolant or air flows while the process runs draws the wrist together then."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import improve
from irec_calibration.diagnose.candidates import options
from irec_calibration.diagnose.ground import Ground
from irec_calibration.diagnose.study import Study, prepare, study_of
from irec_calibration.effects import find_effect
from irec_calibration.effects.hoses import PLACE, PRESSED, taut
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term, total_displacement
from irec_calibration.typing import Array

# N/m, m, m along axis 3 and its virtual axes, m in tool0
STIFF, LENGTH, ON_FOREARM, AT_TOOL = 1500.0, 0.3, np.array([0.15, 0.25, 0.0]), np.array([-0.1, 0.05, -0.2])
VALUES = np.array([STIFF, LENGTH, *ON_FOREARM, *AT_TOOL])
NAMES = ("k_press", "l_press", "press_along", "press_a", "press_b", "press_x", "press_y", "press_z")


def springs() -> list[Term]:
    return [Term(find_effect("joint_torsion"), {f"c_{k + 1}": Estimate(c) for k, c in enumerate(synthetic.COMPLIANCE)})]


def hose() -> Term:
    return Term(find_effect("external_force"), {n: Estimate(float(v)) for n, v in zip(NAMES, VALUES, strict=True)})


def pulled(scene: Scene) -> Array:
    """What the gears of the wrist make of the hose, (n, 3), m: nothing at the references."""
    kin = scene.kin
    triad = np.stack([kin.axis[:, 2], kin.virtual_axis[:, 2, 0], kin.virtual_axis[:, 2, 1]], axis=2)
    at = scene.p_tcp + kin.R_tool @ AT_TOOL
    way = kin.origin[:, 2] + triad @ ON_FOREARM - at
    length = np.linalg.norm(way, axis=1, keepdims=True)
    force = STIFF * np.maximum(length - LENGTH, 0.0) * way / length * (scene.load_case > 0)[:, None]
    out = np.zeros((len(scene), 3))
    for k in (3, 4, 5):
        torque = np.einsum("ni,ni->n", kin.axis[:, k], np.cross(at - kin.origin[:, k], force))
        turned = synthetic.COMPLIANCE[k] * torque
        out += turned[:, None] * np.cross(kin.axis[:, k], scene.p_observed - kin.origin[:, k])
    return out


def test_it_pulls_while_the_process_runs_and_bends_the_wrist_alone() -> None:
    scene = scene_of(synthetic.session(poses=12))
    moved = total_displacement([*springs(), hose()], scene) - total_displacement(springs(), scene)
    assert np.abs(moved).max() > 1e-5 and not moved[scene.load_case == 0].any()
    np.testing.assert_allclose(moved, pulled(scene), atol=0.01 * np.abs(moved).max())


def test_what_it_does_by_each_of_its_values_is_the_derivative_of_its_pull() -> None:
    scene = scene_of(synthetic.session(poses=6))

    def wrench(theta: Array) -> Array:
        return np.asarray(taut(scene, theta, pressed=True)[:, :, 0] * theta[0])

    by_value = taut(scene, VALUES, pressed=True)
    for i, step in enumerate(1e-6 * np.eye(len(VALUES))):
        expected = (wrench(VALUES + step) - wrench(VALUES - step)) / 2e-6
        np.testing.assert_allclose(by_value[:, :, i], expected, atol=1e-4 * max(np.abs(expected).max(), 1e-3))


def test_what_gears_carry_has_its_torque() -> None:
    scene, term = scene_of(synthetic.session(poses=6)), hose()
    tau = term.effect.torque_of_pull(scene, term.theta(term.effect.parameters(scene)))  # type: ignore[attr-defined]
    assert np.abs(tau[:, 3:]).max() > 1.0 and not tau[:, :3].any() and not tau[scene.load_case == 0].any()


def test_people_are_told_to_look_at_it_where_it_is_proven() -> None:
    look = find_effect("external_force").where_to_look({"k_press": STIFF, "l_press": LENGTH}, (PRESSED,))
    assert "while the process runs" in look and "between forearm and flange" in look


@pytest.mark.slow
def test_it_is_named_and_predicts_poses_that_it_was_not_fitted_to() -> None:
    ladder = improve(synthetic.session(seed=3, extra=pulled))
    verdict = ladder.before.verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert {*verdict.parts["external_force"].proven} <= {PRESSED}, verdict.text
    assert ladder.rungs[-1].cv_rms_m < 0.4 * ladder.rungs[0].cv_rms_m


def beside(*terms: Term) -> Study:
    return study_of(study_of_springs().observation, (*springs(), *terms))


def study_of_springs() -> Study:
    return prepare(synthetic.session(poses=12, seed=3, extra=pulled), [Term(find_effect("joint_torsion"))])


def test_a_form_that_has_no_place_yet_shows_in_no_table_of_another_form() -> None:
    study = study_of_springs()
    (option,), _ = options(study, [find_effect("external_force")])
    placed = {t.place: set(t.groups) for t in option.placed(Ground(study.bench, study.base)) if t.place}
    assert PLACE in placed[PLACE] and PRESSED in placed[PRESSED]
    assert PRESSED not in placed[PLACE] and PLACE not in placed[PRESSED]


def test_a_law_of_torque_is_asked_of_what_gears_carry_beside_the_hose_of_a_model() -> None:
    without, with_it, play = study_of_springs(), beside(hose()), find_effect("joint_backlash")
    (option,), _ = options(without, [play])
    (anew,), _ = options(with_it, [play])
    assert option.on(without) is option
    for mine, fresh in zip(option.on(with_it).tables, anew.tables, strict=True):
        np.testing.assert_array_equal(mine.block.A, fresh.block.A)
    assert any(np.abs(a.block.A - b.block.A).max() > 1e-3 for a, b in zip(option.tables, anew.tables, strict=True))


def test_what_is_no_law_of_torque_is_not_asked_anew_beside_a_hose() -> None:
    (option,), _ = options(study_of_springs(), [find_effect("marker_offset")])
    assert option.on(beside(hose())) is option
