# SPDX-License-Identifier: Apache-2.0
"""A scene is always consistent: what follows from its parts belongs to these parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.state import Arm, Load
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
    heavier = np.array([wrench[:, 2].mean() for wrench in (absolute.load_wrench_at_base()[0], scene.load_wrench_at_base()[0])])
    assert heavier[0] < heavier[1] - 5000.0
