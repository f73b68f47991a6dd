# SPDX-License-Identifier: Apache-2.0
"""Absolute sessions: arms under gravity, stations and markers unknown. Kinematics are checked against plain matrices."""

import csv
from dataclasses import replace

import numpy as np
import pytest
import yaml
from irec_sim.absolute import (
    MISHAPS,
    at_rest,
    draw_poses,
    draw_setup,
    free_of_gauge,
    generate_absolute,
    spoiled,
    write_absolute,
    write_truth_rows,
)
from irec_sim.absolute_oracle import consult_absolute
from irec_sim.absolute_truth import ROBOTS, Geometry, draw_absolute, draw_effect, read_arm
from irec_sim.hidden import draw_absolute_session
from irec_sim.kinematics import forward, rotation_of_vector
from irec_sim.matrix import Case
from irec_sim.noise import TrueNoise
from irec_sim.plant import Plant

NOISE = TrueNoise(12e-6, 5e-6, 0.0, 1.0)
CLAIM = {"tracker_m": 12e-6, "tracker_m_per_m": 5e-6}


def _truth(name, *effects, seed=0, exact=False):
    rng = np.random.default_rng(seed)
    arm = read_arm(name, rng)
    truth = replace(draw_absolute(arm, 0, rng), hidden=tuple((e, draw_effect(e, arm, rng)) for e in effects))
    n = arm.chain.n
    return replace(truth, geometry=Geometry(np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3)))) if exact else truth


def _made(truth, poses=60, seed=1, mishap="", robot_m=1e-5):
    rng = np.random.default_rng(seed)
    setup = draw_setup(truth.arm.chain, np.random.default_rng(5))
    return generate_absolute(truth, setup, poses, NOISE, CLAIM, robot_m, rng, mishap)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_a_rigid_arm_of_nominal_geometry_is_where_its_description_says(name):
    truth = _truth(name, exact=True)
    made = _made(truth, 20)
    pose = forward(truth.arm.chain, made.q)
    assert np.abs(made.p_tcp - pose.p_tcp).max() < 1e-12
    marker = pose.p_tcp + pose.R_tool @ made.setup.markers[0]
    assert np.abs((marker - made.setup.p_station) @ made.setup.R_station - made.clean[:, 0]).max() < 1e-12


def test_the_arm_sags_by_its_weight_about_its_soft_joint():
    truth = _truth("ur10", "joint_torsion", exact=True)
    chain, c = truth.arm.chain, np.array(truth.hidden[0][1]["compliance"])
    made = _made(truth, 12)
    pose = forward(chain, made.q)
    masses = np.r_[chain.mass, chain.tool_mass]
    h, sag = 1e-6, np.zeros((12, 3))
    for k in range(6):

        def height(q):
            R, p, out = np.eye(3), np.zeros(3), []
            for i in range(6):
                p = p + R @ chain.p_fixed[i]
                R = R @ chain.R_fixed[i] @ rotation_of_vector(chain.axis[i] * q[i])
                out.append(p + R @ chain.com[i])
            p, R = p + R @ chain.p_mount, R @ chain.R_mount
            out.append(p + R @ chain.tool_com)
            return masses @ np.array(out)[:, 2]

        step = np.eye(6)[k] * h
        torque = np.array([-9.81 * (height(q + step) - height(q - step)) / (2 * h) for q in made.q])
        sag += pose.jacobian()[:, :3, k] * (c[k] * torque)[:, None]
    assert np.abs(made.p_tcp - pose.p_tcp - sag).max() < 0.02 * np.abs(sag).max()


def test_a_solution_near_another_is_the_solution():
    truth = _truth("ur5", "joint_torsion", "joint_hysteresis", "base_compliance", "encoder_harmonics")
    made = _made(truth, 20)
    physics, other = truth.physics(), truth.without("base_compliance", "joint_hysteresis").physics()
    plants = [Plant(truth.arm.chain, p.plant, whole=True) for p in (physics, other)]
    near = at_rest(plants[0], physics, made.q)
    exact, quick = at_rest(plants[1], other, made.q), at_rest(plants[1], other, made.q, near)
    assert np.abs(near.frames.p_tcp - exact.frames.p_tcp).max() > 3e-5
    assert np.abs(quick.frames.p_tcp - exact.frames.p_tcp).max() < 2e-6


def test_friction_remembers_from_which_side_the_arm_came():
    truth = _truth("ur10", "joint_torsion", "joint_hysteresis", exact=True)
    physics = truth.physics()
    plant = Plant(truth.arm.chain, physics.plant, whole=True)
    q = np.tile(draw_poses(truth.arm.chain, 1, np.random.default_rng(0)), (5, 1))
    q[0, 1] -= 0.3
    q[3, 1] += 0.3
    p = at_rest(plant, physics, q).frames.p_tcp
    assert np.linalg.norm(p[1] - p[4]) > 1e-6  # the same pose from both sides


