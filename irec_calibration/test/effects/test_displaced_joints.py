# SPDX-License-Identifier: Apache-2.0
"""Springs of an arm whose joints are not where the robot description has them."""

from __future__ import annotations

import re
from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.diagnose.held_out import validated
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.model import Estimate, Model, Term, blank_model, elastic_response, regressors, total_displacement
from irec_calibration.robot import Robot
from synthetic import COMPLIANCE, TRANSVERSE, session, urdf

ROBOT = Robot(urdf())
GEOMETRY = find_effect("geometry_error")
SPRINGS = ("joint_torsion", "link_bending")
DATA = session(6, seed=2)


def _without_sag(data):
    scene = scene_of(data)
    return replace(scene, view=replace(scene.view, sags=0.0))


SCENE = _without_sag(DATA)
NAMES = [p.name for p in GEOMETRY.parameters(SCENE)]


def _soft(scene) -> list[Term]:
    terms = blank_model(SPRINGS)
    rng = np.random.default_rng(3)
    return [
        Term(t.effect, {p.name: Estimate(p.scale * rng.uniform(0.5, 1.5)) for p in t.effect.parameters(scene)}) for t in terms
    ]


def _with(values: np.ndarray) -> Term:
    return Term(GEOMETRY, {n: Estimate(float(v)) for n, v in zip(NAMES, values, strict=True)})


def _urdf_with(joint: int, shift: tuple[float, float, float]) -> str:
    """The description with the origin of the joint after `joint` (from 1) moved in the frame that turns with `joint`."""
    text = urdf()
    origins = list(re.finditer(r'<joint name="[^"]*" type="revolute">.*?xyz="([^"]*)"', text, re.S))
    at = origins[joint]
    xyz = np.array([float(v) for v in at.group(1).split()]) + shift
    return text[: at.start(1)] + " ".join(f"{v:.9f}" for v in xyz) + text[at.end(1) :]


@given(q=st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6).map(np.array), joint=st.integers(1, 5))
@settings(max_examples=30, deadline=None)
def test_a_longer_link_gives_the_kinematics_of_a_description_with_that_link(q, joint):
    shift = (0.011, -0.007, 0.005)
    here, there = ROBOT.kinematics(q), Robot(_urdf_with(joint, shift)).kinematics(q)
    moved, p = here.changed(joint - 1, np.array(shift), np.zeros(3), here.p_tcp)
    for field in ("axis", "origin", "R_joint", "p_tcp", "R_tool"):
        np.testing.assert_allclose(getattr(moved, field), getattr(there, field), atol=1e-12)
    np.testing.assert_allclose(p, there.p_tcp, atol=1e-12)


@given(q=st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6).map(np.array), joint=st.integers(1, 6))
@settings(max_examples=30, deadline=None)
def test_a_zero_offset_gives_the_kinematics_of_that_angle(q, joint):
    zero = 0.02
    here, there = ROBOT.kinematics(q), ROBOT.kinematics(q + zero * np.eye(6)[joint - 1])
    axis = here.R_joint[0, joint - 1].T @ here.axis[0, joint - 1]
    moved, _ = here.changed(joint - 1, np.zeros(3), zero * axis, here.p_tcp)
    for field in ("axis", "origin", "R_joint", "p_tcp", "R_tool"):
        np.testing.assert_allclose(getattr(moved, field), getattr(there, field), atol=1e-12)


@given(seed=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_a_fit_sees_what_springs_do_on_the_displaced_arm(seed):
    """The bilinear form of a fit against springs asked on the arm as it stands; what is quadratic in the error is left."""
    values = np.random.default_rng(seed).normal(size=len(NAMES)) * 1e-3
    springs, error = _soft(SCENE), _with(values)
    rigid = GEOMETRY.displacement(SCENE, values)
    fitted = total_displacement([*springs, error], SCENE) - rigid
    plain = total_displacement(springs, SCENE)
    exact = total_displacement(springs, GEOMETRY.standing(SCENE, values))
    change = np.abs(exact - plain).max()
    assert change > 1e-7
    assert np.abs(fitted - exact).max() < 0.02 * change


def test_the_derivative_of_a_fit_is_that_of_what_it_predicts():
    values = np.random.default_rng(1).normal(size=len(NAMES)) * 3e-3
    terms = [*_soft(SCENE), _with(values)]
    blocks = regressors(terms, SCENE)
    for i, term in enumerate(terms):
        for j, name in enumerate(p.name for p in term.effect.parameters(SCENE)):
            h = 1e-3 * term.effect.parameters(SCENE)[j].scale
            sides = []
            for step in (h, -h):
                at = term.estimates[name].value + step
                other = replace(term, estimates={**term.estimates, name: Estimate(at)})
                sides.append(total_displacement([*terms[:i], other, *terms[i + 1 :]], SCENE))
            column = blocks[i][:, :, j]
            np.testing.assert_allclose(column, (sides[0] - sides[1]) / (2 * h), atol=1e-5 * np.abs(column).max())


@pytest.mark.parametrize("size", [0.0, 1e-2])
def test_a_prediction_is_of_the_arm_as_it_stands_without_what_the_error_does_on_the_way(size):
    values = np.full(len(NAMES), size)
    springs = _soft(SCENE)
    seen = scene_of(DATA, observe="tcp")
    expected = seen.change(total_displacement(springs, GEOMETRY.standing(seen, values)))
    np.testing.assert_allclose(Model((*springs, _with(values))).predict(seen), expected, rtol=1e-12)


def test_beside_a_wrong_link_predictions_are_of_the_arm_that_stands_there():
    values = np.zeros(len(NAMES))
    values[[NAMES.index(n) for n in ("x_2", "zero_5", "tilt_3a", "zero_6")]] = 0.012, 0.02, -0.01, 0.03
    axial = {f"c_{k + 1}": Estimate(float(c)) for k, c in enumerate(COMPLIANCE)}
    across = {f"c_{i // 2 + 1}{'ab'[i % 2]}": Estimate(float(c)) for i, c in enumerate(TRANSVERSE)}
    springs = [Term(find_effect("joint_torsion"), axial), Term(find_effect("link_bending"), across)]

    def displaced(scene):
        standing = total_displacement(springs, GEOMETRY.standing(scene, values)) - total_displacement(springs, scene)
        return standing + GEOMETRY.displacement(scene, values)

    data = session(31, seed=4, extra=displaced, sags=0.0, approach=4e-3)
    truth = scene_of(data, observe="tcp")
    expected = truth.change(total_displacement(springs, GEOMETRY.standing(truth, values)))

    def error(*effects: str) -> float:
        found = validated(data, blank_model(effects)).study.fit.terms
        return float(np.sqrt(np.mean((Model(found).predict(truth) - expected) ** 2)))

    assert error(*SPRINGS, "geometry_error") < 0.5 * error(*SPRINGS)


def test_a_response_that_nobody_asks_by_geometry_has_none():
    assert elastic_response(_soft(SCENE), SCENE).by_geometry is None


def test_differences_are_not_asked_where_the_last_axis_is_and_how_it_is_tilted():
    """Another place of the marker, and an error of the force sensor, do the same; its zero is asked as that of others."""
    own = {p.name: p.prior_width for p in GEOMETRY.parameters(SCENE)}
    rarely = {n for n, width in own.items() if width < 0.1 * own["x_5"]}
    assert rarely == {"x_6", "y_6", "z_6", "tilt_6a", "tilt_6b"}
    assert all(p.prior_width == np.inf for p in GEOMETRY.parameters(scene_of(absolute_sessions.session(poses=4))))
