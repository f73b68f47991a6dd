# SPDX-License-Identifier: Apache-2.0
"""The protocol that every effect of the catalogue keeps, and formulas written out independently for some."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.effects import CATALOGUE, Cause, absent, find_effect, known_effects
from irec_calibration.effects.counterbalance import harmonics
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.tool_weight import ToolWeight
from irec_calibration.errors import EffectError
from irec_calibration.identification.identify import identify
from irec_calibration.model import (
    EIGHTEEN_DOF,
    Estimate,
    Model,
    Term,
    blank_model,
    elastic_response,
    prepared,
    regressors,
    total_displacement,
)
from scipy.spatial.transform import Rotation
from synthetic import session

# those that register are for absolute sessions; robots with a passive joint: test_linkage.py
IDS = [cls.id for cls in CATALOGUE if not cls.registers and cls.completes != "joint_torsion"]


@pytest.fixture(scope="module")
def scene():
    data = session(6, seed=2)
    rail = {"rail": np.linspace(-1.0, 1.0, len(data))}
    warm = {"ambient": 20.0 + 0.01 * data.stamp}
    terms = [Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(1e-6) for k in range(1, 7)})]
    plain = scene_of(data)
    base = replace(plain, ext=rail, temperature=warm, instruments=replace(plain.instruments, by_contact=True))  # for the disc
    return replace(base, elastic=elastic_response(terms, base))


def _theta(effect, scene):
    """Values within the bounds where every parameter acts."""
    sign = {p.name: 1.0 if p.upper > 0.0 else -1.0 for p in effect.parameters(scene)}
    return np.array([
        np.clip(p.start if p.grid else 0.7 * sign[p.name] * p.scale, p.lower, p.upper) for p in effect.parameters(scene)
    ])  # fmt: skip


FOLLOWS_SPRINGS = [cls.id for cls in CATALOGUE if cls.needs_elastic]


@pytest.mark.parametrize("effect_id", FOLLOWS_SPRINGS)
def test_what_follows_the_springs_is_part_of_the_derivative_by_their_parameters(effect_id, scene):
    scene = replace(scene, view=replace(scene.view, sags=False))  # no compliance is read off the weight of the arm
    springs = ("joint_torsion", "link_bending", "tool_compliance")
    terms = []
    for effect in map(find_effect, (*springs, effect_id)):
        own = zip(effect.parameters(scene), _theta(effect, scene), strict=True)
        terms.append(Term(effect, {p.name: Estimate(v) for p, v in own}))
    blocks = regressors(terms, scene)
    for k in range(len(springs)):
        for j, p in enumerate(terms[k].effect.parameters(scene)):
            sides = []
            for step in (1e-3 * p.scale, -1e-3 * p.scale):
                at = terms[k].estimates | {p.name: Estimate(terms[k].estimates[p.name].value + step)}
                moved = [*terms[:k], replace(terms[k], estimates=at), *terms[k + 1 :]]
                sides.append(scene.change(total_displacement(moved, scene)))
            slope = (sides[0] - sides[1]) / (2e-3 * p.scale)
            assert np.abs(scene.change(blocks[k][:, :, j]) - slope).max() <= 1e-3 * np.abs(slope).max(), (springs[k], p.name)


@pytest.mark.parametrize("effect_id", IDS)
def test_the_regressor_is_the_derivative_of_the_displacement(effect_id, scene):
    effect = find_effect(effect_id)
    if effect.acts_on == "wrench":
        pytest.skip("acts through the model: tested with the model")
    parameters, theta = effect.parameters(scene), _theta(effect, scene)
    block = effect.regressor(scene, theta)
    assert block.shape == (len(scene), 3, len(parameters))
    for i, p in enumerate(parameters):
        if p.name in ("t_shift", "memory", "spread", "slow", "uneven", "held", "gradual"):
            # a step in time and switches have no derivative
            continue
        h = np.eye(len(theta))[i] * 1e-3 * ((theta[i] if p.grid else 0.0) or p.scale)
        slope = (effect.displacement(scene, theta + h) - effect.displacement(scene, theta - h)) / (2 * h[i])
        np.testing.assert_allclose(block[:, :, i], slope, rtol=2e-3, atol=1e-4 * np.abs(block[:, :, i]).max() + 1e-15)


@pytest.mark.parametrize("effect_id", IDS)
def test_an_effect_with_its_linear_parameters_at_zero_moves_nothing(effect_id, scene):
    effect = find_effect(effect_id)
    theta = np.array([p.start if p.grid else 0.0 for p in effect.parameters(scene)])
    if effect.acts_on == "wrench":
        np.testing.assert_array_equal(effect.wrench(scene, theta)[0], scene.force_in_tool)
    else:
        assert not effect.displacement(scene, theta).any()


@pytest.mark.parametrize("effect_id", IDS)
def test_parameters_have_unique_names_units_and_finite_scales(effect_id, scene):
    parameters = find_effect(effect_id).parameters(scene)
    assert len({p.name for p in parameters}) == len(parameters) > 0
    assert all(p.unit and np.isfinite(p.scale) and p.scale > 0.0 for p in parameters)
    assert all(p.lower <= p.start <= p.upper for p in parameters)


@pytest.mark.parametrize("effect_id", [i for i in IDS if find_effect(i).elastic])
def test_springs_obey_reciprocity_at_the_tcp(effect_id, scene):
    """Maxwell-Betti: the compliance matrix at the TCP is symmetric (wrist coupling for equal c_kl and c_lk only)."""
    effect = find_effect(effect_id)
    at_tcp = scene.seen_at(scene.p_tcp)
    values = {p.name: Estimate(p.scale if p.name[0] != "c" or "_" not in p.name or effect_id != "joint_coupling" else 1e-7)
              for p in effect.parameters(scene)}  # fmt: skip
    C = elastic_response([Term(effect, values)], at_tcp).compliance[:, :, :3]
    C_in_base = np.einsum("nij,nkj->nik", C, scene.kin.R_tool)
    np.testing.assert_allclose(C_in_base, np.swapaxes(C_in_base, 1, 2), atol=1e-9 * np.abs(C_in_base).max())


def test_a_tilted_sensor_rotates_the_force_before_the_arm_answers():
    angle = 0.05
    truth = session(25, seed=4, noise=None)
    f = truth.force_in_tool.copy()
    # the sensor reads the force turned back by the angle about z
    f[:, 0], f[:, 1] = np.cos(angle) * f[:, 0] + np.sin(angle) * f[:, 1], -np.sin(angle) * f[:, 0] + np.cos(angle) * f[:, 1]
    fit = identify(replace(truth, force_in_tool=f), blank_model([*EIGHTEEN_DOF, "sensor_alignment"]))
    found = fit.terms[-1].estimates["w_z"]
    assert abs(found.value - angle) < 4.0 * found.se and found.se < 0.02


def test_the_turn_of_a_station_is_found_with_its_sign():
    turn = np.array([0.004, -0.006, 0.003])
    truth = session(25, seed=6)
    station = truth.stations[0]
    stated = _with_rotation(station, Rotation.from_rotvec(-turn).as_matrix() @ station.R_in_base)
    fit = identify(replace(truth, stations=(stated,)), blank_model([*EIGHTEEN_DOF, "station_registration"]))
    for value, name in zip(turn, "xyz", strict=True):
        e = fit.terms[-1].estimates[f"w_{name}_A"]
        assert abs(e.value - value) < max(4.0 * e.se, 2e-4), name


def _with_rotation(station, R):
    return replace(station, quat_xyzw=tuple(Rotation.from_matrix(R).as_quat()))


def test_backlash_moves_the_joint_by_the_whole_gap_when_its_torque_changes_sign():
    gap = 2e-4
    data = session(31, seed=8, extra=lambda s: s.J[:, :, 0] * (0.5 * gap * np.sign(s.tau[:, 0]))[:, None])
    fit = identify(data, blank_model([*EIGHTEEN_DOF, "joint_backlash"]))
    found = fit.terms[-1].estimates["b_1"]
    # the catalogue softens the jump near zero torque, the truth does not: 10 %
    assert abs(found.value - gap) < 0.1 * gap and found.se < 0.2 * gap


def test_a_constant_tool_weight_cancels_in_the_difference_but_shows_at_the_reference(scene):
    excess = ToolWeight().reading(scene, np.array([3.0]))
    np.testing.assert_allclose(np.linalg.norm(excess, axis=1), 3.0 * 9.81)


def test_what_only_instruments_see_is_not_caused_by_the_load():
    for effect in known_effects().values():
        assert (effect.acts_on == "instrument") == (effect.cause is Cause.MEASUREMENT)


@pytest.mark.parametrize("effect_id", ["sensor_gain", "sensor_alignment", "tool_weight"])
def test_a_prediction_is_evaluated_at_the_force_that_really_acts(effect_id):
    scene = scene_of(session(5), observe="tcp")
    springs = [Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(1e-6) for k in range(1, 7)})]
    sensor = find_effect(effect_id)
    values = {p.name: Estimate(p.scale) for p in sensor.parameters(scene)}
    acts = scene.with_wrench(*sensor.wrench(scene, np.array([e.value for e in values.values()])))
    expected = Model(tuple(springs)).predict(acts)
    np.testing.assert_allclose(Model((*springs, Term(sensor, values))).predict(scene), expected, atol=1e-15)
    assert np.abs(expected - Model(tuple(springs)).predict(scene)).max() > 1e-8


def test_a_prediction_has_the_elastic_response_to_an_external_force_and_nothing_that_passes_with_time():
    scene = replace(scene_of(session(5), observe="tcp"), temperature={"gear_2": np.linspace(20.0, 30.0, 30)})
    springs = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(1e-6) for k in range(1, 7)})
    hose = Term(find_effect("external_force"), {"f_z": Estimate(-100.0)})
    drift = Term(find_effect("thermal_drift"), {"v_x": Estimate(1e-6), "k_gear_2_y": Estimate(1e-5)})
    settling = Term(find_effect("joint_settling"), {"a_1": Estimate(0.5)})
    with_hose = Model((springs, hose)).predict(scene)
    assert np.linalg.norm(with_hose - Model((springs,)).predict(scene), axis=1)[scene.load_case > 0].min() > 1e-5
    np.testing.assert_array_equal(Model((springs, hose, drift, settling)).predict(scene), with_hose)


@pytest.mark.parametrize(("effect_id", "values"), [("geometry_error", {"zero_2": 1e-3}), ("encoder_harmonics", {"a1_2": 1e-3})])
def test_a_prediction_has_nothing_of_what_wrong_joint_angles_make_of_the_commanded_displacement(effect_id, values):
    scene = scene_of(session(5), observe="tcp")
    term = Term(find_effect(effect_id), {n: Estimate(v) for n, v in values.items()})
    assert np.abs(scene.change(total_displacement([term], scene))).max() > 1e-8
    np.testing.assert_array_equal(Model((term,)).predict(scene), 0.0)


def test_marker_offset_turns_with_the_elastic_rotation(scene):
    effect = find_effect("marker_offset")
    d = np.array([0.01, -0.02, 0.03])
    lever = np.einsum("nij,j->ni", scene.kin.R_tool, d)
    np.testing.assert_allclose(effect.displacement(scene, d), lever + np.cross(scene.elastic.rotation, lever), atol=1e-15)


def test_an_effect_that_needs_temperatures_says_so_when_there_are_none():
    data = scene_of(session(3))
    assert absent(data, ("temperature",)) == "no temperature was logged"
    assert absent(data, ("ext",)) == "no external axis was logged"
    assert absent(replace(data, rows=replace(data.rows, clock="none")), ("time",)) == "the session has no usable time stamps"


def test_an_unknown_effect_is_refused_with_the_names_that_exist():
    with pytest.raises(EffectError, match="'gremlins' is not known; there are joint_torsion"):
        find_effect("gremlins")


def test_wrench_effects_change_the_scene_that_springs_answer_to(scene):
    terms = [Term(find_effect("sensor_gain"), {"e_xx": Estimate(0.1)})]
    np.testing.assert_allclose(prepared(terms, scene).force_in_tool[:, 0], 1.1 * scene.force_in_tool[:, 0])


def test_springs_carry_what_creeps_of_them_along() -> None:
    """The derivative by a spring's compliance holds what creeps of its deflection: a joint fit converges with it only."""
    scene = scene_of(session(3, seed=1))
    scene = replace(scene, view=replace(scene.view, sags=False))
    values = {"share": 0.4, "T": 8.0, "memory": 1.0, "spread": 1.0}
    creep = Term(find_effect("creep"), {n: Estimate(v) for n, v in values.items()})
    for remembers in (0.0, 1.0):
        crept = replace(creep, estimates=creep.estimates | {"memory": Estimate(remembers)})
        springs = {f"c_{k + 1}": 3e-7 for k in range(6)}

        def total(values: dict[str, float], crept: Term = crept) -> np.ndarray:
            torsion = Term(find_effect("joint_torsion"), {n: Estimate(v) for n, v in values.items()})
            return np.asarray(total_displacement((torsion, crept), scene))

        torsion = Term(find_effect("joint_torsion"), {n: Estimate(v) for n, v in springs.items()})
        column = regressors((torsion, crept), scene)[0][:, :, 2]
        by_difference = (total(springs | {"c_3": 3.3e-7}) - total(springs | {"c_3": 2.7e-7})) / 0.6e-7
        np.testing.assert_allclose(column, by_difference, atol=1e-6 * np.abs(column).max())


