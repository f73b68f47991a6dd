# SPDX-License-Identifier: Apache-2.0
"""Absolute sessions: geometry, stations and markers of a robot with known errors are found, whatever its joints and
instruments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from absolute_sessions import SIX, Joint, points, session, torsion
from irec_calibration.diagnose import validated
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.identification.absolute import base_terms, near_pairs, thinned
from irec_calibration.identification.identify import default_terms, identify, with_registration
from irec_calibration.identification.observe import observe
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import Term, blank_model, total_displacement
from irec_calibration.session import Marker, Noise, Station

NOISE = Noise(tracker_m=1e-5)


def rms(residual: np.ndarray) -> float:
    return float(np.sqrt((residual**2).sum(axis=1).mean()))


def test_the_default_model_of_an_absolute_session_is_the_geometric_one():
    assert [t.effect.id for t in default_terms(session(poses=5))] == ["station_pose", "marker_position", "geometry_error"]


def test_geometry_station_and_marker_come_out_to_the_noise_from_nothing_stated():
    data = session(noise=NOISE)
    fit = identify(data, base_terms())
    floor = fit.observation.whiten.floor
    assert rms(fit.residual) < 1.05 * floor
    assert validated(data, base_terms()).held_out.rms_m < 1.25 * floor


def test_the_calibrated_robot_predicts_the_true_points_of_poses_it_never_saw():
    fit = identify(session(noise=NOISE), base_terms())
    fresh = session(poses=40, seed=7, stations=(Station("T", (1.0, 2.0, 0.3), (0, 0, 0.3, 0.95)),))
    seen = observe(fresh)
    terms = with_registration(fit.terms, seen)
    assert rms(seen.y - total_displacement(terms, seen.scene)[seen.rows]) < 2.5e-5
    assert rms(seen.y) > 1e-3


def test_exact_geometry_is_the_forward_kinematics_of_the_changed_robot():
    data = session(stated=True)
    scene = scene_of(data)
    effect = find_effect("geometry_error")
    theta = np.zeros(36)
    by_name = {p.name: i for i, p in enumerate(effect.parameters(scene))}
    # large on purpose: first order would be off by millimetres
    theta[by_name["zero_2"]], theta[by_name["x_3"]], theta[by_name["zero_5"]] = 0.05, 0.02, -0.04
    changed = [replace(j, shift=(0, 0, 0), tilt=(0, 0, 0), zero=0.0) for j in SIX]
    nominal = points(tuple(changed), data.q, data.markers[0].xyz)
    changed[1], changed[4] = replace(changed[1], zero=0.05), replace(changed[4], zero=-0.04)
    changed[2] = replace(changed[2], shift=(0.02, 0, 0))
    expected = points(tuple(changed), data.q, data.markers[0].xyz) - nominal
    np.testing.assert_allclose(effect.displacement(scene, theta), expected, atol=1e-12)


def test_the_regressor_of_exact_geometry_is_its_derivative():
    scene = scene_of(session(poses=6, stated=True))
    effect = find_effect("geometry_error")
    theta = np.random.default_rng(3).normal(size=36) * 0.02
    h = 1e-6
    for i in range(36):
        step = h * np.eye(36)[i]
        numeric = (effect.displacement(scene, theta + step) - effect.displacement(scene, theta - step)) / (2 * h)
        np.testing.assert_allclose(effect.regressor(scene, theta)[:, :, i], numeric, atol=1e-8)


def test_parameters_that_do_the_same_as_others_are_held_at_zero_and_named():
    fit = identify(session(noise=NOISE), base_terms())
    model = model_of(fit)
    held = model.made["held_at_zero"]
    assert "geometry_error.zero_1" in held  # the same as turning the station
    assert "geometry_error.zero_6" in held  # the same as moving the marker
    named = [e for t in fit.terms if t.effect.id == "geometry_error" for e in t.estimates.values()]
    assert len(named) + len(held) == 36 and all(e.se < 2e-3 for e in named)


def test_the_model_says_where_station_and_marker_stand():
    truth = session(noise=NOISE, joints=tuple(replace(j, shift=(0, 0, 0), tilt=(0, 0, 0), zero=0.0) for j in SIX))
    made = model_of(identify(truth, blank_model(["station_pose", "marker_position"]))).made
    np.testing.assert_allclose(made["stations_in_base_link"]["T"]["xyz"], (2.5, -1.0, 0.8), atol=2e-5)
    np.testing.assert_allclose(made["markers_in_tool0"]["M"], (0.03, -0.02, 0.1), atol=2e-5)


def test_of_a_known_station_the_place_alone_is_fitted_and_of_known_markers_nothing():
    fit = identify(session(noise=NOISE, stated=True), base_terms())
    station, geometry = fit.terms
    assert (station.effect.id, set(station.estimates)) == ("station_pose", {"x_T", "y_T", "z_T"})
    assert geometry.effect.id == "geometry_error"
    assert rms(fit.residual) < 1.05 * fit.observation.whiten.floor
    assert "zero_1" in geometry.estimates  # now it can be told


def test_where_the_first_axis_stands_beside_base_link_is_taken_for_the_place_of_a_known_station():
    beside = np.array([3e-4, -2e-4, 1e-4])
    fit = identify(session(noise=NOISE, stated=True, moved=lambda s, p: np.tile(beside, (len(p), 1))), base_terms())
    assert rms(fit.residual) < 1.05 * fit.observation.whiten.floor
    placed = model_of(fit).made["stations_in_base_link"]["T"]["xyz"]
    np.testing.assert_allclose(np.subtract(placed, (2.5, -1.0, 0.8))[:2], -beside[:2], atol=2e-5)


def test_a_turned_station_does_not_cost_geometric_parameters():
    turn = np.array([4e-4, -3e-4, 5e-4])
    known, turned = (
        session(poses=30, noise=NOISE, stated=True, moved=moved)
        for moved in (None, lambda s, p: np.cross(turn, p - np.array([2.5, -1.0, 0.8])))
    )
    names = [set(identify(s, base_terms()).terms[1].estimates) for s in (known, turned)]
    assert names[0] == names[1]


def test_two_stations_three_markers_one_on_the_base_and_rows_without_a_marker():
    stations = (Station("A", (2.5, -1.0, 0.8), (0.1, -0.2, 0.5, 0.83)), Station("B", (-1.5, 2.0, 0.4), (0, 0.7, 0.1, 0.7)))
    markers = (
        Marker("M1", "tool0", (0.03, -0.02, 0.1), known=False),
        Marker("M2", "tool0", (-0.1, 0.05, 0.0), known=False),
        Marker("B1", "base_link", (0.3, 0.2, 0.1), known=False),
    )
    data = session(noise=NOISE, stations=stations, markers=markers)
    seen = data.p_marker_in_station.copy()
    seen[::7] = np.nan
    fit = identify(replace(data, p_marker_in_station=seen), base_terms())
    assert len(fit.residual) == np.isfinite(seen[:, 0]).sum()
    assert rms(fit.residual) < 1.05 * fit.observation.whiten.floor


def test_a_prismatic_joint_is_calibrated_too():
    slide = Joint((0, 0, 0.2), (1, 0, 0), slides=True, tilt=(0, 2e-3, 1e-3))
    fit = identify(session((slide, *SIX[:5]), noise=NOISE), base_terms())
    assert rms(fit.residual) < 1.05 * fit.observation.whiten.floor


def test_a_coupled_passive_joint_follows_the_zero_of_its_drives_and_has_no_torsion_of_its_own():
    rng = np.random.default_rng(2)
    joints = (SIX[0], SIX[1], SIX[2], Joint((0.3, 0, 0), (0, 1, 0)), Joint((0.1, 0, 0), (0, 0, 1)))
    q = rng.uniform(-1.2, 1.2, (120, 5))
    q[:, 3] = -(q[:, 1] + q[:, 2])
    # the linkage keeps the wrist level whatever the zeros of its drives: joint 4 really turns by minus the true angles
    real = tuple(replace(j, zero=-(joints[1].zero + joints[2].zero)) if k == 3 else j for k, j in enumerate(joints))
    data = replace(session(real, q=q, noise=NOISE), passive={"joint_4": "-(joint_2 + joint_3)"})
    fit = identify(data, [*base_terms(), *blank_model(["joint_torsion"])])
    values = {n: e for t in fit.terms for n, e in t.estimates.items()}
    assert rms(fit.residual) < 1.05 * fit.observation.whiten.floor
    assert "c_4" not in values and "c_2" in values
    assert not any(p.name.endswith("_4") for p in find_effect("joint_backlash").parameters(fit.observation.scene))


def test_gravity_comes_from_a_level_station_where_the_robot_hangs_tilted():
    tilt = (np.sin(0.3), 0.0, 0.0, np.cos(0.3))  # 0.6 rad about x
    data = session(stations=(Station("L", (2.0, 0.0, 0.5), tilt, level=True),))
    up = Station("L", quat_xyzw=tilt).R_in_base[:, 2]
    np.testing.assert_allclose(scene_of(data).gravity_in_base, -9.81 * up, atol=0.05)


def test_compliance_under_gravity_is_recovered_beside_the_geometry():
    c = np.array([0.0, 4e-6, 6e-6, 0.0, 2e-5, 0.0])
    fit = identify(session(noise=NOISE, moved=torsion(c), poses=200), [*base_terms(), *blank_model(["joint_torsion"])])
    found = next(t for t in fit.terms if t.effect.id == "joint_torsion").estimates
    for k in (2, 3):
        assert abs(found[f"c_{k}"].value - c[k - 1]) < 5 * found[f"c_{k}"].se + 2e-8
        assert found[f"c_{k}"].identified
    assert not found["c_1"].identified  # gravity exerts no torque about a vertical axis


def test_guessed_link_masses_make_the_model_say_what_a_compliance_is_worth():
    data = session(noise=NOISE, moved=torsion(np.full(6, 4e-6)))
    terms = [*base_terms(), *blank_model(["joint_torsion"])]
    assert "product" in model_of(identify(replace(data, inertials="guess"), terms)).made["caution"]
    assert "caution" not in model_of(identify(replace(data, inertials="manufacturer"), terms)).made


def test_a_few_gross_outliers_are_left_out_and_named():
    data = session(noise=NOISE)
    seen = data.p_marker_in_station.copy()
    seen[[3, 50]] += (0.02, -0.01, 0.03)
    fit = identify(replace(data, p_marker_in_station=seen), base_terms())
    assert rms(fit.residual) < 1.05 * fit.observation.whiten.floor
    assert {int(data.pose[r]) for b in fit.observation.bad for r in b.rows} == {4, 51}
    assert all(any(n.startswith(f"pose {p}: moved by 37") for n in fit.observation.session.notes) for p in (4, 51))


def test_a_residual_that_repeats_with_the_pose_is_said():
    rng = np.random.default_rng(4)
    q = np.concatenate([rng.uniform(-1.3, 1.3, (150, 6))] * 2) + rng.normal(size=(300, 6)) * 1e-3

    def wave(s, p):
        return 3e-4 * np.sin(9.0 * s.q[:, :3])

    for moved, expected in ((wave, True), (None, False)):
        fit = identify(session(q=q, noise=NOISE, moved=moved), base_terms())
        assert near_pairs(fit.observation, fit.residual).repeats is expected
        assert any("repeats with the pose" in n for n in fit.observation.session.notes) is expected


def test_thinning_keeps_the_steps_of_the_poses_that_stay():
    data = session(poses=90)
    whole = observe(data)
    few = thinned(whole, 30)
    assert len(few.poses) == 30 and len(few.scene) == 30
    assert len(thinned(whole, 60, rows=45).rows) == 45
    position = {int(p): i for i, p in enumerate(whole.pose)}
    for i, pose in enumerate(few.pose):
        np.testing.assert_array_equal(few.scene.step[i], whole.scene.step[position[int(pose)]])
    fit = identify(data, base_terms())
    assert rms(fit.residual) < 1e-5


def test_poses_that_were_measured_twice_are_kept_where_a_long_session_is_thinned():
    data = session(poses=120)
    q = data.q.copy()
    q[100:] = q[:20]
    few = thinned(observe(replace(data, q=q, p_tcp_in_base=data.robot.kinematics(q).p_tcp)), 80)
    assert len(few.poses) == 80
    assert len(near_pairs(few, few.y).first) >= 10


@pytest.mark.parametrize("effect", ["joint_settling", "joint_hysteresis", "thermal_drift"])
def test_history_is_not_offered_where_the_order_is_unknown(effect):
    from irec_calibration.effects import absent

    scene = scene_of(replace(session(poses=5), clock="none"))
    assert absent(scene, find_effect(effect).needs)


def test_a_tracker_scale_can_not_shrink_the_residual_by_shrinking_robot_and_measurement():
    data = session(noise=NOISE, moved=lambda s, p: np.random.default_rng(1).normal(size=p.shape) * 1e-4)
    plain = identify(data, base_terms())
    scaled = identify(data, [*base_terms(), Term(find_effect("tracker_scale"))])
    assert rms(scaled.residual) > 0.97 * rms(plain.residual)


def test_a_model_of_a_session_with_one_reflector_places_a_second_one_of_another_session_too():
    one, two = Marker("M", "tool0", (0.03, -0.02, 0.1), known=False), Marker("N", "tool0", (-0.05, 0.02, 0.1), known=False)
    model = model_of(identify(session(noise=NOISE, markers=(one,)), base_terms()))
    fit = identify(session(noise=NOISE, seed=3, markers=(one, two)), model.terms)
    assert rms(fit.residual) < 1.1 * fit.observation.whiten.floor
