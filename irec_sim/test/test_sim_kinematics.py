# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_sim.cellfile import read_cell
from irec_sim.errors import SimError
from irec_sim.kinematics import (
    forward,
    inverse,
    quaternion_of_rotation,
    read_urdf,
    rotation_of_quaternion,
    rotation_of_vector,
    rotation_vector,
)

ROBOTS = Path(__file__).parents[2] / "config" / "robots"
CHAIN = read_urdf(ROBOTS / "kr120_r2700_extra_ha.urdf")
vectors = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)


def test_upright_and_forearm_forwards_is_where_the_data_sheet_puts_it():
    pose = forward(CHAIN, np.array([[0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0]]))
    flange = pose.p_tcp[0] - pose.R_tool[0] @ [0, 0, 0.45]
    assert np.allclose(flange, [0.35 + 1.2 + 0.215, 0.0, 0.675 + 1.15 - 0.041], atol=1e-12)
    assert np.allclose(pose.R_tool[0][:, 2], [1, 0, 0], atol=1e-12)


@given(st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_jacobian_is_the_derivative_of_the_pose(seed):
    q = np.random.default_rng(seed).uniform(CHAIN.lower, CHAIN.upper)[None]
    pose, h = forward(CHAIN, q), 1e-6
    for k in range(CHAIN.n):
        dq = np.zeros_like(q)
        dq[0, k] = h
        after, before = forward(CHAIN, q + dq), forward(CHAIN, q - dq)
        turn = rotation_vector(after.R_tool[0] @ before.R_tool[0].T)
        numeric = np.concatenate([after.p_tcp[0] - before.p_tcp[0], turn]) / (2 * h)
        assert np.allclose(pose.jacobian()[0, :, k], numeric, atol=1e-7)


def test_inverse_kinematics_finds_the_pose_again():
    rng = np.random.default_rng(1)
    home = np.array([0.0, -1.4, 1.5, 0.3, 0.8, 0.2])
    q = home + rng.uniform(-0.2, 0.2, (20, 6))
    goal = forward(CHAIN, q)
    found, reached = inverse(CHAIN, goal.p_tcp, goal.R_tool, np.tile(home, (20, 1)))
    assert reached.all()
    again = forward(CHAIN, found)
    assert np.abs(again.p_tcp - goal.p_tcp).max() < 1e-9
    assert np.abs(again.R_tool - goal.R_tool).max() < 1e-9


def test_inverse_kinematics_says_what_is_out_of_reach():
    _, reached = inverse(CHAIN, np.array([[5.0, 0.0, 1.0]]), np.eye(3)[None], np.array([[0.0, -1.4, 1.5, 0.0, 0.8, 0.0]]))
    assert not reached[0]


@given(vectors)
def test_rotation_vector_and_matrix_are_inverse(v):
    assert np.allclose(rotation_vector(rotation_of_vector(v)), v, atol=1e-9)


@given(vectors)
def test_quaternion_and_matrix_are_inverse(v):
    R = rotation_of_vector(v)
    assert np.allclose(rotation_of_quaternion(quaternion_of_rotation(R)), R, atol=1e-9)


def test_the_tool_beyond_its_mount_is_kept_apart_from_the_last_link():
    assert CHAIN.tool_mass == 120.0
    assert np.allclose(CHAIN.p_tcp, [0, 0, 0.45]) and np.allclose(CHAIN.tool_com, [0, 0, 0.2])
    assert CHAIN.mass.sum() == pytest.approx(363.07 + 232.06 + 181.83 + 42.41 + 16.99 + 6.6)


def test_a_description_without_tool0_is_refused_by_name(tmp_path):
    path = tmp_path / "r.urdf"
    path.write_text("<robot name='r'><link name='base_link'/></robot>")
    with pytest.raises(SimError, match="no path from base_link to tool0"):
        read_urdf(path)


@pytest.mark.parametrize("name", ["afp", "milling"])
def test_surfaces_and_their_gap_agree(name):
    surface = read_cell(name).surface
    p, normal = surface.sample(50, 0.05, np.random.default_rng(0))
    for point, n in zip(p, normal, strict=True):
        gap, at = surface.gap(point + 5e-4 * n)
        assert gap == pytest.approx(5e-4, rel=1e-3)
        assert at @ n > 0.999999


def test_an_unknown_cell_is_named():
    with pytest.raises(SimError, match="cell 'nowhere'"):
        read_cell("nowhere")
