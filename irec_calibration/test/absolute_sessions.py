# SPDX-License-Identifier: Apache-2.0
"""Absolute sessions of a robot with known geometric errors. The truth's kinematics are written out here, joint by joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from irec_calibration.robot import Payload, Robot
from irec_calibration.session import Marker, Noise, Session, Station
from scipy.spatial.transform import Rotation

QUIET = Noise(tracker_m=1e-6)


@dataclass(frozen=True)
class Joint:
    """Fixed transform to the joint (xyz, rpy), its axis, and what it really is off by (m, rad in the joint's frame; zero)."""

    xyz: tuple[float, float, float]
    axis: tuple[float, float, float]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slides: bool = False
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zero: float = 0.0


SIX = (
    Joint((0, 0, 0.4), (0, 0, 1), tilt=(2e-3, -1e-3, 0)),
    Joint((0.1, 0, 0.1), (0, 1, 0), shift=(1e-3, 0, 0.5e-3), zero=4e-3),
    Joint((0, 0, 0.6), (0, 1, 0), shift=(-0.8e-3, 0, 1.2e-3), tilt=(1e-3, 0, 0), zero=-3e-3),
    Joint((0.1, 0, 0.05), (1, 0, 0), zero=2e-3),
    Joint((0.5, 0, 0), (0, 1, 0), zero=-5e-3, shift=(0, 0, 0.4e-3)),
    Joint((0.1, 0, 0), (1, 0, 0)),
)
PLACES = ((0.03, -0.02, 0.1), (0.2, 0.0, 0.1), (-0.1, 0.15, 0.05))
THREE_MARKERS = tuple(Marker(name, "tool0", xyz, known=False) for name, xyz in zip("ABC", PLACES, strict=True))
TOOL = ((0.1, 0.0, 0.05), (0.0, np.pi / 2, 0.0))


def urdf(joints: tuple[Joint, ...]) -> str:
    """Robot description of the nominal robot."""
    parts, parent = ['<robot name="r"><link name="base_link"/>'], "base_link"
    for k, j in enumerate(joints, 1):
        xyz, rpy, axis = (" ".join(map(str, v)) for v in (j.xyz, j.rpy, j.axis))
        parts.append(
            f'<link name="link_{k}"><inertial><origin xyz="0.05 0 0.1"/><mass value="{30 / k}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{k}" type="{"prismatic" if j.slides else "revolute"}"><parent link="{parent}"/>'
            f'<child link="link_{k}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-4" upper="4" velocity="1" effort="300"/></joint>'
        )
        parent = f"link_{k}"
    xyz, rpy = (" ".join(map(str, v)) for v in TOOL)
    parts.append(
        f'<link name="tool0"/><joint name="t" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/></joint></robot>'
    )
    return "".join(parts)


def points(joints: tuple[Joint, ...], q: np.ndarray, marker: tuple[float, float, float]) -> np.ndarray:
    """Where the real robot has a marker on tool0, in base_link, (n, 3), m."""
    out = np.empty((len(q), 3))
    R_tool = Rotation.from_euler("xyz", TOOL[1])
    for i, row in enumerate(q):
        p = np.array(TOOL[0]) + R_tool.apply(marker)
        for j, value in reversed(list(zip(joints, row, strict=True))):
            axis = np.array(j.axis, dtype=float)
            slide = axis * (value + j.zero) if j.slides else np.zeros(3)
            turn = Rotation.from_rotvec(np.zeros(3) if j.slides else axis * value)
            error = Rotation.from_rotvec(np.array(j.tilt) + (0.0 if j.slides else j.zero) * axis)
            p = turn.apply(error.apply(p) + np.array(j.shift)) + slide
            p = np.array(j.xyz) + Rotation.from_euler("xyz", j.rpy).apply(p)
        out[i] = p
    return out


def session(
    joints: tuple[Joint, ...] = SIX,
    poses: int = 120,
    seed: int = 0,
    *,
    noise: Noise = QUIET,
    stations: tuple[Station, ...] = (Station("T", (2.5, -1.0, 0.8), (0.1, -0.2, 0.5, 0.83)),),
    markers: tuple[Marker, ...] = (Marker("M", "tool0", (0.03, -0.02, 0.1), known=False),),
    q: np.ndarray | None = None,
    stated: bool = False,
    moved: object = None,
) -> Session:
    """Every marker measured from its station in every pose; stations and markers given are the truth.

    Args:
        stated: the session states the true poses; else stations and markers are unknown and stated at the origin.
        moved: function (session, p (n, 3)) -> what the marker is displaced by besides, (n, 3), m.
    """
    rng = np.random.default_rng(seed)
    robot = Robot(urdf(joints))
    q = rng.uniform(-1.3, 1.3, (poses, len(joints))) if q is None else q
    poses = len(q)
    n = poses * len(markers)
    each = np.repeat(np.arange(poses), len(markers))
    marker = np.tile(np.arange(len(markers)), poses)
    station = rng.integers(0, len(stations), n)
    p = np.empty((n, 3))
    for i, m in enumerate(markers):
        p[marker == i] = points(joints, q, m.xyz) if m.link == "tool0" else np.array(m.xyz)
    kin = robot.kinematics(q[each])
    base = Session(
        name="absolute", kind="absolute", robot=robot, serial="R", pose=each + 1, load_case=np.zeros(n, dtype=np.int64),
        repeat=np.zeros(n, dtype=np.int64), stamp=each * 5.0, q=q[each], p_tcp_in_base=kin.p_tcp,
        p_marker_in_station=np.zeros((n, 3)), station=station, stations=stations, marker=marker, markers=markers,
        force_in_tool=np.zeros((n, 3)), torque_in_tool=np.zeros((n, 3)),
        noise=noise, has_tcp=False, payload=Payload(5.0), meta={"kind": "absolute"},
    )  # fmt: skip
    if callable(moved):
        p = p + moved(base, p)
    seen = np.empty((n, 3))
    for i, s in enumerate(stations):
        seen[station == i] = (p[station == i] - np.array(s.xyz)) @ s.R_in_base
    seen += rng.normal(size=(n, 3)) * noise.tracker_m
    if not stated:
        stations = tuple(s if s.known else Station(s.name, stated=False, level=s.level) for s in stations)
        markers = tuple(m if m.known else Marker(m.name, m.link, known=False) for m in markers)
    else:
        stations, markers = tuple(replace(s, known=True) for s in stations), tuple(replace(m, known=True) for m in markers)
    return replace(base, p_marker_in_station=seen, stations=stations, markers=markers)


def torsion(c: np.ndarray):
    """A displacement by compliances c (k,), rad/(N m), under gravity, for `session(moved=...)`."""

    def moved(s, p):
        tau = s.robot.gravity_torque(s.q, s.gravity_in_base, s.payload)
        J = s.robot.kinematics(s.q).jacobian(p)
        return np.einsum("nik,nk->ni", J, tau * c)

    return moved