def test_a_balancer_takes_at_most_three_quarters_of_the_compliance_of_its_axis(scene):
    """At the angles that were measured; far from them nothing is known."""
    balancer = find_effect("counterbalance")
    sine = np.sin(scene.q[:, 1])
    least, most = sine.min(), sine.max()
    assert 0.0 < least < 0.9 * most, "no example: axis 2 hardly turns"
    # c - a s between the two angles: a quarter is left where c = a (4 most - least) / 3
    quarter = 4e-7 * (4.0 * most - least) / 3.0
    taken = {"a": (-4e-7, 1e-5)}
    assert balancer.why_impossible(taken, {"c_2": 1.01 * quarter}, scene) == ""
    assert "at most 75% of it" in balancer.why_impossible(taken, {"c_2": 0.99 * quarter}, scene)
    assert balancer.why_impossible(taken, {"c_2": 0.1 * quarter}, scene) != ""
    assert "no compliance of axis 2" in balancer.why_impossible(taken, {}, scene)


def test_coefficients_of_a_balancer_are_as_large_as_they_are_where_they_all_but_cancel(scene):
    """Over the angles of a session two of its waves differ by little but a constant."""
    balancer = find_effect("counterbalance")
    parameters = {p.name: p for p in balancer.parameters(scene)}
    waves = harmonics(scene.q[:, 1])[:, :2]
    around = waves.mean(axis=0)
    along = np.array([around[1], -around[0]]) / np.linalg.norm(around)  # of no mean: it cancels but for how the angle turns
    typical = parameters["a"].scale / 0.3
    theta = 10.0 * typical * along
    changes = float(np.ptp(waves @ theta))
    taken = {name: (float(v), 0.0) for name, v in zip(("a", "b"), theta, strict=True)}
    assert all(parameters[n].plausible_range[0] < v < parameters[n].plausible_range[1] for n, (v, _) in taken.items())
    assert balancer.why_impossible(taken, {"c_2": 2.0 * changes}, scene) == ""
    assert "a balancer takes at most" in balancer.why_impossible(taken, {"c_2": 0.55 * changes}, scene)


