# SPDX-License-Identifier: Apache-2.0
"""A hose that is fixed to a link of the wrist pulls whenever the process is on, in a direction that turns with the wrist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose, improve
from irec_calibration.diagnose.candidates import try_effect
from irec_calibration.diagnose.shape import _refined
from irec_calibration.diagnose.study import prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.hoses import CELL, TAUT, TIGHTENS, moored, stretched
from irec_calibration.effects.live import LeftOut, Pull
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term, total_displacement
from irec_calibration.typing import Array

PULL = np.array([60.0, -45.0, 30.0])  # N, along the frame of link 5
# a hose from beside the elbow to beside the flange: N/m, m, m along axis 3 and its virtual axes, m in tool0
STIFF, ON_FOREARM, AT_TOOL = 12000.0, np.array([0.15, 0.25, 0.0]), np.array([-0.1, 0.05, -0.2])


def of_link_5(scene: Scene) -> Array:
    """The pull in base_link, (n, 3), N."""
    return scene.kin.R_joint[:, 4] @ PULL * (scene.load_case > 0)[:, None]


def moves_the_tool(scene: Scene) -> Array:
    tau = np.einsum("nik,ni->nk", scene.kin.jacobian(scene.p_tcp), of_link_5(scene))
    return np.asarray(np.einsum("nik,nk->ni", scene.J, tau * synthetic.COMPLIANCE))


def test_along_axes_of_the_tool_it_is_what_turns_with_the_last_axis() -> None:
    scene, effect = scene_of(synthetic.session(poses=6)), find_effect("external_force")
    names = [p.name for p in effect.parameters(scene)]
    shape = [f"f_{a}_tool{t}" for t in ("", "_sin6", "_cos6") for a in "xyz"]
    columns = np.stack([effect.torque_of_pull(scene, np.eye(len(names))[names.index(n)]) for n in shape], axis=2)
    tau = np.einsum("nik,ni->nk", scene.kin.jacobian(scene.p_tcp), of_link_5(scene))
    values = np.linalg.lstsq(columns.reshape(-1, len(shape)), tau.ravel(), rcond=None)[0]
    np.testing.assert_allclose(columns @ values, tau, atol=1e-9)


def test_a_dress_pack_between_forearm_and_flange_bends_the_wrist_alone() -> None:
    scene = scene_of(synthetic.session(poses=6))
    springs = Term(find_effect("joint_torsion"), {f"c_{k + 1}": Estimate(c) for k, c in enumerate(synthetic.COMPLIANCE)})
    values = dict(zip((f"f_{d}_pack" for d in ("along", "a", "b")), PULL, strict=True))
    pack = Term(find_effect("external_force"), {n: Estimate(v) for n, v in values.items()})
    kin = scene.kin
    force = PULL[0] * kin.axis[:, 2] + PULL[1] * kin.virtual_axis[:, 2, 0] + PULL[2] * kin.virtual_axis[:, 2, 1]
    expected = np.zeros((len(scene), 3))
    for k in (3, 4, 5):  # the forearm carries back what the flange is pulled by, so that no axis before it feels a torque
        torque = np.einsum("ni,ni->n", kin.axis[:, k], np.cross(kin.origin[:, 5] - kin.origin[:, k], force))
        turned = synthetic.COMPLIANCE[k] * torque * (scene.load_case > 0)
        expected += turned[:, None] * np.cross(kin.axis[:, k], scene.p_observed - kin.origin[:, k])
    moved = total_displacement([springs, pack], scene) - total_displacement([springs], scene)
    np.testing.assert_allclose(moved, expected, atol=1e-12)
    tau = pack.effect.torque_of_pull(scene, pack.theta(pack.effect.parameters(scene)))
    assert np.abs(tau[:, 3:]).max() > 1.0 and np.all(tau[:, :3] == 0.0)


SOFT = synthetic.COMPLIANCE * [1.0, 1.0, 1.0, 4.0, 4.0, 4.0]  # a small wrist
TILTED = {"aligned": 0.6, "axis_aligned": 4, "compliance": SOFT}


def hose(scene: Scene, slack: float) -> tuple[Array, Array]:
    """Where the hose is tied to the flange, and its pull there, in base_link, (n, 3) each, m and N."""
    kin = scene.kin
    triad = np.stack([kin.axis[:, 2], kin.virtual_axis[:, 2, 0], kin.virtual_axis[:, 2, 1]], axis=2)
    at = scene.p_tcp + kin.R_tool @ AT_TOOL
    way = kin.origin[:, 2] + triad @ ON_FOREARM - at
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return at, STIFF * np.maximum(length - slack, 0.0) * way / length


def bends_the_arm(scene: Scene, at: Array, force: Array, joints: Sequence[int] = range(6)) -> Array:
    """What gears make of a force on the tool, (n, 3), m."""
    kin, out = scene.kin, np.zeros((len(scene), 3))
    for k in joints:
        torque = np.einsum("ni,ni->n", kin.axis[:, k], np.cross(at - kin.origin[:, k], force))
        out += (SOFT[k] * torque)[:, None] * np.cross(kin.axis[:, k], scene.p_observed - kin.origin[:, k])
    return out


def bends_the_wrist(scene: Scene, at: Array, force: Array) -> Array:
    return bends_the_arm(scene, at, force, (3, 4, 5))


def length_taut_in(share: float, scene: Scene) -> float:
    """Length of the hose that does not span its way in a share of the rows, m."""
    pull = np.linalg.norm(hose(scene, 0.0)[1], axis=1)
    return float(np.quantile(pull / STIFF, 1.0 - share))


def of_taut_hose(slack: float) -> list[Term]:
    """The springs with the hose."""
    values = {"k_hose": STIFF, "l_hose": slack}
    values |= {f"tied_{d}": float(v) for d, v in zip(("along", "a", "b"), ON_FOREARM, strict=True)}
    values |= {f"tied_{a}": float(v) for a, v in zip("xyz", AT_TOOL, strict=True)}
    return [*springs(), Term(find_effect("external_force"), {n: Estimate(v) for n, v in values.items()})]


def springs() -> list[Term]:
    return [Term(find_effect("joint_torsion"), {f"c_{k + 1}": Estimate(c) for k, c in enumerate(SOFT)})]


def test_a_hose_between_forearm_and_flange_pulls_with_and_without_the_process() -> None:
    scene = scene_of(synthetic.session(poses=12, **TILTED))
    slack = length_taut_in(1.0, scene) - 0.1
    moved = total_displacement(of_taut_hose(slack), scene) - total_displacement(springs(), scene)
    assert np.abs(moved[scene.load_case == 0]).min(axis=0).max() > 1e-5, "no example"
    np.testing.assert_allclose(moved, bends_the_wrist(scene, *hose(scene, slack)), atol=0.01 * np.abs(moved).max())


@pytest.mark.parametrize(("longer", "stretched_m"), [(-0.3, 3.3e-4), (0.0, 0.5 * TIGHTENS), (0.3, 0.3003)])
def test_a_hose_comes_tight_over_some_travel(longer: float, stretched_m: float) -> None:
    by, slope = stretched(np.array(longer))
    assert float(by) == pytest.approx(stretched_m, rel=0.02)
    ahead, behind = (float(stretched(np.array(longer + h))[0]) for h in (1e-6, -1e-6))
    assert float(slope) == pytest.approx((ahead - behind) / 2e-6, rel=1e-4)


def test_the_process_causes_only_what_such_a_hose_pulls_otherwise_than_at_the_reference() -> None:
    scene = scene_of(synthetic.session(poses=12, **TILTED), observe="tcp")
    slack = length_taut_in(1.0, scene) - 0.1
    moved = scene.change(total_displacement(of_taut_hose(slack), scene) - total_displacement(springs(), scene))
    at, force = hose(scene, slack)
    np.testing.assert_allclose(moved, bends_the_wrist(scene, at, scene.change(force)), atol=0.01 * np.abs(moved).max())
    standing = scene_of(synthetic.session(poses=12, approach=0.0), observe="tcp")
    moved = total_displacement(of_taut_hose(slack), standing) - total_displacement(springs(), standing)
    np.testing.assert_allclose(standing.change(moved), 0.0, atol=1e-12)


@pytest.mark.slow
def test_such_a_hose_is_named_and_predicts_poses_that_it_was_not_fitted_to() -> None:
    def pulled(scene: Scene) -> Array:
        return bends_the_wrist(scene, *hose(scene, length_taut_in(0.67, scene)))

    ladder = improve(synthetic.session(seed=3, extra=pulled, **TILTED))
    verdict = ladder.before.verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert {*verdict.parts["external_force"].proven} <= {TAUT}, verdict.text
    assert ladder.rungs[-1].cv_rms_m < 0.4 * ladder.rungs[0].cv_rms_m


# a hose from a place in the cell, in base_link, m, to beside the flange: it is 0.4 m long without a pull
PLACE_IN_CELL, OF_CELL, LENGTH = np.array([0.8, -0.7, 2.2]), 400.0, 0.4
STIFFENS = 150.0  # N/m^3


def from_the_cell(scene: Scene, stiffens: float = 0.0) -> tuple[Array, Array]:
    """Where it is tied to the tool, and its pull there, in base_link, (n, 3) each, m and N."""
    at = scene.p_tcp + scene.kin.R_tool @ AT_TOOL
    way = PLACE_IN_CELL - at
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return at, (OF_CELL * (1.0 - LENGTH / length) + stiffens * length**2) * way


def of_moored_hose(stiffens: float = 0.0) -> list[Term]:
    values = {"t_cell": -OF_CELL * LENGTH, "k_cell": OF_CELL, "s_cell": stiffens}
    values |= {f"from_{a}": float(v) for a, v in zip("xyz", PLACE_IN_CELL, strict=True)}
    values |= {f"at_{a}": float(v) for a, v in zip("xyz", AT_TOOL, strict=True)}
    return [*springs(), Term(find_effect("external_force"), {n: Estimate(v) for n, v in values.items()})]


@pytest.mark.parametrize("stiffens", [0.0, STIFFENS])
def test_a_hose_from_the_cell_pulls_with_and_without_the_process(stiffens: float) -> None:
    scene = scene_of(synthetic.session(poses=12, **TILTED))
    moved = total_displacement(of_moored_hose(stiffens), scene) - total_displacement(springs(), scene)
    assert np.abs(moved[scene.load_case == 0]).max() > 1e-5, "no example"
    np.testing.assert_allclose(moved, bends_the_arm(scene, *from_the_cell(scene, stiffens)), atol=1e-12)


def test_what_such_a_hose_does_by_where_it_is_tied_is_the_derivative_of_its_pull() -> None:
    scene, values = scene_of(synthetic.session(poses=6, **TILTED)), np.array([-60.0, 300.0, STIFFENS, *PLACE_IN_CELL, *AT_TOOL])

    def wrench(theta: Array) -> Array:
        return np.asarray(moored(scene, theta)[:, :, :3] @ theta[:3])

    by_value = moored(scene, values)
    for i, step in enumerate(1e-6 * np.eye(len(values))):
        expected = (wrench(values + step) - wrench(values - step)) / 2e-6
        np.testing.assert_allclose(by_value[:, :, i], expected, atol=1e-5 * np.abs(expected).max())


def test_the_process_causes_only_what_a_hose_from_the_cell_pulls_otherwise_than_at_the_reference() -> None:
    scene = scene_of(synthetic.session(poses=12, **TILTED), observe="tcp")
    moved = scene.change(total_displacement(of_moored_hose(), scene) - total_displacement(springs(), scene))
    at, force = from_the_cell(scene)
    np.testing.assert_allclose(moved, bends_the_arm(scene, at, scene.change(force)), atol=1e-12)


@pytest.mark.slow
def test_a_hose_from_the_cell_is_named_and_the_place_that_it_comes_from_is_told() -> None:
    verdict = diagnose(
        synthetic.session(seed=3, extra=lambda scene: bends_the_arm(scene, *from_the_cell(scene)), **TILTED)
    ).verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert verdict.parts["external_force"].proven == (CELL,), verdict.text
    told = verdict.where["external_force"].split("about (")[1].split(")")[0]
    np.testing.assert_allclose([float(v) for v in told.split(",")], PLACE_IN_CELL, atol=0.25)


@pytest.mark.parametrize(("length", "pushes"), [(LENGTH, False), (5.0, True)])
def test_a_hose_from_the_cell_that_would_push_is_none(length: float, pushes: bool) -> None:
    scene = scene_of(synthetic.session(poses=6, **TILTED))
    values = {n: (e.value, 0.0) for n, e in of_moored_hose()[-1].estimates.items()} | {"t_cell": (-OF_CELL * length, 0.0)}
    assert ("would push" in find_effect("external_force").why_impossible(values, {}, scene)) is pushes


def test_the_live_correction_leaves_a_hose_from_the_cell_out() -> None:
    scene = scene_of(synthetic.session(poses=6, **TILTED))
    term = of_moored_hose()[-1]
    assert isinstance(term.effect.live(scene, term.theta(term.effect.parameters(scene))), LeftOut)


def test_the_live_correction_leaves_such_a_hose_out_and_says_why() -> None:
    scene = scene_of(synthetic.session(poses=6, **TILTED))
    term = of_taut_hose(1.0)[-1]
    form = term.effect.live(scene, term.theta(term.effect.parameters(scene)))
    assert isinstance(form, LeftOut) and "without the process" in form.why
    beside = replace(term, estimates=term.estimates | {"f_x": Estimate(10.0)})
    assert isinstance(beside.effect.live(scene, beside.theta(beside.effect.parameters(scene))), Pull)


def test_people_are_told_to_look_at_the_hose_where_it_is_proven() -> None:
    effect = find_effect("external_force")
    assert "comes tight in some poses" in effect.where_to_look({"k_hose": STIFF, "l_hose": 1.2}, (TAUT,))
    assert effect.where_to_look({"k_hose": STIFF, "l_hose": 1.2}, ()) == ""


@pytest.mark.slow
def test_it_is_named_and_no_other_place_of_it_is_proven() -> None:
    verdict = diagnose(synthetic.session(seed=3, extra=moves_the_tool)).verdict
    assert verdict.effects == ("external_force",), verdict.text
    assert set(verdict.parts["external_force"].proven) <= {"with the tool", "with the tool and axis 6"}, verdict.text


def test_a_hose_from_the_cell_is_not_asked_for_where_the_tool_stands_at_the_references_as_under_load() -> None:
    effect = find_effect("external_force")
    asked = [{p.group for p in effect.parameters(scene_of(s))} for s in (synthetic.session(6, **TILTED), synthetic.session(6))]
    assert [CELL in groups for groups in asked] == [True, False]


def test_a_hose_that_is_as_short_as_it_may_be_is_no_place_to_look_from_on_a_scale_of_lengths() -> None:
    """A length of 0 has no logarithm: a session of an outside simulator ended with an error."""
    study = prepare(synthetic.session(poses=12, seed=3, **TILTED), springs())
    trial = try_effect(study, find_effect("external_force"))
    assert trial is not None
    start = {p.name: p.start for p in trial.effect.parameters(study.ready) if p.shapes == TAUT}
    short = replace(trial, best=replace(trial.best, shape=start | {"l_hose": 0.0}))
    assert _refined(study, short)["l_hose"] == 0.0
