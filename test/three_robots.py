# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions written from public data sheets, with the joint names and frames that their vendors use.

Lengths, ranges and speeds: Universal Robots, UR10e parameters for kinematics and dynamics; Franka Emika, Panda data sheet
(modified DH parameters); ABB, IRB 6700-200/2.60 product specification. Masses of single links and, for the ABB, rated torques are
estimates from total mass and rated load; nothing here rests on them but the size of the elastic deflection.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

PI = math.pi


@dataclass(frozen=True)
class Joint:
    """xyz, rpy: frame in the one before; limits rad, rad/s, N m; mass of the link behind it, kg."""

    name: str
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    axis: tuple[int, int, int]
    lower: float
    upper: float
    velocity: float
    effort: float
    mass: float


def urdf(
    name: str, base: str, joints: list[Joint], flange: str, flange_xyz: tuple[float, ...], flange_rpy: tuple[float, ...]
) -> str:
    """A description base .. flange with a `world` above, as vendors deliver it: no tool0, no base_link unless so named."""
    out = [f'<robot name="{name}"><link name="world"/><link name="{base}"/>',
           f'<joint name="world_fixed" type="fixed"><parent link="world"/><child link="{base}"/></joint>']  # fmt: skip
    parent = base
    for j in joints:
        link = f"{j.name}_link"
        inertia = 0.02 * j.mass
        out.append(
            f'<link name="{link}"><inertial><origin xyz="0 0 0.05"/><mass value="{j.mass}"/>'
            f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{j.name}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{" ".join(map(str, j.xyz))}" rpy="{" ".join(map(str, j.rpy))}"/>'
            f'<axis xyz="{" ".join(map(str, j.axis))}"/>'
            f'<limit lower="{j.lower}" upper="{j.upper}" velocity="{j.velocity}" effort="{j.effort}"/></joint>'
        )
        parent = link
    out.append(
        f'<link name="{flange}"/><joint name="{flange}_fixed" type="fixed"><parent link="{parent}"/><child link="{flange}"/>'
        f'<origin xyz="{" ".join(map(str, flange_xyz))}" rpy="{" ".join(map(str, flange_rpy))}"/></joint></robot>'
    )
    return "\n".join(out)


def ur10e() -> str:
    """Six axes, 12.5 kg; the frame of the flange is called tool0 by the vendor's own description too."""
    z, full = (0, 0, 1), 2 * PI
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    frames = (
        ((0, 0, 0.1807), (0, 0, 0)), ((0, 0, 0), (PI / 2, 0, 0)), ((-0.6127, 0, 0), (0, 0, 0)),
        ((-0.57155, 0, 0.17415), (0, 0, 0)),
        ((0, -0.11985, 0), (PI / 2, 0, 0)), ((0, 0.11655, 0), (-PI / 2, 0, 0)),
    )  # fmt: skip
    effort, mass = (330, 330, 150, 54, 54, 54), (7.369, 13.051, 3.989, 2.1, 1.98, 0.615)
    speed = (2.0944, 2.0944, 3.1416, 3.1416, 3.1416, 3.1416)
    joints = [
        Joint(f"{n}_joint", xyz, rpy, z, -PI if n == "elbow" else -full, PI if n == "elbow" else full, v, e, m)  # type: ignore[arg-type]
        for n, (xyz, rpy), v, e, m in zip(names, frames, speed, effort, mass, strict=True)
    ]
    return urdf("ur10e", "base_link", joints, "tool0", (0, 0, 0), (0, 0, 0))


def panda() -> str:
    """Seven axes, 3 kg; the frame of the flange is panda_link8."""
    h = PI / 2
    frames = (
        ((0, 0, 0.333), (0, 0, 0)), ((0, 0, 0), (-h, 0, 0)), ((0, -0.316, 0), (h, 0, 0)), ((0.0825, 0, 0), (h, 0, 0)),
        ((-0.0825, 0.384, 0), (-h, 0, 0)), ((0, 0, 0), (h, 0, 0)), ((0.088, 0, 0), (h, 0, 0)),
    )  # fmt: skip
    limits = ((-2.8973, 2.8973), (-1.7628, 1.7628), (-2.8973, 2.8973), (-3.0718, -0.0698), (-2.8973, 2.8973), (-0.0175, 3.7525),
              (-2.8973, 2.8973))  # fmt: skip
    mass = (3.4, 3.4, 3.2, 3.2, 3.2, 1.2, 0.6)
    joints = [
        Joint(f"panda_joint{k + 1}", xyz, rpy, (0, 0, 1), low, high, 2.175 if k < 4 else 2.61, 87 if k < 4 else 12, mass[k])  # type: ignore[arg-type]
        for k, ((xyz, rpy), (low, high)) in enumerate(zip(frames, limits, strict=True))
    ]
    return urdf("panda", "panda_link0", joints, "panda_link8", (0, 0, 0.107), (0, 0, 0))


def irb6700() -> str:
    """Six axes, 200 kg, 2.6 m; the flange has x out of the arm, as ABB's descriptions have it."""
    d = PI / 180
    frames = ((0, 0, 0.78), (0.32, 0, 0), (0, 0, 1.125), (0, 0, 0.2), (1.1425, 0, 0), (0.2, 0, 0))
    axes = ((0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0))
    limits = ((-170, 170), (-65, 85), (-180, 70), (-300, 300), (-130, 130), (-360, 360))
    speed, effort, mass = (110, 110, 110, 190, 150, 210), (7000, 9000, 6000, 1900, 1700, 900), (400, 300, 250, 100, 40, 20)
    joints = [
        Joint(
            f"joint_{k + 1}", frames[k], (0, 0, 0), axes[k], limits[k][0] * d, limits[k][1] * d, speed[k] * d, effort[k], mass[k]
        )  # type: ignore[arg-type]
        for k in range(6)
    ]
    return urdf("irb6700", "abb_base", joints, "flange", (0, 0, 0), (0, 0, 0))