@pytest.mark.parametrize(
    ("values", "turned"),
    [
        ({"e_xy": (0.08, 1e-3), "e_yx": (-0.08, 1e-3)}, True),
        ({"e_xy": (0.088, 0.01), "e_yx": (-0.075, 0.003)}, True),  # not the same, but within their errors
        ({"e_xy": (0.088, 0.001), "e_yx": (-0.06, 0.001)}, False),
        ({"e_xy": (0.08, 1e-3), "e_yx": (0.08, 1e-3)}, False),
        ({"e_xy": (0.08, 1e-3), "e_yx": (-0.08, 1e-3), "e_xx": (0.03, 1e-3)}, False),
        ({"e_xy": (0.01, 0.05), "e_yx": (-0.02, 0.05)}, False),  # nothing is known of it
        ({}, False),
    ],
)
def test_crosstalk_that_only_turns_the_force_as_far_as_it_is_known_is_none(scene, values, turned):
    why = find_effect("sensor_gain").why_impossible(values, {}, scene)
    assert ("a turned sensor" in why) == turned


def test_a_model_from_before_the_second_harmonic_predicts_what_it_did(scene):
    by_angle = 2e-7 * np.sin(scene.q[:, 1]) + 1e-7 * np.cos(scene.q[:, 1])
    wanted = scene.J[:, :, 1] * (by_angle * scene.load_torque()[:, 1])[:, None]
    effect = find_effect("counterbalance")
    older = Term(effect, {"a": Estimate(2e-7), "b": Estimate(1e-7)})
    assert np.allclose(effect.displacement(scene, older.theta(effect.parameters(scene))), wanted, atol=1e-15)


