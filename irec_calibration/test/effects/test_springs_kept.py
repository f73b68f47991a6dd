# SPDX-License-Identifier: Apache-2.0
"""What springs do at one place of the arm is kept and used at other wrenches: it is what they would be asked for."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.model import Estimate, Term, displacements, elastic_response, regressors, total_displacement
from irec_calibration.model.springs import answer_of, displacement_at, is_kept, response_of
from synthetic import session

SPRINGS = ["joint_torsion", "link_bending", "bending_place", "tool_compliance", "base_compliance", "joint_coupling"]


def values(effect_id: str, scene: Scene) -> np.ndarray:
    return np.array([(1.0 + 0.1 * i) * p.scale for i, p in enumerate(find_effect(effect_id).parameters(scene))])


def other_wrench(scene: Scene) -> Scene:
    rng = np.random.default_rng(3)
    return scene.with_wrench(rng.normal(0.0, 300.0, (len(scene), 3)), rng.normal(0.0, 40.0, (len(scene), 3)))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(session(6, seed=2))


@pytest.mark.parametrize("effect_id", SPRINGS)
def test_the_displacement_at_another_wrench_is_that_of_the_effect(effect_id: str, scene: Scene) -> None:
    effect, theta = find_effect(effect_id), values(effect_id, scene)
    assert is_kept(effect, scene)
    for s in (scene, other_wrench(scene)):
        asked = effect.displacement(s, theta)
        np.testing.assert_allclose(displacement_at(effect, theta, s), asked, atol=1e-12 * np.abs(asked).max())
    assert answer_of(effect, theta, scene) is answer_of(effect, theta, other_wrench(scene))


def test_the_rotation_is_how_the_displacement_changes_along_the_tool(scene: Scene) -> None:
    terms = [
        Term(find_effect(i), {p.name: Estimate(p.scale) for p in find_effect(i).parameters(scene)})
        for i in ("joint_torsion", "tool_compliance")
    ]
    there = other_wrench(scene)
    found = elastic_response(terms, there)
    moved = sum(t.effect.displacement(there, t.theta(t.effect.parameters(there))) for t in terms)
    np.testing.assert_allclose(found.displacement, moved, atol=1e-12 * np.abs(moved).max())
    ahead = there.seen_at(there.p_observed + [0.0, 0.0, 1.0])
    beyond = sum(t.effect.displacement(ahead, t.theta(t.effect.parameters(ahead))) for t in terms)
    np.testing.assert_allclose(np.cross(found.rotation, [0.0, 0.0, 1.0]), beyond - moved, atol=1e-12 * np.abs(moved).max())
    pressed = there.with_wrench(there.force_in_tool + [0.0, 1.0, 0.0], there.torque_in_tool)
    more = sum(t.effect.displacement(pressed, t.theta(t.effect.parameters(pressed))) for t in terms)
    np.testing.assert_allclose(found.compliance[:, :, 1], more - moved, atol=1e-12 * np.abs(moved).max())


def test_what_gravity_does_belongs_to_it_and_is_asked_again_under_another() -> None:
    hangs = scene_of(absolute_sessions.session(poses=6))
    effect, theta = find_effect("joint_torsion"), values("joint_torsion", hangs)
    twice = replace(hangs, gravity=replace(hangs.gravity, tau=2.0 * hangs.gravity.tau))
    for s in (hangs, twice):
        np.testing.assert_allclose(displacement_at(effect, theta, s), effect.displacement(s, theta), rtol=1e-9)


def test_springs_that_bend_a_curve_and_large_scenes_are_asked_each_time(scene: Scene) -> None:
    assert not is_kept(find_effect("joint_stiffening"), scene)
    many = scene_of(session(501, seed=2))
    assert not is_kept(find_effect("joint_torsion"), many)
    theta = values("joint_torsion", many)
    found = response_of(find_effect("joint_torsion"), theta, many)
    np.testing.assert_allclose(found.displacement, find_effect("joint_torsion").displacement(many, theta), atol=1e-15)


def test_what_creeps_is_the_loaded_gear_where_stiffening_takes_from_its_spring(scene: Scene) -> None:
    scene = replace(scene, view=replace(scene.view, sags=False))

    def model(c_3: float, a_3: float) -> list[Term]:
        springs = Term(find_effect("joint_torsion"), {"c_3": Estimate(c_3)})
        gear = {"a_3": Estimate(a_3), "x_0": Estimate(0.05), "slow": Estimate(0.0)}
        creeps = {"share": Estimate(0.3), "T": Estimate(10.0), "memory": Estimate(0.0), "spread": Estimate(0.0)}
        return [springs, Term(find_effect("joint_stiffening"), gear), Term(find_effect("creep"), creeps)]

    soft, loaded = (displacements(model(*values), scene)["creep"] for values in ((5e-7, -3e-7), (2e-7, 0.0)))
    np.testing.assert_allclose(soft, loaded, rtol=1e-9, atol=1e-15)
    by_soft = regressors(model(5e-7, -3e-7), scene)
    h = 1e-9
    for term, name, changed in ((0, "c_3", (5e-7 + h, -3e-7)), (1, "a_3", (5e-7, -3e-7 + h))):
        effect = model(0.0, 0.0)[term].effect
        at = [p.name for p in effect.parameters(scene)].index(name)
        moved = total_displacement(model(*changed), scene) - total_displacement(model(5e-7, -3e-7), scene)
        np.testing.assert_allclose(by_soft[term][:, :, at], moved / h, rtol=1e-5, atol=1e-3 * np.abs(moved / h).max())
