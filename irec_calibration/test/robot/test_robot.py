# SPDX-License-Identifier: Apache-2.0
"""Kinematics and gravity against independent references."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.errors import RobotError
from irec_calibration.robot import Payload, Robot
from synthetic import urdf

ROBOT = Robot(urdf())
ANGLES = st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6).map(np.array)


@given(ANGLES)
@settings(max_examples=30, deadline=None)
def test_the_jacobian_is_the_derivative_of_the_forward_kinematics(q):
    kin = ROBOT.kinematics(q)
    J = kin.jacobian(kin.p_tcp)[0]
    h = 1e-6
    for k in range(6):
        e = np.eye(6)[k] * h
        slope = (ROBOT.kinematics(q + e).p_tcp[0] - ROBOT.kinematics(q - e).p_tcp[0]) / (2 * h)
        np.testing.assert_allclose(J[:, k], slope, atol=1e-8)


@given(ANGLES)
@settings(max_examples=30, deadline=None)
def test_virtual_axes_are_unit_and_orthogonal_to_their_actuated_axis(q):
    kin = ROBOT.kinematics(q)
    frame = np.concatenate([kin.axis[:, :, None], kin.virtual_axis], axis=2)[0]
    np.testing.assert_allclose(np.einsum("kai,kbi->kab", frame, frame), np.tile(np.eye(3), (6, 1, 1)), atol=1e-12)


@given(ANGLES)
@settings(max_examples=30, deadline=None)
def test_gravity_torque_is_minus_the_holding_torque_of_the_drives(q):
    model = pin.buildModelFromXML(urdf())
    holding = pin.computeGeneralizedGravity(model, model.createData(), q)
    np.testing.assert_allclose(ROBOT.gravity_torque(q)[0], -holding, atol=1e-8 * np.abs(holding).max())


@given(ANGLES)
@settings(max_examples=10, deadline=None)
def test_a_description_without_masses_weighs_nothing_but_what_it_carries(q):
    """Of nothing there is no centre of mass: Pinocchio's is not a number."""
    bare, tool = Robot(re.sub("<inertial>.*?</inertial>", "", urdf())), Payload(50.0, (0, 0, 0.1))
    np.testing.assert_array_equal(bare.gravity_torque(q), np.zeros((1, 6)))
    added = ROBOT.gravity_torque(q, payload=tool) - ROBOT.gravity_torque(q)
    np.testing.assert_allclose(bare.gravity_torque(q, payload=tool), added, atol=1e-8)


def test_payload_adds_its_weight_to_every_axis_below():
    q = np.array([0.2, 0.5, 0.1, 0.3, 0.8, 0.0])
    added = (ROBOT.gravity_torque(q, payload=Payload(50.0, (0, 0, 0.1))) - ROBOT.gravity_torque(q))[0]
    kin = ROBOT.kinematics(q)
    p = kin.p_tcp + kin.R_tool[0] @ (0, 0, 0.1)
    np.testing.assert_allclose(added, kin.jacobian(p)[0].T @ (0, 0, -9.81 * 50.0), atol=1e-8)


def test_a_description_without_tool0_is_refused_by_name():
    with pytest.raises(RobotError, match="'tool0' is missing"):
        Robot(urdf().replace("tool0", "gripper"))


INERTIAL = '<inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


@pytest.mark.parametrize(("link", "mass", "tool"), [("tool0", 80.0, 80.0), ("tool0", 0.0, 0.0), ("flange", 10.0, 0.0)])
def test_the_mass_of_a_tool_is_that_of_what_is_fixed_beyond_the_last_link(link, mass, tool) -> None:
    """A flange is the robot's."""
    described = urdf().replace(f'<link name="{link}"/>', f'<link name="{link}">{INERTIAL.format(mass)}</link>')
    assert Robot(described).tool_mass == tool
