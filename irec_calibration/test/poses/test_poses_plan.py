# SPDX-License-Identifier: Apache-2.0
"""From a cell to a pose file: the pool's checks, inverse kinematics, irec plan and what it refuses."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_calibration.cell import Station, read_cell
from irec_calibration.cell.surface import Patch
from irec_calibration.cli import main
from irec_calibration.errors import CellError, PlanError
from irec_calibration.poses.blocks import observation_blocks
from irec_calibration.poses.checker import REASONS, Checker, segment_distance
from irec_calibration.poses.ik import Chain, solve_tool_axis, wrap_into_limits
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.pool import generate_pool
from irec_calibration.poses.store import read_poses, write_poses

CELLS = Path(__file__).parents[3] / "config" / "cells"


@pytest.fixture(scope="module")
def afp():
    return read_cell(CELLS / "afp.yaml")


@pytest.fixture(scope="module")
def milling():
    return read_cell(CELLS / "milling.yaml")


@pytest.fixture(scope="module")
def afp_pool(afp):
    return generate_pool(afp, 150)


def test_the_product_of_exponentials_agrees_with_pinocchio(afp):
    q = np.random.default_rng(0).uniform(-2, 2, size=(50, 6))
    p, R, J = Chain.of(afp.robot).forward(q)
    kin = afp.robot.kinematics(q)
    np.testing.assert_allclose(p, kin.p_tcp, atol=1e-12)
    np.testing.assert_allclose(R, kin.R_tool, atol=1e-12)
    np.testing.assert_allclose(J[:, :3], kin.jacobian(kin.p_tcp), atol=1e-12)
    np.testing.assert_allclose(J[:, 3:], kin.axis.swapaxes(1, 2), atol=1e-12)


@cache
def afp_chain():
    return Chain.of(read_cell(CELLS / "afp.yaml").robot)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_inverse_kinematics_finds_the_tool_axis_of_a_reachable_configuration(seed):
    chain = afp_chain()
    rng = np.random.default_rng(seed)
    true = np.array([0.0, -1.4, 1.6, 0.3, 0.9, 0.0]) + 0.2 * rng.normal(size=(20, 6))
    p, R, _ = chain.forward(true)
    q, converged = solve_tool_axis(chain, p, R[:, :, 2], true + 0.15 * rng.normal(size=true.shape))
    p_found, R_found, _ = chain.forward(q)
    assert converged.mean() > 0.9
    np.testing.assert_allclose(p_found[converged], p[converged], atol=1e-8)
    np.testing.assert_allclose(R_found[converged, :, 2], R[converged, :, 2], atol=1e-8)


def test_inverse_kinematics_says_that_a_point_out_of_reach_did_not_converge(afp):
    _, converged = solve_tool_axis(Chain.of(afp.robot), np.array([[9.0, 0, 1]]), np.array([[1.0, 0, 0]]), afp.home[None])
    assert not converged.any()


def test_wrapping_adds_whole_turns_until_a_joint_lies_within_its_limits():
    lower, upper = np.array([-3.2, -6.1]), np.array([3.2, 6.1])
    q = wrap_into_limits(np.array([[4.0, 9.0]]), lower, upper, np.array([False, False]))
    np.testing.assert_allclose(q, [[4.0 - 2 * np.pi, 9.0 - 2 * np.pi]])


def test_every_pose_of_the_pool_engages_the_surface_with_tool_z_along_the_normal(afp, afp_pool):
    kin = afp.robot.kinematics(afp_pool.q)
    in_cell = kin.p_tcp + afp.base_in_cell(afp_pool.rail)
    np.testing.assert_allclose(in_cell, afp_pool.p_in_cell, atol=1e-7)
    np.testing.assert_allclose(kin.R_tool[:, :, 2], -afp_pool.normal_in_cell, atol=1e-7)
    x, y, z = ((afp_pool.p_in_cell - afp.surface.p_in_cell) @ afp.surface.R_in_cell).T
    np.testing.assert_allclose(z, -(x**2) / (2 * 2.0) - y**2 / (2 * 2.5), atol=1e-9)


def test_every_pose_of_the_pool_is_within_joint_rail_and_torque_limits(afp, afp_pool):
    assert (afp_pool.q >= afp.robot.lower + afp.joint_margin).all()
    assert (afp_pool.q <= afp.robot.upper - afp.joint_margin).all()
    assert (afp_pool.rail >= afp.rail.lower).all() and (afp_pool.rail <= afp.rail.upper).all()
    kin = afp.robot.kinematics(afp_pool.q)
    gravity = afp.robot.gravity_torque(afp_pool.q, payload=afp.payload)
    for force in afp.forces_in_tool:
        process = np.einsum("nik,ni->nk", kin.jacobian(kin.p_tcp), kin.R_tool @ force)
        assert (np.abs(process + gravity) <= afp.continuous_torque).all()


def test_the_rotation_about_the_tool_axis_and_the_rail_position_are_made_use_of(afp_pool):
    x = np.einsum("nij,j->ni", afp_pool.R_in_base, [1.0, 0, 0])
    assert np.ptp(np.arctan2(x[:, 1], x[:, 0])) > 3.0
    assert np.ptp(afp_pool.rail) > 1.0


def test_counts_of_accepted_and_rejected_candidates_add_up(milling):
    pool = generate_pool(milling, 60)
    assert pool.drawn == len(pool) + sum(pool.rejected.values()) == len(pool) + len(pool.p_rejected)
    assert pool.rejected["edge"] > 0


def test_the_pool_is_the_same_for_the_same_seed(afp):
    np.testing.assert_array_equal(generate_pool(afp, 20, seed=3).q, generate_pool(afp, 20, seed=3).q)
    assert not np.array_equal(generate_pool(afp, 20, seed=4).q, generate_pool(afp, 20, seed=3).q)


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        ("edge", {"pad_radius": 5.0}),
        ("friction", {"friction": 0.2, "pad_radius": 0.0}),
        ("singularity", {"singularity": 10.0}),
        ("clearance", {"hull": np.array([[0.0, 0, -0.05, 0.2]])}),
        ("line_of_sight", {"stations": (Station("below", np.array([2.5, 0.0, -3.0]), np.eye(3)),)}),
        ("torque", {"continuous_torque": np.full(6, 100.0)}),
    ],
)
def test_a_surface_that_can_not_be_engaged_is_refused_with_the_reason_and_its_count(afp, reason, change):
    with pytest.raises(PlanError, match=rf"0 accepted; rejected: {reason} 24\). {reason}: {REASONS[reason]}"):
        generate_pool(replace(afp, **change), 8)


def test_a_surface_out_of_reach_is_refused_with_the_reason_and_its_count(afp):
    far = Patch((0.5, 0.5), (2.0, 2.0), np.eye(3), np.array([20.0, 0.0, 1.0]))
    with pytest.raises(PlanError, match=r"0 accepted; rejected: .*reach \d\d\)"):
        generate_pool(replace(afp, surface=far), 8)


def test_a_configuration_beyond_a_joint_limit_is_told_from_one_that_is_out_of_reach(afp):
    checker = Checker(afp)
    q = np.array([[0.0, -1.5, 1.7, 4.0, 0.8, 0.0], [0.0, -0.01, 1.7, 0.0, 0.8, 0.0]])
    level, *_ = checker.check(q, np.array([False, True]), np.zeros(2), np.array([[0, 0, 1.0]] * 2))
    assert [list(REASONS)[i] for i in level] == ["reach", "joint_limits"]


def test_an_arm_between_marker_and_station_blocks_the_view(afp, afp_pool):
    behind = Station("behind", np.array([-3.0, 0.0, 1.6]), np.eye(3))  # looks along the arm at the mould
    thin = replace(afp, stations=(behind,), arm_radius=0.0, hull=np.array([[0.0, 0.0, -0.2, 0.0]]))
    thick = replace(thin, arm_radius=afp.arm_radius)
    n = len(afp_pool)
    arguments = (afp_pool.q, np.ones(n, dtype=bool), afp_pool.rail, afp_pool.normal_in_cell)
    hidden = [Checker(cell).check(*arguments)[0] == list(REASONS).index("line_of_sight") for cell in (thin, thick)]
    assert hidden[0].mean() < 0.05
    assert hidden[1].mean() > 0.2


def test_segments_that_cross_have_distance_zero_and_parallel_ones_their_gap():
    p, u = np.array([[0.0, 0, 0], [0, 0, 0]]), np.array([[1.0, 0, 0], [1, 0, 0]])
    q, v = np.array([[0.5, -1, 0], [0, 0, 0.3]]), np.array([[0.0, 2, 0], [1, 0, 0]])
    np.testing.assert_allclose(segment_distance(p, u, q, v), [0.0, 0.3], atol=1e-12)


def test_observation_blocks_are_what_finite_compliances_do(afp, afp_pool):
    kin = afp.robot.kinematics(afp_pool.q[:5])
    blocks = observation_blocks(kin, afp.forces_in_tool, afp.marker_in_tool)
    k, axis_number = 2, 3
    for case, force in enumerate(afp.forces_in_tool):
        f = kin.R_tool @ force
        marker = kin.p_tcp + kin.R_tool @ afp.marker_in_tool
        for column, axis in ((k, kin.axis[:, k]), (6 + 2 * axis_number + 1, kin.virtual_axis[:, axis_number, 1])):
            centre = kin.origin[:, k if column == k else axis_number]
            torque = np.sum(np.cross(kin.p_tcp - centre, f) * axis, axis=1)
            expected = torque[:, None] * np.cross(axis, marker - centre)
            np.testing.assert_allclose(blocks[:, case, :, column], expected, atol=1e-9)


def test_a_pose_file_gives_back_what_was_written(afp, tmp_path):
    plan = make_plan(afp, 5, pool_size=40)
    written = pose_list(afp, plan)
    read = read_poses(write_poses(written, tmp_path / "poses.yaml"), afp.serial, afp.robot.sha256)
    assert [pose.index for pose in read.poses] == [1, 2, 3, 4, 5]
    assert read.plan["figures"]["poses"] == 5
    for a, b in zip(read.poses, written.poses, strict=True):
        np.testing.assert_allclose(a.q, b.q, atol=1e-9)
        np.testing.assert_allclose(a.quat_tool_in_base, b.quat_tool_in_base, atol=1e-9)
        assert a.ext == pytest.approx(b.ext, abs=1e-9) and a.station == b.station == "A"


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda c: c.update(format="irec-poses/2"), "this program reads irec-poses/1"),
        (lambda c: c["poses"][1].update(joints=[0.0]), r"poses\[1\].joints has 1 values, robot.joints names 6"),
        (lambda c: c["poses"][0].update(pose=2), r"poses\[1\].pose is 2 again"),
        (lambda c: c["robot"].update(serial="other"), "planned for the robot 'other'"),
        (lambda c: c["robot"].update(urdf_sha256="0" * 64), "robot description has changed"),
        (lambda c: c.pop("robot"), "robot is missing"),
    ],
)
def test_a_wrong_pose_file_is_refused_with_its_place(afp, tmp_path, edit, said):
    path = write_poses(pose_list(afp, make_plan(afp, 2, pool_size=20)), tmp_path / "poses.yaml")
    content = yaml.safe_load(path.read_text())
    edit(content)
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(PlanError, match=said):
        read_poses(path, afp.serial, afp.robot.sha256)


def test_irec_plan_writes_poses_and_picture_and_prints_the_figures(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="extra 'report' is not installed")
    out = tmp_path / "poses.yaml"
    assert main(["plan", str(CELLS / "afp.yaml"), "-n", "6", "--pool", "60", "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    figures = ("cover distance", "O1 =", "condition number", "predicted uncertainty", "60 accepted", "play shows where")
    for said in ("N = 6 poses by cover", *figures):
        assert said in printed
    assert len(read_poses(out).poses) == 6
    assert out.with_suffix(".png").stat().st_size > 20_000


def test_irec_plan_along_the_surface_and_as_json(tmp_path, capsys):
    out = str(tmp_path / "poses.yaml")
    arguments = ["plan", str(CELLS / "milling.yaml"), "-n", "5", "--pool", "40", "--along-surface", "--json", "-o", out]
    assert main(arguments) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["figures"]["poses"] == 5
    assert printed["drawn"] == 40 + sum(printed["rejected"].values())


def test_more_poses_than_the_pool_holds_end_with_exit_code_2_and_the_counts(tmp_path, capsys):
    arguments = ["plan", str(CELLS / "afp.yaml"), "-n", "31", "--pool", "20", "-o", str(tmp_path / "poses.yaml")]
    assert main(arguments) == 2
    assert "31 poses were asked for, the pool has 20" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda c: c.update(format="irec-cell/9"), "this program reads irec-cell/1"),
        (lambda c: c["surface"].update(kind="sphere"), "surface.kind is 'sphere'"),
        (lambda c: c["surface"].update(size=[1.0]), "surface.size has 1 values, must have 2"),
        (lambda c: c["surface"].update(quat_xyzw=[1, 1, 0, 0]), "surface.quat_xyzw is .* must have length 1"),
        (lambda c: c["limits"].pop("joint_margin"), "limits.joint_margin is missing"),
        (lambda c: c["limits"].update(continuous_torque=2), "limits.continuous_torque is 2, must lie between"),
        (lambda c: c["robot"]["rail"].update(range=[1, -1]), "robot.rail.range is .* the lower end must come first"),
        (lambda c: c.update(stations=[]), "stations has 0 values"),
        (lambda c: c["tool"].update(hull=[[0, 0]]), r"tool.hull\[0\] has 2 values, must have 4"),
    ],
)
def test_a_wrong_cell_file_is_refused_with_file_and_key(tmp_path, edit, said):
    content = yaml.safe_load((CELLS / "afp.yaml").read_text())
    content["robot"]["urdf"] = str((CELLS / content["robot"]["urdf"]).resolve())
    edit(content)
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(CellError, match=said) as caught:
        read_cell(path)
    assert "cell.yaml" in str(caught.value)


def test_a_cell_may_state_its_tooling_as_a_mesh_file(tmp_path, afp):
    trimesh = pytest.importorskip("trimesh", reason="extra 'mesh' is not installed")
    mesh = afp.surface.mesh()
    local = (mesh.vertices - afp.surface.p_in_cell) @ afp.surface.R_in_cell
    trimesh.Trimesh(1000 * local, mesh.corners, process=False).export(tmp_path / "mould.stl")
    content = yaml.safe_load((CELLS / "afp.yaml").read_text())
    content["robot"]["urdf"] = str((CELLS / content["robot"]["urdf"]).resolve())
    placed = {key: content["surface"][key] for key in ("xyz", "quat_xyzw")}
    content["surface"] = {"kind": "mesh", "file": "mould.stl", "scale": 0.001, **placed}
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(content))
    plan = make_plan(read_cell(tmp_path / "cell.yaml"), 4, pool_size=40)
    x, y, z = ((plan.pool.p_in_cell - afp.surface.p_in_cell) @ afp.surface.R_in_cell).T
    np.testing.assert_allclose(z, -(x**2) / (2 * 2.0) - y**2 / (2 * 2.5), atol=3e-4)  # flat triangles of 4 cm


def test_an_empty_pool_ends_with_exit_code_2(tmp_path, capsys):
    arguments = ["plan", str(CELLS / "afp.yaml"), "-n", "1", "--pool", "0", "-o", str(tmp_path / "poses.yaml")]
    assert main(arguments) == 2
    assert "a pool of 0 candidates was asked for" in capsys.readouterr().err