@pytest.mark.parametrize("kind", MISHAPS)
def test_a_mishap_is_where_the_truth_says(kind):
    truth = _truth("ur5")
    plain, wrong = _made(truth), _made(truth, mishap=kind)
    (mishap,) = wrong.mishaps
    moved = np.abs(wrong.seen - plain.seen).max(axis=2) > 0
    turned = (wrong.q_written != wrong.q).any(axis=1)
    assert list(np.flatnonzero(moved.any(axis=1) | turned))[0] == mishap.pose - 1
    assert (spoiled(wrong) >= moved).all() and (spoiled(wrong).any(axis=1) >= turned).all()


def test_the_folder_is_an_absolute_session_and_says_nothing_of_the_truth(tmp_path):
    drawn = draw_absolute_session(Case("absolute", claim="factor", mishap="jump"), 12, 30, 12)
    write_absolute(drawn.made, tmp_path / "s", "s1")
    header = yaml.safe_load((tmp_path / "s" / "session.yaml").read_text())
    assert header["kind"] == "absolute" and header["stations"][0]["name"] == "A"
    with open(tmp_path / "s" / "samples.csv", encoding="utf-8") as f:
        rows = list(csv.DictReader(f))
    assert len(rows) == 30 * len(header["markers"])
    text = "".join(p.read_text() for p in (tmp_path / "s").iterdir() if p.name != "robot.urdf")
    for word in ("torsion", "truth", "mishap", "jump", "oracle", "seed"):
        assert word not in text


def test_some_descriptions_state_no_torque_limits(tmp_path):
    truth = _truth("ur5")
    made = _made(truth, 5)
    write_absolute(replace(made, setup=replace(made.setup, no_efforts=True)), tmp_path / "s", "s")
    text = (tmp_path / "s" / "robot.urdf").read_text()
    assert text.count('effort="0"') == 6 and 'effort="150"' not in text


def test_what_no_session_tells_is_taken_out_and_nothing_else(tmp_path):
    truth = _truth("ur5", "joint_torsion")
    made = _made(truth, 40)
    pose = forward(truth.arm.chain, made.q)
    gauge = np.cross([1e-3, -2e-3, 3e-3], pose.p_tcp) + [1e-3, 2e-3, 3e-3] + pose.R_tool @ [4e-4, 0, -1e-3]
    assert np.abs(free_of_gauge(gauge, pose.p_tcp, pose.R_tool)).max() < 1e-12
    sag = made.p_tcp - pose.p_tcp
    assert np.abs(free_of_gauge(sag + gauge, pose.p_tcp, pose.R_tool) - free_of_gauge(sag, pose.p_tcp, pose.R_tool)).max() < 1e-12
    write_truth_rows(made, tmp_path / "truth.csv")
    with open(tmp_path / "truth.csv", encoding="utf-8") as f:
        row = list(csv.DictReader(f))[7]
    assert [float(row[f"deflection_{a}"]) for a in "xyz"] == pytest.approx(sag[7], abs=1e-9)
    assert [float(row[f"R_{i}{j}"]) for i in "xyz" for j in "xyz"] == pytest.approx(pose.R_tool[7].ravel(), abs=1e-9)


def test_the_oracle_sees_soft_joints_and_predicts_to_a_few_micrometres():
    truth = _truth("ur10", "joint_torsion", "encoder_harmonics")
    oracle = consult_absolute(_made(truth, 80, seed=1), _made(truth, 40, seed=2))
    assert all(s.visible for s in oracle.seen)
    assert oracle.oracle_m < 3e-5 and oracle.base_m > 5 * oracle.oracle_m


def test_the_oracle_does_not_take_friction_for_the_spring_that_it_needs():
    truth = _truth("ur10", "joint_torsion", "joint_hysteresis", "base_compliance")
    oracle = consult_absolute(_made(truth, 80, seed=1), _made(truth, 40, seed=2))
    assert {s.effect: s.visible for s in oracle.seen}["joint_torsion"]


def test_wrong_geometry_alone_is_not_more_than_the_base_model():
    truth = _truth("ur10")
    oracle = consult_absolute(_made(truth, 80, seed=1), _made(truth, 40, seed=2))
    assert oracle.seen == () and oracle.base_m == oracle.oracle_m < 3e-5


@pytest.mark.parametrize("effect", ["tool_compliance", "external_force"])
def test_a_soft_tool_and_a_dress_pack_move_the_tcp_without_any_process(effect):
    springs = ("joint_torsion", "link_bending")
    plain, more = (_made(_truth("kr300_r2500_ultra", *springs, *own, exact=True), 20) for own in ((), (effect,)))
    moved = np.linalg.norm(more.p_tcp - plain.p_tcp, axis=1)
    assert 5e-6 < np.sqrt((moved**2).mean()) < 3e-3
    assert moved.std() > 0.05 * moved.mean()  # by the pose: the payload turns with the tool, the hose with the place
