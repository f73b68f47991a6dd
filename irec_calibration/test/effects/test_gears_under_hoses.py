# SPDX-License-Identifier: Apache-2.0
"""Gears carry weight and what hoses pull too: friction, play and stiffening answer to the whole torque, no part counts twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term, prepared, regressors, total_displacement
from irec_calibration.robot.ratings import rated_torque
from synthetic import session

AXIS = 2  # joint_3
SOFT, HARDENS, BREAK = 8e-7, -5e-7, 0.05  # rad/(N m), rad/(N m), share of the rated torque
PULL = (150.0, -90.0, -200.0)  # N in base_link
LAWS = {
    "joint_stiffening": {f"a_{AXIS + 1}": HARDENS, "x_0": BREAK, "slow": 0.0},
    "joint_hysteresis": {f"h_{AXIS + 1}": 4e-7, "r": 0.03, "spread": 0.0, "freed": 0.0, "arrived": 0.0, "gradual": 0.0},
    "joint_backlash": {f"b_{AXIS + 1}": 4e-4, "w": 0.02},
}


def term(effect_id: str, values: dict[str, float]) -> Term:
    return Term(find_effect(effect_id), {n: Estimate(v) for n, v in values.items()})


def pulled(law: str, pull: tuple[float, ...] = PULL) -> list[Term]:
    hose = dict(zip(("f_x", "f_y", "f_z"), pull, strict=True))
    return [term("joint_torsion", {f"c_{AXIS + 1}": SOFT}), term(law, LAWS[law]), term("external_force", hose)]


@pytest.fixture(scope="module")
def scene() -> Scene:
    plain = scene_of(session(6, seed=2))
    return replace(plain, view=replace(plain.view, sags=False))


def with_the_force(scene: Scene) -> Scene:
    """The scene as if the sensor read the hose too."""
    pull = np.einsum("nji,j->ni", scene.kin.R_tool, np.array(PULL)) * scene.rows.under_load[:, None]
    return scene.with_wrench(scene.force_in_tool + pull, scene.torque_in_tool)


@pytest.mark.parametrize("law", LAWS)
def test_a_gear_moves_under_a_hose_as_under_the_same_force_that_is_read(law: str, scene: Scene) -> None:
    by_hose = scene.change(total_displacement(pulled(law), scene))
    alone = scene.change(total_displacement(pulled(law), with_the_force(scene)))
    seen = scene.change(total_displacement(pulled(law)[:2], with_the_force(scene)))
    np.testing.assert_allclose(by_hose, seen, atol=1e-6 * np.abs(seen).max())
    assert np.abs(alone - seen).max() > 0.05 * np.abs(seen).max()


def test_a_stiffening_gear_under_a_hose_turns_by_the_law_of_its_whole_torque(scene: Scene) -> None:
    weight, acting = scene.tau_gravity[:, AXIS], with_the_force(scene).tau[:, AXIS]
    x_0 = BREAK * rated_torque(scene.robot)[AXIS]

    def turned(tau: np.ndarray) -> np.ndarray:
        return SOFT * tau + HARDENS * (tau - x_0 * np.tanh(tau / x_0))

    expected = scene.J[:, :, AXIS] * (turned(acting + weight) - turned(weight))[:, None]
    np.testing.assert_allclose(total_displacement(pulled("joint_stiffening"), scene), expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("law", "shape"),
    [
        *((law, {}) for law in LAWS),
        ("joint_stiffening", {"slow": 0.5}),
        ("joint_stiffening", {"slow": 1.0}),
        ("joint_hysteresis", {"spread": 1.0, "freed": 300.0, "arrived": 0.5, f"early_{AXIS + 1}": 2e-7}),
        ("joint_hysteresis", {"freed": 300.0, "arrived": 0.5, f"early_{AXIS + 1}": 2e-7, "gradual": 1.0}),
        ("joint_backlash", {f"p_{AXIS + 1}": 2e-4, "uneven": 1.0}),
        ("joint_backlash", {"held": 1.0}),
    ],
)
def test_what_gears_make_of_a_hose_is_part_of_the_derivative_by_its_force(
    law: str, shape: dict[str, float], scene: Scene
) -> None:
    def under(pull: np.ndarray) -> list[Term]:
        torsion, of_gear, hose = pulled(law, tuple(pull))
        return [torsion, replace(of_gear, estimates=term(law, LAWS[law] | shape).estimates), hose]

    terms, h = under(np.array(PULL)), 1e-3
    names = [p.name for p in terms[-1].effect.parameters(scene)]
    found = regressors(terms, scene)[-1]
    for i, name in enumerate(("f_x", "f_y", "f_z")):
        step = h * np.eye(3)[i]
        sides = [total_displacement(under(np.array(PULL) + s), scene) for s in (step, -step)]
        slope = (sides[0] - sides[1]) / (2.0 * h)
        np.testing.assert_allclose(found[:, :, names.index(name)], slope, atol=2e-3 * np.abs(slope).max())


@pytest.mark.parametrize("slow", [0.0, 0.5, 1.0])
def test_a_stiffening_gear_sags_under_the_weight_by_the_law_of_its_torque(slow: float, scene: Scene) -> None:
    weight, x_0 = scene.tau_gravity[:, AXIS], BREAK * rated_torque(scene.robot)[AXIS]
    terms = [term("joint_torsion", {f"c_{AXIS + 1}": SOFT}), term("joint_stiffening", LAWS["joint_stiffening"] | {"slow": slow})]

    def turned(tau: np.ndarray) -> np.ndarray:
        u = tau / x_0
        soft = {0.0: np.tanh(u), 0.5: np.sign(u) * (1.0 - np.exp(-np.abs(u))), 1.0: np.arcsinh(u)}[slow]
        return SOFT * tau + HARDENS * (tau - x_0 * soft)

    sags = replace(scene, view=replace(scene.view, sags=True))
    sagged = scene.change(total_displacement(terms, sags) - total_displacement(terms, scene))
    expected = scene.change(scene.J[:, :, AXIS] * turned(weight)[:, None])
    np.testing.assert_allclose(sagged, expected, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("hose", [{"f_x_wrist": 80.0, "f_z_wrist": -60.0}, {"k_wrist": 120.0}])
def test_a_hose_that_is_fixed_to_the_forearm_bends_the_arm_and_no_wrist_gear(hose: dict[str, float], scene: Scene) -> None:
    def pulled(axes: tuple[int, ...]) -> float:
        springs = term("joint_torsion", {f"c_{k}": 1e-6 for k in axes})
        moved = total_displacement([springs, term("external_force", hose)], scene) - total_displacement([springs], scene)
        return float(np.abs(moved).max())

    by_arm, by_wrist = pulled((1, 2, 3)), pulled((4, 5, 6))
    assert by_arm > 1e-5 and by_wrist < 1e-6 * by_arm


def test_a_hose_at_the_wrist_pulls_there(scene: Scene) -> None:
    springs = term("joint_torsion", {"c_2": 1e-6})
    hose = term("external_force", {"f_x_wrist": 100.0})
    pulled = total_displacement([springs, hose], scene) - total_displacement([springs], scene)
    lever = scene.kin.origin[:, 4] - scene.kin.origin[:, 1]
    torque = np.einsum("ni,ni->n", scene.kin.axis[:, 1], np.cross(lever, [100.0, 0.0, 0.0])) * scene.rows.under_load
    np.testing.assert_allclose(pulled, scene.J[:, :, 1] * (1e-6 * torque)[:, None], atol=1e-12)


def test_without_a_hose_nothing_pulls(scene: Scene) -> None:
    assert prepared(pulled("joint_backlash", (0.0, 0.0, 0.0)), scene).tau_unseen is None
    assert prepared(pulled("joint_backlash")[:2], scene).tau_unseen is None


@pytest.mark.parametrize("sensor", [{"e_xx": -0.02, "e_yy": 0.05}, {"w_x": 0.02, "w_y": -0.01}])
def test_what_follows_the_wrench_is_part_of_the_derivative_by_the_sensor(sensor: dict[str, float], scene: Scene) -> None:
    effect = find_effect("sensor_gain" if "e_xx" in sensor else "sensor_alignment")
    names = [p.name for p in effect.parameters(scene)]
    laws, creeps = [term(law, LAWS[law]) for law in LAWS], term("creep", {"share": 0.1, "T": 5.0})
    rest = [*laws, creeps, term("external_force", {"f_x": 80.0})]
    assert set(sensor) <= set(names)

    def with_sensor(values: np.ndarray) -> list[Term]:
        torsion = term("joint_torsion", {f"c_{AXIS + 1}": SOFT})
        return [torsion, *rest, term(effect.id, dict(zip(names, values, strict=True)))]

    at, h = np.array([sensor.get(n, 0.0) for n in names]), 1e-5
    found = regressors(with_sensor(at), scene)[-1]
    for i in range(len(names)):
        step = h * np.eye(len(names))[i]
        sides = [total_displacement(with_sensor(at + s), scene) for s in (step, -step)]
        slope = (sides[0] - sides[1]) / (2.0 * h)
        np.testing.assert_allclose(found[:, :, i], slope, atol=3e-3 * np.abs(slope).max())
