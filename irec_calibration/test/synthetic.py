# SPDX-License-Identifier: Apache-2.0
"""A heavy robot and sessions with a known truth, for recovery tests. The truth is a plain function of the rows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from irec_calibration.effects.of_session import scene_of
from irec_calibration.effects.scene import Scene
from irec_calibration.robot import Robot
from irec_calibration.session import Marker, Noise, Session, Station

EFFORT = (7290, 8910, 7759, 2462, 1492, 908)
MASSES = (363.0, 232.0, 182.0, 42.0, 17.0, 107.0)
ORIGINS = ((0, 0, 0.675), (0.35, 0, 0), (0, 0, 1.15), (0.4, 0, 0.041), (0.8, 0, 0), (0.215, 0, 0))
AXES = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0))
COMPLIANCE = np.array([2.5e-7, 2.0e-7, 3.0e-7, 1.0e-6, 1.2e-6, 1.8e-6])
TRANSVERSE = np.array([3e-8, 5e-8, 6e-8, 4e-8, 7e-8, 5e-8, 3e-7, 2e-7, 4e-7, 3e-7, 5e-7, 4e-7])
JOINTS = ((-0.7, 0.1, -0.4, -1.5, 0.4, -1.5), (0.7, 0.8, 0.5, 1.5, 1.3, 1.5))
LOAD_CASES = {1: (0, 0, -1100), 2: (280, 0, -1100), 3: (-280, 0, -1100), 4: (0, -280, -1100), 5: (0, 280, -1100)}


def urdf() -> str:
    """A 6R robot of the size of a KR 120 with its TCP 0.4 m out of the flange; upright at zero."""
    parts = ['<robot name="heavy"><link name="base_link"/>']
    parent = "base_link"
    for k, (xyz, axis, mass) in enumerate(zip(ORIGINS, AXES, MASSES, strict=True), 1):
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="0.1 0 0.1"/><mass value="{mass}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{k}" type="revolute"><parent link="{parent}"/><child link="link_{k}"/>'
            f'<origin xyz="{" ".join(map(str, xyz))}"/><axis xyz="{" ".join(map(str, axis))}"/>'
            f'<limit lower="-3" upper="3" velocity="2" effort="{EFFORT[k - 1]}"/></joint>'
        )
        parent = f"link_{k}"
    parts.append(
        '<link name="flange"/><joint name="to_flange" type="fixed"><parent link="link_6"/><child link="flange"/></joint>'
        '<link name="tool0"/><joint name="to_tool0" type="fixed"><parent link="flange"/><child link="tool0"/>'
        '<origin xyz="0.4 0 0.05" rpy="0 1.5707963 0"/></joint></robot>'
    )
    return "".join(parts)


def session(
    poses: int = 31,
    seed: int = 0,
    noise: Noise | None = None,
    extra: Callable[[Scene], np.ndarray] | None = None,
    compliance: np.ndarray = COMPLIANCE,
    transverse: np.ndarray = TRANSVERSE,
    joints: tuple[tuple[float, ...], tuple[float, ...]] = JOINTS,
    q_of_poses: np.ndarray | None = None,
    lateral: float = 1.0,
    weight: bool = True,
    sags: float = 1.0,
    approach: float = 5e-4,
    aligned: float = 0.0,
    axis_aligned: int = 5,
) -> Session:
    """A loaded session: 18-DOF truth, five load cases a pose, plus what `extra` adds to the marker's displacement.

    Args:
        extra: function of the noise-free scene -> displacement of the marker in base_link, (n, 3), m.
        joints: lowest and highest joint angles of the poses, rad.
        q_of_poses: (poses, 6), rad; drawn where None. lateral: multiple of the forces across the tool.
        weight: whether gravity acts. sags: share of what it bends the arm by on its way that is not commanded away by the
            controller. approach: standard deviation of joint angles from row to row, rad.
        aligned: by how much an axis (`axis_aligned`, counted from 0; the last one turns about the TCP) turns between a reference
            and its load cases, rad.
    """
    rng = np.random.default_rng(seed)
    noise = noise or Noise(tracker_m=7.5e-6, tracker_m_per_m=1.8e-6, force_n=1.0, settling_m=2e-6)
    robot = Robot(urdf())
    rows = 6 * poses
    q_of_poses = rng.uniform(*joints, (poses, 6)) if q_of_poses is None else q_of_poses
    q = np.repeat(q_of_poses, 6, axis=0) + rng.normal(0, approach, (rows, 6))
    case = np.tile(np.arange(6), poses)
    q[:, axis_aligned] += aligned * (case == 0)
    force = np.array([LOAD_CASES.get(int(j), (0, 0, 0)) for j in case], dtype=float)
    force *= np.array([lateral, lateral, 1.0])
    force += np.where(case[:, None] > 0, rng.normal(0, 15.0, (rows, 3)), 0.0)
    kin = robot.kinematics(q)
    station = Station("A", (4.0, -2.0, 1.0), (0.0, 0.0, 0.5**0.5, 0.5**0.5), known=True)
    blank = Session(
        name="synthetic", kind="loaded", robot=robot, serial="S-1", pose=np.repeat(np.arange(1, poses + 1), 6), load_case=case,
        repeat=np.zeros(rows, dtype=np.int64), stamp=np.arange(rows) * 4.0, q=q, p_tcp_in_base=kin.p_tcp,
        p_marker_in_station=np.zeros((rows, 3)), station=np.zeros(rows, dtype=np.int64), stations=(station,),
        marker=np.zeros(rows, dtype=np.int64), markers=(Marker("marker", "tool0", (0.02, 0.0, -0.03)),), force_in_tool=force,
        torque_in_tool=np.zeros((rows, 3)), noise=noise, load_cases=LOAD_CASES, gravity_in_base=(0.0, 0.0, -9.81 * weight),
        meta={"format": "irec-session/1", "name": "synthetic", "kind": "loaded", "robot": {"urdf": "robot.urdf", "serial": "S-1"},
              "marker_in_tool0": [0.02, 0.0, -0.03],
              "stations": [{"name": "A", "xyz": [4.0, -2.0, 1.0], "quat_xyzw": [0.0, 0.0, 0.5**0.5, 0.5**0.5]}],
              "noise": {k: float(v) for k, v in vars(noise).items() if v}},
    )  # fmt: skip
    scene = scene_of(blank)
    # written out on purpose, without the effects under test
    u, sag = np.zeros((rows, 3)), np.zeros((rows, 3))
    for k in range(6):
        lever = scene.p_observed - kin.origin[:, k]
        arm = kin.p_tcp - kin.origin[:, k]
        springs = [(kin.axis[:, k], compliance[k], scene.tau_gravity[:, k])]
        springs += [(kin.virtual_axis[:, k, v], transverse[2 * k + v], scene.gravity.tau_virtual[:, 2 * k + v]) for v in (0, 1)]
        for axis, c, by_weight in springs:
            torque = np.einsum("ni,ni->n", axis, np.cross(arm, scene.force))
            u += c * torque[:, None] * np.cross(axis, lever)
            sag += c * by_weight[:, None] * np.cross(axis, lever)
    u += sags * (sag - sag[6 * (np.arange(rows) // 6)])
    if extra is not None:
        u = u + extra(scene)
    in_base = scene.p_observed + u - np.array(station.xyz)
    p_marker = in_base @ station.R_in_base
    distance = np.linalg.norm(p_marker, axis=1)
    sigma = np.hypot(noise.tracker_m + noise.tracker_m_per_m * distance, noise.settling_m)
    p_marker = p_marker + rng.normal(size=p_marker.shape) * sigma[:, None]
    measured_force = force + rng.normal(size=force.shape) * noise.force_n
    return Session(**{**vars(blank), "p_marker_in_station": p_marker, "force_in_tool": measured_force})
