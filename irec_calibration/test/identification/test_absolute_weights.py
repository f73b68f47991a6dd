# SPDX-License-Identifier: Apache-2.0
"""What an absolute session knows besides its rows is used: markers' own noise, commanded angles, branches, masses for ratings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from absolute_sessions import SIX, session, torsion, urdf
from irec_calibration.effects.of_session import scene_of
from irec_calibration.identification.absolute import base_terms
from irec_calibration.identification.identify import fit, identify, observe_with_force_noise
from irec_calibration.identification.observe import observe
from irec_calibration.model import Estimate, blank_model
from irec_calibration.robot import Robot
from irec_calibration.robot.ratings import rated_torque
from irec_calibration.session import Marker, Noise

MARKERS = (
    Marker("M1", "tool0", (0.03, -0.02, 0.1), known=False),
    Marker("M2", "tool0", (-0.1, 0.05, 0.0), known=False),
    Marker("M3", "tool0", (0.05, 0.1, 0.05), known=False),
    Marker("B1", "base_link", (0.3, 0.2, 0.1), known=False),
)
QUIET = Noise(tracker_m=1e-5)


def shaken(s, p):
    """The robot does not come back to the same place: the same for all markers on the tool in a pose."""
    off = np.random.default_rng(3).normal(size=(s.pose.max(), 3)) * 1e-4
    return off[s.pose - 1] * np.array([m.link == "tool0" for m in s.markers])[s.marker][:, None]


def test_what_the_markers_of_a_pose_share_is_told_from_the_noise_of_each():
    data = session(noise=QUIET, markers=MARKERS, moved=shaken, poses=150)
    seen = observe_with_force_noise(data, base_terms())
    tool = data.marker[seen.rows] < 3
    sigma, shared = seen.whiten.sigma, seen.whiten.sigma_reference
    assert np.median(shared[tool]) / np.median(sigma[tool]) == pytest.approx(10.0, rel=0.35)
    assert np.all(shared[~tool] == 0.0)
    assert np.median(sigma[~tool]) / np.median(sigma[tool]) == pytest.approx(1.0, rel=0.35)
    assert any(n.startswith("residual by marker") for n in seen.session.notes)
    assert seen.whiten.floor == pytest.approx(observe(data).whiten.floor, rel=0.02)  # the level stays a matter of its own


@pytest.mark.parametrize("better", ["target", "joint"])
def test_commanded_and_reported_angles_compete_and_a_note_says_which_fits(better):
    data = session(noise=QUIET, poses=100)
    wrong = data.q + np.random.default_rng(0).normal(size=data.q.shape) * 5e-4
    good, bad = data.q, wrong
    q, target = (bad, good) if better == "target" else (good, bad)
    mixed = replace(data, q=q, q_target=target, p_tcp_in_base=data.robot.kinematics(q).p_tcp)
    found = identify(mixed, base_terms())
    np.testing.assert_array_equal(found.observation.session.q, good)
    assert any(f"({better}_*) are used" in n for n in found.observation.session.notes)
    assert found.rms < 3e-5


def test_one_row_of_another_pose_does_not_decide_which_angles_are_used():
    data = session(noise=QUIET, poses=60)
    q = data.q.copy()
    q[30] = q[10]
    target = data.q + np.random.default_rng(0).normal(size=q.shape) * 5e-4
    seen = observe_with_force_noise(
        replace(data, q=q, q_target=target, p_tcp_in_base=data.robot.kinematics(q).p_tcp), base_terms()
    )
    assert any("(joint_*) are used" in n for n in seen.session.notes)
    assert 30 not in seen.rows


@pytest.mark.parametrize("clock", ["time", "none"])
def test_reported_angles_that_were_read_on_the_way_are_used_so_that_the_settling_is_found(clock):
    data = session(noise=QUIET, poses=100)
    step = np.diff(data.q, axis=0, prepend=data.q[:1])
    q = data.q - step * np.array([0.0, 3e-4, 3e-4, 0.0, 0.0, 0.0])
    late = replace(data, q=q, q_target=data.q, p_tcp_in_base=data.robot.kinematics(q).p_tcp, clock=clock)
    note = next(n for n in observe_with_force_noise(late, base_terms()).session.notes if "are used" in n)
    assert ("(joint_*) are used" in note) == ("joint_settling" in note) == (clock == "time"), note
    assert "axis 2 0.3, axis 3 0.3" in note or clock == "none"


def branched(effort: int = 300) -> Robot:
    text = urdf(SIX).replace('effort="300"', f'effort="{effort}"')
    arm = (
        '<link name="weight"><inertial><origin xyz="0.5 0 0"/><mass value="20"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="balance" type="revolute"><parent link="link_2"/><child link="weight"/><axis xyz="0 1 0"/>'
        '<limit lower="-4" upper="4" velocity="1" effort="300"/></joint></robot>'
    )
    return Robot(text.replace("</robot>", arm))


def test_an_external_axis_named_like_a_joint_of_a_branch_moves_its_masses():
    robot = branched()
    assert robot.branch_joints == ("balance",)
    plain = session(poses=5)
    data = replace(plain, robot=robot, ext={"balance": np.full(len(plain), np.pi)})
    turned, straight = scene_of(data), scene_of(replace(data, ext={}))
    change = turned.tau_gravity - straight.tau_gravity
    assert np.abs(change[:, 1]).max() > 50.0  # 20 kg on the other side of axis 2
    assert np.abs(change[:, 2:]).max() < 1e-9
    np.testing.assert_allclose(turned.kin.p_tcp, straight.kin.p_tcp)


def test_an_external_axis_that_nothing_knows_is_said():
    plain = session(poses=30, noise=QUIET)
    notes = identify(replace(plain, ext={"belt": np.arange(len(plain)) * 0.1}), base_terms()).observation.session.notes
    assert any(n.startswith("ext_belt: no joint") for n in notes)


def test_a_drive_without_a_torque_limit_is_rated_by_the_masses_it_carries_and_this_is_said():
    robot = branched(effort=0)
    rated = rated_torque(robot)
    assert rated[1] > 100.0 and rated[5] < 0.2 * rated[1] and np.all(rated > 0.0)
    np.testing.assert_allclose(rated_torque(branched(effort=300)), rated)  # the same for all drives: filled in
    plain = session(poses=30, noise=QUIET)
    notes = identify(replace(plain, robot=robot), base_terms()).observation.session.notes
    assert any("no torque limit" in n and "joint_2" in n for n in notes)


def test_a_fit_never_ends_with_a_larger_residual_than_it_began_with():
    data = session(noise=QUIET, moved=torsion(np.full(6, 4e-6)), poses=60, stated=True)
    seen = observe(data)
    wild = tuple(replace(t, estimates={}) for t in blank_model(["geometry_error", "external_force", "joint_torsion"]))
    start = float((seen.whiten(seen.y) ** 2).sum())
    found = fit(wild, seen)
    assert found.chi2 <= start
    assert isinstance(found.converged, bool) and all(isinstance(e, Estimate) for t in found.terms for e in t.estimates.values())
