# SPDX-License-Identifier: Apache-2.0
"""Robots with a passive joint: what follows through a linkage, and what the linkage gives way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from absolute_sessions import SIX, Joint
from absolute_sessions import urdf as urdf_of
from irec_calibration.diagnose import diagnose
from irec_calibration.diagnose.held_out import validated
from irec_calibration.diagnose.study import completed_study, form_evidence, prepare
from irec_calibration.effects import find_effect
from irec_calibration.effects.live import Refused
from irec_calibration.effects.of_session import marker_by_controller, scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.identification.identify import default_terms
from irec_calibration.robot import Robot
from irec_calibration.session import Marker, Noise, Session, Station
from irec_calibration.typing import Array

JOINTS = (SIX[0], SIX[1], SIX[2], Joint((0.6, 0, 0), (0, 1, 0)), Joint((0.1, 0, -0.2), (0, 0, 1)))
DRIVES = (0, 1, 2, 4)
C = np.array([1.5e-6, 1.1e-6, 1.4e-6, 0.0, 6e-6])
CASES = np.array([[0, 0, 0], [0, 0, -400], [120, 0, -400], [-120, 0, -400], [0, 120, -400], [0, -120, -400]], dtype=float)
LINKAGE = find_effect("linkage_compliance")


def palletiser(moved, poses: int = 24, seed: int = 1, passive: bool = True) -> Session:
    """A loaded session of a palletiser; moved: function (scene) -> displacement of the marker, (n, 3), m."""
    rng = np.random.default_rng(seed)
    robot = Robot(urdf_of(tuple(replace(j, zero=0.0) for j in JOINTS)))
    q = rng.uniform(-0.8, 0.8, (poses, 5))
    q[:, 3] = -(q[:, 1] + q[:, 2])
    q = np.repeat(q, len(CASES), axis=0)
    n = len(q)
    kin = robot.kinematics(q)
    blank = Session(
        name="palletiser", kind="loaded", robot=robot, serial="P", pose=np.repeat(np.arange(1, poses + 1), len(CASES)),
        load_case=np.tile(np.arange(len(CASES)), poses), repeat=np.zeros(n, dtype=np.int64), stamp=4.0 * np.arange(n), q=q,
        p_tcp_in_base=kin.p_tcp, p_marker_in_station=np.zeros((n, 3)), station=np.zeros(n, dtype=np.int64),
        stations=(Station("A", (2.5, -1.0, 0.5), known=True),), marker=np.zeros(n, dtype=np.int64),
        markers=(Marker("marker", "tool0", (0.0, 0.0, 0.05)),), force_in_tool=np.tile(CASES, (poses, 1)),
        torque_in_tool=np.zeros((n, 3)), noise=Noise(tracker_m=8e-6), gravity_in_base=(0.0, 0.0, 0.0),
        passive={"joint_4": "-(joint_2 + joint_3)"} if passive else {},
    )  # fmt: skip
    p = marker_by_controller(blank, kin) + moved(scene_of(blank)) - np.array([2.5, -1.0, 0.5])
    return replace(blank, p_marker_in_station=p + rng.normal(0.0, 8e-6, p.shape))


def raw(scene: Scene) -> tuple[Array, Array]:
    """Jacobian of the marker and torque of each joint as if all were free, (n, 3, 5) and (n, 5); written out on purpose."""
    J = np.stack([np.cross(scene.kin.axis[:, k], scene.p_observed - scene.kin.origin[:, k]) for k in range(5)], axis=2)
    arm = np.stack([np.cross(scene.kin.axis[:, k], scene.p_tcp - scene.kin.origin[:, k]) for k in range(5)], axis=2)
    return J, np.einsum("nik,ni->nk", arm, scene.force)


def rods_hold(scene: Scene) -> Array:
    """The wrist stays level whatever the drives give way."""
    J, tau = raw(scene)
    for d in (1, 2):
        J[:, :, d] -= J[:, :, 3]
        tau[:, d] -= tau[:, 3]
    return np.asarray(np.einsum("nik,k,nk->ni", J[:, :, DRIVES], C[list(DRIVES)], tau[:, DRIVES]))


def rods_are_soft(scene: Scene) -> Array:
    J, tau = raw(scene)
    return rods_hold(scene) + 4e-6 * J[:, :, 3] * tau[:, 3, None]


def wrist_is_locked(scene: Scene) -> Array:
    """What a drive gives way turns the whole arm beyond it: the passive joint keeps its angle."""
    J, tau = raw(scene)
    return np.asarray(np.einsum("nik,k,nk->ni", J[:, :, DRIVES], C[list(DRIVES)], tau[:, DRIVES]))


@pytest.mark.parametrize(
    ("moved", "values"),
    [
        (rods_hold, {"c_4": 0.0, "x_42": 0.0, "x_43": 0.0}),
        (rods_are_soft, {"c_4": 4e-6, "x_42": 0.0, "x_43": 0.0}),
        (wrist_is_locked, {"c_4": C[1] + C[2], "x_42": C[1], "x_43": C[2]}),
    ],
)
def test_what_a_linkage_gives_way_is_found_as_it_is(moved, values: dict[str, float]) -> None:
    s = palletiser(moved)
    study = completed_study(prepare(s, default_terms(s)))
    found = next(t for t in study.terms if t.effect.id == LINKAGE.id).estimates
    errors = study.errors_of(LINKAGE.id)
    for name, value in values.items():
        assert abs(found[name].value - value) < 4.0 * errors[name] + 2e-8, name
    torsion = next(t for t in study.terms if t.effect.id == "joint_torsion").estimates
    assert torsion["c_2"].value == pytest.approx(C[1], rel=0.1) and torsion["c_3"].value == pytest.approx(C[2], rel=0.1)


@pytest.mark.parametrize("moved", [rods_are_soft, wrist_is_locked])
def test_a_model_with_the_linkage_predicts_held_out_poses_to_the_noise(moved) -> None:
    s = palletiser(moved)
    plain = validated(s, default_terms(s))
    whole = validated(s, completed_study(plain.study).terms)
    floor = whole.study.observation.whiten.floor
    assert whole.held_out.rms_m < 1.25 * floor and plain.held_out.rms_m > 2.0 * floor
    assert form_evidence(plain.study, whole.study) > 50.0


@pytest.mark.slow
@pytest.mark.parametrize("moved", [rods_hold, rods_are_soft, wrist_is_locked])
def test_no_linkage_is_taken_for_a_missing_effect(moved) -> None:
    verdict = diagnose(palletiser(moved)).verdict
    assert (verdict.status, verdict.effects, verdict.one_of) == ("adequate", (), ()), verdict.text


def test_a_robot_without_passive_joints_has_no_linkage() -> None:
    scene = scene_of(palletiser(rods_hold, 4, passive=False))
    assert LINKAGE.parameters(scene) == ()
    assert LINKAGE.regressor(scene, np.zeros(0)).shape == (len(scene), 3, 0)


def test_a_model_with_a_linkage_is_refused_by_the_live_correction() -> None:
    scene = scene_of(palletiser(rods_hold, 4))
    assert isinstance(LINKAGE.live(scene, np.zeros(3)), Refused)
