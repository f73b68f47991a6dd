# SPDX-License-Identifier: Apache-2.0
"""Typical magnitudes come from the robot, not from absolute constants."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.travel import added_in_turn, clipped_in_turn
from irec_calibration.errors import ModelError
from irec_calibration.model import Estimate, Model, Term
from irec_calibration.robot import Robot
from irec_calibration.robot.ratings import WITHOUT_MASSES, rated_torque
from synthetic import EFFORT, session, urdf

NO_EFFORT = re.sub(r'effort="\d+"', 'effort="0"', urdf())
NO_MASSES = re.sub(r"<inertial>.*?</inertial>", "", NO_EFFORT)


def test_the_rated_torque_is_that_of_the_description_where_it_gives_one():
    np.testing.assert_array_equal(rated_torque(Robot(urdf())), EFFORT)


def test_an_effort_of_zero_means_unknown_and_gravity_says_what_the_drives_must_carry():
    guessed = rated_torque(Robot(NO_EFFORT))
    assert np.all(guessed > 0.0) and np.all(guessed[:3] > 2.0 * np.asarray(EFFORT[:3]) / 10) and guessed[1] > 10.0 * guessed[5]
    light = Robot(re.sub(r'mass value="([\d.]+)"', lambda m: f'mass value="{float(m[1]) / 100}"', NO_EFFORT))
    np.testing.assert_allclose(rated_torque(light), guessed / 100, rtol=1e-9)


def test_no_drive_is_guessed_weaker_than_wrists_are_however_little_gravity_asks_of_it():
    guessed = rated_torque(Robot(NO_EFFORT))
    np.testing.assert_allclose(guessed.min(), 0.05 * guessed.max())
    assert np.min(EFFORT) > 0.05 * np.max(EFFORT)


def test_one_effort_for_all_drives_was_filled_in_and_says_nothing():
    guessed = rated_torque(Robot(NO_EFFORT))
    np.testing.assert_array_equal(rated_torque(Robot(re.sub(r'effort="\d+"', 'effort="10000"', urdf()))), guessed)


def test_one_known_effort_is_kept_beside_unknown_ones():
    mixed = Robot(urdf().replace('effort="1492"', 'effort="0"'))
    assert rated_torque(mixed)[4] not in (0.0, 1000.0) and rated_torque(mixed)[3] == EFFORT[3]


def test_without_efforts_and_masses_nothing_is_known():
    np.testing.assert_array_equal(rated_torque(Robot(NO_MASSES)), np.full(6, WITHOUT_MASSES))


def test_play_may_be_taken_up_over_a_range_of_torque():
    scene = scene_of(session(4, seed=1))
    backlash = find_effect("joint_backlash")
    at_once, slowly = (backlash.displacement(scene, np.array([2e-4] * 6 + [0.0] * 6 + [w, 0.0, 0.0])) for w in (1e-3, 0.05))
    size_at_once, size_slowly = (np.linalg.norm(u, axis=1) for u in (at_once, slowly))
    assert np.all(size_slowly.max() < size_at_once.max()) and np.abs(at_once - slowly).max() > 1e-5


def test_play_that_is_crossed_beside_zero_has_a_part_that_is_the_same_for_both_directions():
    scene = scene_of(session(4, seed=1))
    backlash = find_effect("joint_backlash")
    beside = np.array([0.0] * 6 + [2e-4] * 6 + [0.01])
    one, other = (backlash.displacement(s, np.append(beside, [1.0, 0.0])) for s in (scene, _turned_over(scene)))
    np.testing.assert_allclose(one, other, atol=1e-12)
    assert np.abs(one).max() > 1e-5 and not backlash.displacement(scene, np.append(beside, [0.0, 0.0])).any()


def _turned_over(scene):
    """The same poses, all torques the other way."""
    gravity = replace(scene.gravity, tau=-scene.gravity.tau)
    return replace(scene, gravity=gravity).with_wrench(-scene.force_in_tool, -scene.torque_in_tool)


def _hysteresis(scene, **values):
    """Displacement by sliders of each kind at every axis, and values of the shape."""
    hysteresis = find_effect("joint_hysteresis")
    stated = {f"{n}_{k}": v for n, v in values.items() if n in ("h", "early", "late") for k in range(1, 7)} | values
    theta = np.array([stated.get(p.name, p.start) for p in hysteresis.parameters(scene)])
    return hysteresis.displacement(scene, theta)


def test_sliders_of_an_axis_give_way_one_after_the_other():
    scene = scene_of(session(4, seed=1))
    load = np.linspace(0.0, 1.0, len(scene))[:, None] * [0.0, 0.0, -1100.0]
    ramp = scene.with_wrench(load, np.zeros_like(load))
    early, h, late = (_hysteresis(ramp, r=0.03, **{n: 1e-7}) for n in ("early", "h", "late"))
    size = [np.linalg.norm(u, axis=1).max() for u in (early, h, late)]
    assert size[0] < size[1] < size[2]
    together = _hysteresis(ramp, r=0.03, h=1e-7 / 3, early=1e-7 / 3, late=1e-7 / 3)
    np.testing.assert_allclose(together, _hysteresis(ramp, r=0.03, spread=1.0, h=1e-7), atol=1e-12)  # a model of before


def test_motion_of_a_joint_frees_what_its_friction_holds():
    scene = scene_of(session(1, seed=1))

    def stepping(by):
        return scene.at(replace(scene.arm, step=np.full_like(scene.step, by)), scene.p_observed, scene.tau_gravity)

    moving, standing = stepping(0.01), stepping(0.0)
    held, freed = (_hysteresis(moving, r=0.03, h=1e-7, freed=f) for f in (0.0, 100.0))
    assert np.abs(held - freed).max() > 1e-7
    held, freed = (_hysteresis(standing, r=0.03, h=1e-7, freed=f) for f in (0.0, 100.0))
    np.testing.assert_allclose(held, freed, atol=1e-15)


def test_friction_at_a_reference_points_to_where_the_joint_came_from():
    scene = scene_of(session(4, seed=1))
    references = np.flatnonzero(scene.load_case == 0)
    loaded = scene.rows.under_load[:, None]
    scene = scene.with_wrench(scene.force_in_tool * loaded, scene.torque_in_tool * loaded)
    relaxed, held, turned = (_hysteresis(scene, r=0.03, h=1e-7, arrived=a, freed=1e4) for a in (0.0, 0.5, -0.5))
    np.testing.assert_allclose(relaxed[references], 0.0, atol=1e-12)
    np.testing.assert_allclose(held[references], -turned[references], atol=1e-12)
    np.testing.assert_array_equal(held[references[0]], np.zeros(3))  # nothing is known of what was before the session
    later = references[1:]
    turns = 0.5 * 1e-7 * 0.03 * rated_torque(scene.robot) * np.tanh((scene.q[later] - scene.q[later - 1]) / 0.01)
    np.testing.assert_allclose(held[later], np.einsum("nik,nk->ni", scene.J[later], turns), rtol=1e-6, atol=1e-12)


@given(n=st.integers(1, 40), seed=st.integers(0, 2**16))
def test_what_is_held_in_turn_is_that_of_one_row_after_the_other(n, seed):
    rng = np.random.default_rng(seed)
    a, b, u = rng.uniform(0.0, 1.0, (n, 2, 3)) ** 3, rng.normal(size=(n, 2, 3)), rng.normal(size=(n, 1, 3))
    r = rng.uniform(0.1, 1.0, (2, 3))
    last, expected = np.zeros((2, 3)), np.empty((n, 2, 3))
    for i in range(n):
        last = expected[i] = np.clip(a[i] * last + b[i], u[i] - r, u[i] + r)
    np.testing.assert_allclose(clipped_in_turn(a, b, u - r, u + r), expected, atol=1e-12)


@given(n=st.integers(1, 40), seed=st.integers(0, 2**16))
def test_what_adds_up_in_turn_is_that_of_one_row_after_the_other(n, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.0, 1.0, (n, 2, 3)) ** 3, rng.normal(size=(n, 2, 3))
    last, expected = np.zeros((2, 3)), np.empty((n, 2, 3))
    for i in range(n):
        last = expected[i] = a[i] * last + b[i]
    np.testing.assert_allclose(added_in_turn(a, b), expected, atol=1e-12)


def test_friction_that_gives_way_gradually_follows_dahl():
    scene = scene_of(session(40, seed=1))
    there = np.linspace(0.0, 2.0, len(scene))
    load = 1000.0 * np.minimum(there, 2.0 - there)[:, None] * [0.0, 0.0, 1.0]
    scene = scene.with_wrench(load, np.zeros_like(load))
    hysteresis = find_effect("joint_hysteresis")
    theta = np.array([{"h_2": 1e-7, "r": 0.03, "gradual": 1.0}.get(p.name, p.start) for p in hysteresis.parameters(scene)])
    r, tau = 0.03 * rated_torque(scene.robot)[1], (scene.tau_acting + scene.tau_gravity)[:, 1]
    held = np.zeros(len(tau))
    for i, d in enumerate(np.diff(tau), start=1):
        held[i] = r * np.sign(d) + (held[i - 1] - r * np.sign(d)) * np.exp(-abs(d) / r)
    expected = -1e-7 * held[:, None] * scene.J[:, :, 1]
    np.testing.assert_allclose(hysteresis.displacement(scene, theta), expected, atol=1e-12)


def test_each_way_to_a_reference_frees_friction_whatever_moves_under_the_load():
    scene = scene_of(session(4, seed=1))
    stepping = scene.at(replace(scene.arm, step=np.full_like(scene.step, 0.01)), scene.p_observed, scene.tau_gravity)
    anew, by_motion = (_hysteresis(stepping, r=0.03, h=1e-7, freed=f) for f in (1e4, 4e3))
    np.testing.assert_allclose(anew, _hysteresis(scene.at(replace(scene.arm, step=np.zeros_like(scene.step)), scene.p_observed,
                               scene.tau_gravity), r=0.03, h=1e-7, freed=1e4), atol=1e-15)  # fmt: skip
    assert np.abs(anew - by_motion).max() > 1e-7


def test_friction_that_motion_does_not_free_is_held_from_pose_to_pose():
    scene = scene_of(session(4, seed=1))
    later = np.flatnonzero(scene.load_case == 0)[1:]
    kept, freed = (_hysteresis(scene, r=0.03, h=1e-7, freed=f) for f in (0.0, 1e4))
    assert np.abs(freed[later]).max() < 1e-3 * np.abs(kept[later]).max()


def test_the_softest_place_of_a_rail_is_where_it_says():
    scene = scene_of(session(25, seed=1))
    along = np.repeat(np.linspace(-1.0, 2.0, 25), 6)
    scene = replace(scene, ext={"rail": along})
    rail = find_effect("rail_compliance")
    values = {"r_y_soft": 1e-8, "s_0": 0.7, "w": 0.3}
    theta = np.array([values.get(p.name, 0.0) for p in rail.parameters(scene)])
    size = np.linalg.norm(rail.displacement(scene, theta), axis=1)
    near, far = np.abs(along - 0.7) < 0.2, np.abs(along - 0.7) > 1.2
    assert size[near & (scene.load_case > 0)].min() > 1e3 * size[far].max()


@pytest.mark.parametrize("travel", [0.5, 2.0, 6.0])
def test_a_soft_place_of_a_rail_is_looked_for_no_narrower_than_a_carriage_is(travel: float) -> None:
    scene = scene_of(session(4, seed=1))
    scene = replace(scene, ext={"rail": np.linspace(0.0, travel, len(scene))})
    width = next(p for p in find_effect("rail_compliance").parameters(scene) if p.name == "w")
    assert width.lower == 0.3
    assert min(width.grid) >= 0.3


def test_a_rail_on_posts_is_softest_in_the_middle_between_any_two():
    scene = scene_of(session(25, seed=1))
    along = np.repeat(np.linspace(-1.0, 2.0, 25), 6)
    scene = replace(scene, ext={"rail": along})
    rail = find_effect("rail_compliance")
    values = {"r_y_soft": 1e-8, "s_0": 0.75, "w": 0.5, "posts": 1.0}
    theta = np.array([values.get(p.name, 0.0) for p in rail.parameters(scene)])
    size = np.linalg.norm(rail.displacement(scene, theta), axis=1)
    pressed = scene.load_case > 0
    for middle in (-0.75, 0.25, 0.75, 1.75):
        assert size[pressed & np.isclose(along, middle)].min() > 1e3 * size[pressed & np.isclose(along, middle + 0.25)].max()


def test_a_model_of_an_earlier_form_is_refused_instead_of_misread():
    with pytest.raises(ModelError, match="'t_x_s1' is of an earlier form.*identify the model again"):
        Term(find_effect("rail_compliance"), {"t_x_s1": Estimate(1e-8)})


def test_a_hose_fixed_at_a_point_pulls_towards_it():
    scene = scene_of(session(5, seed=1), observe="tcp")
    springs = Term(find_effect("tool_compliance"), {f"c_{a}": Estimate(1e-6) for a in "xyz"})
    point, k = np.array([1.0, 0.5, 3.0]), 30.0
    hose = {f"f_{a}": Estimate(float(k * x)) for a, x in zip("xyz", point, strict=True)} | {"k": Estimate(k)}
    both = Model((springs, Term(find_effect("external_force"), hose))).predict(scene)
    pulled = (both - Model((springs,)).predict(scene))[scene.load_case > 0]
    # an isotropic spring at the tool gives way along the pull, which acts under load only
    np.testing.assert_allclose(pulled, 1e-6 * k * (point - scene.p_tcp[scene.load_case > 0]), atol=1e-12)


def test_a_base_may_be_softest_about_any_horizontal_axis():
    scene = scene_of(session(5, seed=1), observe="tcp")
    between, along, across = 0.7, 4e-8, 1e-8
    turn = np.array([[np.cos(between), -np.sin(between), 0.0], [np.sin(between), np.cos(between), 0.0], [0.0, 0.0, 1.0]])
    soft = turn @ np.diag([along, across, 0.0]) @ turn.T
    base = {"r_x": Estimate(soft[0, 0]), "r_y": Estimate(soft[1, 1]), "r_xy": Estimate(soft[0, 1])}
    tilted = np.cross(np.cross(scene.p_tcp, scene.force) @ soft, scene.p_tcp)
    predicted = Model((Term(find_effect("base_compliance"), base),)).predict(scene)
    np.testing.assert_allclose(predicted, scene.change(tilted), atol=1e-12)


@pytest.mark.parametrize("about", [0, 1])
@pytest.mark.parametrize("place", [(0.0, 0.0, -0.8), (0.35, 0.0, 0.0), (0.0, -0.4, 0.0)])
def test_a_base_may_tilt_about_a_line_off_base_link(about: int, place: tuple[float, float, float]):
    scene = scene_of(session(5, seed=1), observe="tcp")
    soft, axis, P = 4e-8, np.eye(3)[about], np.array(place)
    moment = np.cross(scene.p_tcp - P, scene.force) @ axis
    tilted = soft * moment[:, None] * np.cross(axis, scene.p_tcp - P)
    moves = -np.cross(axis, P)  # base_link by each rad
    base = {f"r_{'xyz'[about]}": soft} | {f"t_{a}": soft * moves[i] ** 2 for i, a in enumerate("xyz")}
    base |= {f"tr_{t}{'xyz'[about]}": soft * moves["xyz".index(t)] for t in "xyz" if moves["xyz".index(t)]}
    predicted = Model((Term(find_effect("base_compliance"), {n: Estimate(float(v)) for n, v in base.items()}),)).predict(scene)
    np.testing.assert_allclose(predicted, scene.change(tilted), atol=1e-12)


@pytest.mark.parametrize("about", [0, 1])
@pytest.mark.parametrize("place", [(0.0, 0.0, -0.8), (0.35, 0.0, 0.0), (0.0, -0.4, 0.0), (0.2, 0.3, -0.5)])
def test_it_is_told_about_which_line_a_base_tilts(about: int, place: tuple[float, float, float]):
    soft, moves = 4e-8, -np.cross(np.eye(3)[about], place)  # base_link by each rad
    values = {f"r_{'xyz'[about]}": soft, f"r_{'yx'[about]}": 0.3 * soft}
    values |= {f"tr_{t}{'xyz'[about]}": soft * moves[i] for i, t in enumerate("xyz")}
    told = find_effect("base_compliance").where_to_look(values, ("rotation", "place of tilting"))
    across, height = re.search(r"about [xy], about a line near [xy] = (-?[\d.]+) m, z = (-?[\d.]+) m", told).groups()
    np.testing.assert_allclose((float(across), float(height)), (place[1 - about], place[2]), atol=1e-9)
    assert f"tilts most about {'xy'[about]}, about a line near {'yx'[about]} =" in told


def softest_likely(description: str) -> float:
    scene = scene_of(replace(session(5), robot=Robot(description)))
    (limit,) = (p.plausible[1] for p in find_effect("base_compliance").parameters(scene) if p.name == "r_x")
    return limit


def test_a_light_robot_may_stand_on_what_is_as_soft_as_it_is_light():
    light = re.sub(r'mass value="([\d.]+)"', lambda m: f'mass value="{float(m[1]) / 100}"', urdf())
    assert softest_likely(light) > 5.0 * softest_likely(urdf())
    assert softest_likely(NO_MASSES) == 2e-6


def test_a_law_that_came_to_the_border_between_play_and_a_soft_gear_may_be_either():
    scene = scene_of(session(poses=8))
    said = []
    for name, size, range_of in (("joint_backlash", "b_1", "w"), ("joint_stiffening", "a_1", "x_0")):
        effect = find_effect(name)
        for share in (0.02, 0.03, 0.045):
            values = {size: 1e-4, range_of: share}
            theta = np.array([values.get(p.name, p.start) for p in effect.parameters(scene)])
            said.append(effect.also_called(scene, theta, np.zeros_like(theta)))
    assert said == ["", "joint_stiffening", "", "joint_backlash", "joint_backlash", ""]


@pytest.mark.parametrize(
    ("effort", "soft", "called"),
    [
        ("0", 0.002, ("", "joint_backlash")),  # of the torque that the session shows: play, whatever the limit is
        ("0", 0.08, ("", "joint_backlash")),  # the limit may be three times that torque, of which this is less than 3 %
        ("0", 0.1, ("", "")),  # more than that: what the other explains in its place tells
        ("as stated", 0.1, ("", "")),
    ],
)
def test_a_soft_gear_of_no_width_is_play_where_no_torque_limit_is_stated(effort, soft, called):
    measured = session(poses=8)
    robot = measured.robot if effort == "as stated" else Robot(NO_EFFORT)
    scene = scene_of(replace(measured, robot=robot))
    largest = np.abs(scene.tau + scene.tau_gravity).max(axis=0)[0]
    said = []
    for name, size, range_of in (("joint_backlash", "b_1", "w"), ("joint_stiffening", "a_1", "x_0")):
        effect = find_effect(name)
        parameters = effect.parameters(scene)
        values = {size: 1e-4, range_of: soft * largest / rated_torque(robot)[0]}
        theta = np.array([values.get(p.name, p.start) for p in parameters])
        said.append(effect.also_called(scene, theta, np.zeros_like(theta)))
    assert tuple(said) == called
