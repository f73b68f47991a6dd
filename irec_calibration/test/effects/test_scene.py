# SPDX-License-Identifier: Apache-2.0
"""A scene is always consistent: what follows from its parts belongs to these parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.effects import find_effect
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.state import Arm, Load, View
from irec_calibration.model import Estimate, Term, total_displacement
from synthetic import session


@pytest.fixture
def scene():
    return scene_of(session(3, seed=5))


def test_the_jacobian_follows_the_observed_point(scene):
    before = scene.J.copy(), scene.V.copy()
    moved = scene.seen_at(scene.p_observed + [0.0, 0.0, 0.5])
    np.testing.assert_allclose(moved.J, scene.kin.jacobian(moved.p_observed))
    assert np.abs(moved.J - before[0]).max() > 0.1 and np.abs(moved.V - before[1]).max() > 0.1


def test_torques_follow_the_wrench_and_the_arm(scene):
    assert np.abs(scene.tau).max() > 0.0
    np.testing.assert_allclose(scene.with_wrench(2 * scene.force_in_tool, 2 * scene.torque_in_tool).tau, 2 * scene.tau)
    q = scene.q + 0.3
    kin = scene.robot.kinematics(q)
    elsewhere = scene.at(replace(scene.arm, q=q, kin=kin, p_tcp=kin.p_tcp), kin.p_tcp, scene.tau_gravity)
    np.testing.assert_allclose(elsewhere.tau, np.einsum("nik,ni->nk", kin.jacobian(kin.p_tcp), elsewhere.force))


def test_a_scene_of_parts_that_belong_to_different_states_of_the_arm_is_refused(scene):
    other = Arm(**{**vars(scene.arm), "q": scene.q + 0.1})
    with pytest.raises(ValueError, match="same Arm"):
        replace(scene, load=Load(other, scene.force_in_tool, scene.torque_in_tool))


def test_what_is_derived_can_not_be_written_over(scene):
    for derived in (scene.J, scene.V, scene.tau, scene.force, scene.gravity.tau_virtual):
        with pytest.raises(ValueError, match="read-only"):
            derived[:] = 0.0


def test_gravity_is_load_in_an_absolute_session_and_cancels_in_a_loaded_one(scene):
    absolute = replace(scene, rows=replace(scene.rows, kind="absolute"))
    np.testing.assert_array_equal(scene.load_torque(), scene.tau)
    np.testing.assert_array_equal(absolute.load_torque(), scene.tau + scene.tau_gravity)
    np.testing.assert_array_equal(scene.preload(), scene.tau_gravity)
    assert not absolute.preload().any()
    base = find_effect("base_compliance")
    theta = np.array([1e-9 if p.name == "t_z" else 0.0 for p in base.parameters(scene)])
    lower = [base.displacement(s, theta)[:, 2].mean() for s in (absolute, scene)]
    assert lower[0] < lower[1] - 5e-6


def test_what_the_arm_sags_from_the_reference_to_the_contact_is_seen_by_who_measures_and_caused_by_no_process(scene):
    terms = [Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(1e-6) for k in range(1, 7)})]
    in_process = replace(scene, view=View(scene.arm, scene.p_observed, scene.moves_with_arm))
    sagged = total_displacement(terms, scene) - total_displacement(terms, in_process)
    by_weight = np.einsum("nik,nk->ni", scene.J, 1e-6 * scene.tau_gravity)
    np.testing.assert_allclose(sagged, scene.change(by_weight), atol=1e-12)
    assert np.abs(sagged).max() > 1e-6 and np.abs(sagged[scene.load_case == 0]).max() < 1e-15