def test_a_spring_beside_axis_2_acts_by_the_square_of_its_lever(scene):
    """A lever r sin(q - q_0) and a stiffness k take k r^2 sin^2(q - q_0) of the load: all four parameters and a constant."""
    effect = find_effect("counterbalance")
    q = scene.q[:, 1]
    own = scene.J[:, :, 1] * scene.load_torque()[:, None, 1]
    wanted = (own * np.sin(q - 0.4)[:, None] ** 2).ravel()
    theta = np.array([p.start for p in effect.parameters(scene)])
    A = np.concatenate([effect.regressor(scene, theta).reshape(len(wanted), -1), own.reshape(-1, 1)], axis=1)
    found = np.linalg.lstsq(A, wanted, rcond=None)[0]
    assert np.allclose(A @ found, wanted, atol=1e-12)
    assert np.allclose(found[:4], [0.0, 0.0, -0.5 * np.sin(0.8), -0.5 * np.cos(0.8)], atol=1e-6)


def test_a_crosstalk_that_only_turns_the_force_is_a_turned_sensor(scene):
    gain = find_effect("sensor_gain")
    assert "0.15 rad" in gain.why_impossible({"e_xy": (0.147, 0.01), "e_yx": (-0.153, 0.01)}, {}, scene)
    assert gain.why_impossible({"e_xy": (0.15, 0.01)}, {}, scene) == ""
    assert gain.why_impossible({"e_xy": (0.15, 0.01), "e_yx": (-0.1, 0.01)}, {}, scene) == ""
    assert gain.why_impossible({"e_xx": (0.02, 0.01)}, {}, scene) == ""


@pytest.mark.parametrize(
    ("e", "called"),
    [
        ({"e_xy": -0.08, "e_yx": 0.1}, "sensor_alignment"),  # alike within errors
        ({"e_xy": -0.02, "e_yx": 0.02}, ""),  # it may be none
        ({"e_xy": -0.1}, ""),  # one axis reads another, which does not read it
        ({"e_xx": 0.1, "e_xy": -0.1, "e_yx": 0.1}, ""),
    ],
)
def test_crosstalk_that_only_turns_the_force_may_as_well_be_a_turned_sensor(e, called) -> None:
    gain, scene = find_effect("sensor_gain"), scene_of(session(poses=2))
    names = [p.name for p in gain.parameters(scene)]
    theta = np.array([e.get(n, 0.0) for n in names])
    assert gain.also_called(scene, theta, np.where(theta != 0.0, 0.017, 0.0)) == called
