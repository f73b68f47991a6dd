# SPDX-License-Identifier: Apache-2.0
"""A hose that is fixed to a link of the wrist pulls whenever the process is on, in a direction that turns with the wrist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.diagnose import diagnose, improve
from irec_calibration.effects import find_effect
from irec_calibration.effects.hoses import TAUT, TIGHTENS, stretched
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


def bends_the_wrist(scene: Scene, at: Array, force: Array) -> Array:
    """What three gears of the wrist make of a force on the flange, (n, 3), m."""
    kin, out = scene.kin, np.zeros((len(scene), 3))
    for k in (3, 4, 5):
        torque = np.einsum("ni,ni->n", kin.axis[:, k], np.cross(at - kin.origin[:, k], force))
        out += (SOFT[k] * torque)[:, None] * np.cross(kin.axis[:, k], scene.p_observed - kin.origin[:, k])
    return out


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
