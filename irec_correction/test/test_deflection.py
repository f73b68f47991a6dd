# SPDX-License-Identifier: Apache-2.0
"""The compiled deflection against the model that calibration evaluates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.effects import Effect, Parameter, find_effect
from irec_calibration.effects.formula import FormulaEffect
from irec_calibration.effects.production import LOADED, at, production_scene
from irec_calibration.effects.scene import Scene
from irec_calibration.errors import EffectError
from irec_calibration.model import Estimate, Model, Term, total_displacement
from irec_calibration.robot import Robot
from irec_correction.deflection import Deflection
from irec_correction.errors import ActivationError

ROBOT = Robot.from_urdf(Path(__file__).parents[2] / "config/robots/kr120_r2700_extra_ha.urdf")
angles = st.tuples(*(st.floats(lo, hi) for lo, hi in ((-1, 1), (-2, -0.8), (0.6, 2), (-2, 2), (-1.5, 1.5), (-2, 2))))
forces = st.tuples(*(st.floats(-1500, 1500) for _ in range(3)))
torques = st.tuples(*(st.floats(-100, 100) for _ in range(3)))
DOWN = np.array([0.0, 0.0, -9.81])


def rows_at(q: np.ndarray, force: np.ndarray, torque: np.ndarray, rail: float = 0.7) -> Scene:
    """One pose without and with a process force, the TCP and points beside it."""
    scene = at(production_scene(ROBOT, DOWN), q, rail)
    return scene.with_wrench(np.outer(LOADED, force), np.outer(LOADED, torque))


def model_of(*effects: str, seed: int = 1) -> Model:
    rng = np.random.default_rng(seed)
    scene = rows_at(np.array([0.3, -1.4, 1.5, 0.2, 0.6, 0.1]), np.ones(3), np.ones(3))
    terms = []
    for name in effects:
        effect = FormulaEffect("mine", name) if ":" in name else find_effect(name)
        values = {p.name: Estimate(_some_value(p, rng)) for p in effect.parameters(scene)}
        terms.append(Term(effect, values))
    return Model(tuple(terms))


def _some_value(p: Parameter, rng: np.random.Generator) -> float:
    size = p.scale * rng.uniform(0.3, 1.0) * (1.0 if p.upper > 0.0 else -1.0)
    return float(rng.choice(p.grid) if p.grid else np.clip(size, p.lower, p.upper))


def by_calibration(model: Model, q: np.ndarray, force: np.ndarray, torque: np.ndarray) -> np.ndarray:
    return model.predict(rows_at(q, force, torque))[len(LOADED) // 2]


@settings(max_examples=20, deadline=None)
@given(q=angles, force=forces, torque=torques)
def test_rotation_turns_a_point_of_the_tool_as_the_translation_of_that_point_says(q, force, torque):
    model = model_of("joint_torsion", "link_bending", "base_compliance")
    q, force, torque = map(np.array, (q, force, torque))
    translation, rotation = Deflection(model, ROBOT)(q, force, torque, 0.004)
    arm = np.array([0.1, -0.2, 0.3])
    scene = rows_at(q, force, torque)
    scene = scene.seen_at(scene.p_tcp + arm)
    np.testing.assert_allclose(translation + np.cross(rotation, arm), total_displacement(model.terms, scene)[-1], atol=1e-12)


def test_instance_gives_the_same_answer_whatever_pose_came_before():
    model = model_of("joint_torsion", "link_bending")
    q, force = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3]), np.array([100.0, -50.0, -900.0])
    used = Deflection(model, ROBOT)
    used(q + 0.4, 2 * force, np.ones(3), 0.004)
    np.testing.assert_array_equal(
        used(q, force, np.zeros(3), 0.004)[0], Deflection(model, ROBOT)(q, force, np.zeros(3), 0.004)[0]
    )


def axis_torque(q: np.ndarray, force: np.ndarray) -> np.ndarray:
    kin = ROBOT.kinematics(q[None])
    return kin.jacobian(kin.p_tcp)[0].T @ kin.R_tool[0] @ force


def backlash_case() -> tuple[Deflection, np.ndarray, np.ndarray, float]:
    model = Model((Term(find_effect("joint_backlash"), {"b_1": Estimate(2e-4)}),))
    q = np.array([0.3, -1.4, 1.5, 0.2, 0.6, 0.1])
    direction = ROBOT.kinematics(q[None]).R_tool[0].T @ np.array([0.0, 1.0, 0.0])
    return Deflection(model, ROBOT), q, direction, abs(axis_torque(q, direction)[0])


def test_backlash_moves_the_joint_by_its_play_when_the_torque_changes_sign():
    deflection, q, direction, lever = backlash_case()
    kin = ROBOT.kinematics(q[None])
    one = deflection(q, +300 * direction, np.zeros(3), 0.004)[0]
    other = deflection(q, -300 * direction, np.zeros(3), 0.004)[0]
    np.testing.assert_allclose(np.linalg.norm(one - other), 2e-4 * np.linalg.norm(kin.jacobian(kin.p_tcp)[0][:, 0]), rtol=1e-9)


def test_backlash_moves_nothing_without_load_where_gravity_does_not_preload_the_axis():
    deflection, q, direction, lever = backlash_case()
    np.testing.assert_allclose(deflection(q, np.zeros(3), np.zeros(3), 0.004)[0], 0.0, atol=1e-15)
    forth, back = (deflection(q, sign * 300 * direction, np.zeros(3), 0.004)[0] for sign in (1, -1))
    np.testing.assert_allclose(forth, -back, rtol=1e-6)


def test_hysteresis_holds_back_after_the_load_is_gone_until_it_is_reset():
    model = Model((Term(find_effect("joint_hysteresis"), {"h_1": Estimate(1e-7), "r": Estimate(0.01)}),))
    deflection = Deflection(model, ROBOT)
    q, direction = backlash_case()[1:3]
    deflection(q, 900 * direction, np.zeros(3), 0.004)
    left = np.linalg.norm(deflection(q, np.zeros(3), np.zeros(3), 0.004)[0])
    assert left > 1e-6
    deflection.reset()
    assert np.linalg.norm(deflection(q, np.zeros(3), np.zeros(3), 0.004)[0]) == 0.0


def test_creep_approaches_its_share_of_the_elastic_deflection():
    terms = model_of("joint_torsion").terms
    creep = Term(find_effect("creep"), {"share": Estimate(0.2), "T": Estimate(2.0), "memory": Estimate(1.0)})
    q, force = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3]), np.array([100.0, -50.0, -900.0])
    elastic = Deflection(Model(terms), ROBOT)(q, force, np.zeros(3), 0.1)[0]
    with_creep = Deflection(Model((*terms, creep)), ROBOT)
    for _ in range(20):
        u = with_creep(q, force, np.zeros(3), 0.1)[0]
    np.testing.assert_allclose(u, elastic * (1 + 0.2 * (1 - np.exp(-1.0))), rtol=1e-9)


def test_a_gear_that_creeps_more_than_the_others_goes_on_by_its_own_compliance():
    torsion = model_of("joint_torsion").terms
    same = {"share": Estimate(0.2), "T": Estimate(2.0), "memory": Estimate(1.0)}
    more = same | {"d_3": Estimate(4e-8), "apart": Estimate(1.0)}
    q, force = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3]), np.array([100.0, -50.0, -900.0])

    def after_two_seconds(*terms: Term) -> np.ndarray:
        deflection = Deflection(Model(terms), ROBOT)
        return [deflection(q, force, np.zeros(3), 0.1)[0] for _ in range(20)][-1]

    by_axis_3 = after_two_seconds(Term(find_effect("joint_torsion"), {"c_3": Estimate(4e-8)}))
    creeps = [after_two_seconds(*torsion, Term(find_effect("creep"), values)) for values in (same, more)]
    np.testing.assert_allclose(creeps[1] - creeps[0], by_axis_3 * (1 - np.exp(-1.0)), rtol=1e-9)


def test_deflection_is_evaluated_at_the_force_that_acts_not_at_the_one_that_is_read():
    terms = model_of("joint_torsion", "link_bending").terms
    turned = Term(find_effect("sensor_alignment"), {"w_z": Estimate(np.pi / 2)})
    q = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3])
    read, acts = np.array([200.0, 0.0, -900.0]), np.array([0.0, 200.0, -900.0])
    np.testing.assert_allclose(
        Deflection(Model((*terms, turned)), ROBOT)(q, read, np.zeros(3), 0.004)[0],
        Deflection(Model(terms), ROBOT)(q, acts, np.zeros(3), 0.004)[0],
        atol=1e-12,
    )


def test_effects_that_do_not_depend_on_the_force_are_left_out_with_a_reason():
    model = model_of("joint_torsion", "encoder_harmonics", "tracker_scale")
    assert set(Deflection(model, ROBOT).left_out) == {"encoder_harmonics", "tracker_scale"}


def test_an_effect_of_the_user_acts_through_its_own_displacement():
    formula = FormulaEffect("mine", "axis 3: c * tau * abs(tau)")
    terms = model_of("joint_torsion").terms
    mine = Term(formula, {p.name: Estimate(3e-11) for p in formula.parameters(production_scene(ROBOT, DOWN))})
    model = Model((*terms, mine))
    q, force = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3]), np.array([100.0, -50.0, -900.0])
    np.testing.assert_allclose(
        Deflection(model, ROBOT)(q, force, np.zeros(3), 0.004)[0], by_calibration(model, q, force, np.zeros(3)), atol=1e-12
    )


def test_rotation_by_an_effect_of_the_user_is_that_of_its_joint():
    model = Model((Term(FormulaEffect("mine", "axis 3: c * tau"), {"c": Estimate(1e-7)}),))
    q, force = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3]), np.array([100.0, -50.0, -900.0])
    as_torsion = Model((Term(find_effect("joint_torsion"), {"c_3": Estimate(1e-7)}),))
    for mine, theirs in zip(Deflection(model, ROBOT)(q, force, np.ones(3), 0.004),
                            Deflection(as_torsion, ROBOT)(q, force, np.ones(3), 0.004), strict=True):  # fmt: skip
        np.testing.assert_allclose(mine, theirs, atol=1e-12)


@pytest.mark.parametrize("formula", ["axis 3: c * sqrt(tau)", "axis 3: c * log(tau**2)"])
def test_a_formula_that_gives_no_number_now_says_so_and_which_it_is(formula):
    of_formula = Deflection(Model((Term(FormulaEffect("mine", formula), {"c": Estimate(1e-9)}),)), ROBOT)
    q, force = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3]), np.array([100.0, -50.0, -900.0])
    with pytest.raises(EffectError, match="formula 'axis 3: .*not a finite number"):
        for sign in (1.0, -1.0):
            of_formula(q, sign * force, np.zeros(3), 0.004)


@pytest.mark.parametrize(
    ("formula", "word"), [("axis 2: c * tau * dwell", "time"), ("axis 2: c * tau * temp_gear", "temperature")]
)
def test_a_formula_that_needs_what_production_does_not_have_is_refused_with_advice(formula, word):
    model = Model((Term(FormulaEffect("mine", formula), {"c": Estimate(1e-9)}),))
    with pytest.raises(ActivationError, match=f"mine.*{word}.*live"):
        Deflection(model, ROBOT)


@pytest.mark.parametrize("formula", ["axis 2: c * sin(q)", "base x: v * t", "tool z: k * temp_spindle"])
def test_a_formula_without_the_process_force_has_no_part_in_the_correction(formula):
    assert "mine" in Deflection(Model((Term(FormulaEffect("mine", formula)),)), ROBOT).left_out


def test_an_effect_of_the_user_that_needs_time_is_refused():
    class Late(Effect):
        id = label = physics = "late"
        needs = ("time",)

        def parameters(self, scene):
            return (Parameter("v", "m/(N s)", 1e-6),)

        def regressor(self, scene, theta):
            return (scene.force * scene.stamp[:, None])[:, :, None]

    with pytest.raises(ActivationError, match="late.*time"):
        Deflection(Model((Term(Late()),)), ROBOT)
