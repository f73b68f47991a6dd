# SPDX-License-Identifier: Apache-2.0
"""The robot as its description states it: URDF reader, forward kinematics, Jacobian, inverse kinematics.

Written for the simulator only and batched over n configurations. All positions and axes are in base_link, SI units.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import SimError
from .files import read_text

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int_]


def skew(v: Array) -> Array:
    """Cross-product matrices of vectors (..., 3), shape (..., 3, 3)."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def rotation(axis: Array, angle: float | Array) -> Array:
    """Rotation matrices about unit vectors (..., 3) by angles (...), rad (Rodrigues)."""
    K = skew(np.asarray(axis, dtype=float))
    a = np.asarray(angle, dtype=float)[..., None, None]
    return np.eye(3) + np.sin(a) * K + (1.0 - np.cos(a)) * (K @ K)


def rotation_of_vector(v: Array) -> Array:
    """Rotation matrices of rotation vectors (..., 3), rad."""
    angle = np.linalg.norm(v, axis=-1)
    unit = v / np.maximum(angle, 1e-300)[..., None]
    return rotation(unit, angle)


def rotation_of_rpy(rpy: Array) -> Array:
    """Rotation of URDF roll, pitch, yaw (fixed axes x, y, z), rad."""
    r, p, y = rpy
    x, yy, z = np.eye(3)
    return rotation(z, y) @ rotation(yy, p) @ rotation(x, r)


def rotation_vector(R: Array) -> Array:
    """Rotation vectors (..., 3) of matrices (..., 3, 3) that turn by less than pi, rad."""
    w = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    s = np.linalg.norm(w, axis=-1)
    c = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    return w * (np.arctan2(s, c) / np.maximum(s, 1e-12))[..., None]


def rotation_of_quaternion(q_xyzw: Array) -> Array:
    """Rotation matrix of a quaternion (x, y, z, w); it is normalised first."""
    x, y, z, w = np.asarray(q_xyzw, dtype=float) / np.linalg.norm(q_xyzw)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of_rotation(R: Array) -> Array:
    """Quaternion (x, y, z, w), w >= 0, of a rotation matrix."""
    K = np.array(
        [
            [R[0, 0] - R[1, 1] - R[2, 2], 0.0, 0.0, 0.0],
            [R[1, 0] + R[0, 1], R[1, 1] - R[0, 0] - R[2, 2], 0.0, 0.0],
            [R[2, 0] + R[0, 2], R[2, 1] + R[1, 2], R[2, 2] - R[0, 0] - R[1, 1], 0.0],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R[0, 0] + R[1, 1] + R[2, 2]],
        ]
    )
    q = np.linalg.eigh(K)[1][:, -1]
    return q if q[3] >= 0.0 else -q


@dataclass(frozen=True)
class Chain:
    """Serial chain of n revolute joints base_link .. tool0.

    Attributes:
        joint_names: of the n joints.
        R_fixed, p_fixed: pose of each joint's frame at angle 0 in the frame of the joint before, (n, 3, 3), (n, 3) m.
        axis: unit vector of each axis in its joint's frame, (n, 3).
        lower, upper: rad; velocity: rad/s; effort: N m; each (n,).
        mass, com: of each moving link with what is fixed to it, without the tool, (n,) kg and (n, 3) m in its frame.
        R_mount, p_mount: tool mount (link `tool` where there is one, else tool0) in the last joint's frame.
        tool_mass, tool_com: of what sits beyond the mount, kg and m in the mount's frame.
        R_tcp, p_tcp: tool0 in the mount's frame.
        text: the URDF.
    """

    joint_names: tuple[str, ...]
    R_fixed: Array
    p_fixed: Array
    axis: Array
    lower: Array
    upper: Array
    velocity: Array
    effort: Array
    mass: Array
    com: Array
    R_mount: Array
    p_mount: Array
    tool_mass: float
    tool_com: Array
    R_tcp: Array
    p_tcp: Array
    text: str

    @property
    def n(self) -> int:
        return len(self.joint_names)


def _vector(element: ElementTree.Element | None, key: str, default: str) -> Array:
    return np.array([float(v) for v in (element.get(key, default) if element is not None else default).split()])


def read_urdf(path: str | Path) -> Chain:
    """Read a robot description.

    Raises:
        SimError: not XML, no path base_link .. tool0, or a moving joint that is not revolute.
    """
    try:
        text = read_text(path, "robot description")
        return _chain(text, ElementTree.fromstring(text), path)
    except (ElementTree.ParseError, AttributeError, ValueError, TypeError) as error:
        raise SimError(f"{path}: not a robot description that can be read: {error}") from error


def _chain(text: str, root: ElementTree.Element, path: str | Path) -> Chain:
    joints = {j.find("child").get("link"): j for j in root.findall("joint")}  # type: ignore[union-attr]
    path_up: list[ElementTree.Element] = []
    link: str | None = "tool0"
    while link != "base_link":
        if link not in joints:
            raise SimError(f"{path}: no path from base_link to tool0 (stops at link '{link}')")
        if len(path_up) > 200:
            raise SimError(f"{path}: the links on the way from tool0 to base_link form a circle")
        path_up.append(joints[link])
        link = joints[link].find("parent").get("link")  # type: ignore[union-attr]
    names, R_fixed, p_fixed, axis, limits = [], [], [], [], []
    R, p = np.eye(3), np.zeros(3)
    mount: tuple[Array, Array] | None = None
    owner: dict[str, tuple[int, Array, Array]] = {"base_link": (-1, R, p)}
    for j in reversed(path_up):
        origin = j.find("origin")
        p = p + R @ _vector(origin, "xyz", "0 0 0")
        R = R @ rotation_of_rpy(_vector(origin, "rpy", "0 0 0"))
        child = j.find("child").get("link") or ""  # type: ignore[union-attr]
        if j.get("type") != "fixed":
            if j.get("type") not in ("revolute", "continuous"):
                raise SimError(f"{path}: joint '{j.get('name')}' is {j.get('type')}; the plant has revolute joints only")
            a = _vector(j.find("axis"), "xyz", "1 0 0")
            limit = j.find("limit")
            default = {"lower": "-6.3", "upper": "6.3", "velocity": "3", "effort": "1e4"}
            limits.append([float(limit.get(k, d) if limit is not None else d) for k, d in default.items()])
            names.append(j.get("name", ""))
            R_fixed.append(R)
            p_fixed.append(p)
            axis.append(a / np.linalg.norm(a))
            R, p = np.eye(3), np.zeros(3)
        elif child == "tool":
            mount = (R, p)
        owner[child] = (len(names) - 1, R, p)
    R_mount, p_mount = mount if mount is not None else (R, p)
    n = len(names)
    if n == 0:
        raise SimError(f"{path}: no moving joint between base_link and tool0")
    mass, first = np.zeros(n), np.zeros((n, 3))
    tool_mass, tool_first = 0.0, np.zeros(3)
    for element in root.findall("link"):
        inertial = element.find("inertial")
        name = element.get("name", "")
        if inertial is None or name not in owner or owner[name][0] < 0:
            continue
        m = float(inertial.find("mass").get("value", "0"))  # type: ignore[union-attr]
        k, R_link, p_link = owner[name]
        c = p_link + R_link @ _vector(inertial.find("origin"), "xyz", "0 0 0")
        if name in ("tool", "tool0"):
            tool_mass, tool_first = tool_mass + m, tool_first + m * (R_mount.T @ (c - p_mount))
        else:
            mass[k], first[k] = mass[k] + m, first[k] + m * c
    lower, upper, velocity, effort = np.array(limits).T
    return Chain(
        tuple(names), np.array(R_fixed), np.array(p_fixed), np.array(axis), lower, upper, velocity, effort,
        mass, first / np.maximum(mass, 1e-12)[:, None], R_mount, p_mount, tool_mass, tool_first / max(tool_mass, 1e-12),
        R_mount.T @ R, R_mount.T @ (p - p_mount), text,
    )  # fmt: skip


@dataclass(frozen=True)
class Pose:
    """Where the rigid chain is: p_tcp (n, 3) m, R_tool (n, 3, 3), axis and origin of each joint (n, joints, 3)."""

    p_tcp: Array
    R_tool: Array
    axis: Array
    origin: Array

    def jacobian(self) -> Array:
        """Twist of tool0 (linear, angular) per joint rate, (n, 6, joints)."""
        linear = np.cross(self.axis, self.p_tcp[:, None, :] - self.origin)
        return np.concatenate([linear, self.axis], axis=2).swapaxes(1, 2)


def forward(chain: Chain, q: Array) -> Pose:
    """Rigid forward kinematics of q (n, joints), rad."""
    local = chain.R_fixed @ rotation(chain.axis, q)
    R, p = np.eye(3), np.zeros(3)
    axes, origins = [], []
    for k in range(chain.n):
        p = p + R @ chain.p_fixed[k]
        R = R @ local[:, k]
        axes.append(R @ chain.axis[k])
        origins.append(np.broadcast_to(p, (len(q), 3)))
    p = p + R @ chain.p_mount
    R = R @ chain.R_mount
    return Pose(p + R @ chain.p_tcp, R @ chain.R_tcp, np.stack(axes, 1), np.stack(origins, 1))


def inverse(chain: Chain, p_goal: Array, R_goal: Array, q_start: Array, iterations: int = 60) -> tuple[Array, BoolArray]:
    """Numerical inverse kinematics, damped Newton from the start values.

    Args:
        p_goal, R_goal: wanted tool0 in base_link, (n, 3) and (n, 3, 3).
        q_start: (n, joints).

    Returns:
        q (n, joints) and a mask (n,) of those that reached the goal within 1e-9 m and rad and the joint limits.
    """
    q = np.array(q_start, dtype=float)
    for _ in range(iterations):
        pose = forward(chain, q)
        turn = rotation_vector(R_goal @ pose.R_tool.swapaxes(1, 2))
        error = np.concatenate([p_goal - pose.p_tcp, turn], axis=1)
        size = np.abs(error).max(axis=1)
        if size.max() < 1e-11:
            break
        J = pose.jacobian()
        damping = np.minimum(1e-4, size**2)[:, None, None] * np.eye(6)
        step = (J.swapaxes(1, 2) @ np.linalg.solve(J @ J.swapaxes(1, 2) + damping, error[:, :, None]))[:, :, 0]
        step *= np.minimum(1.0, 0.4 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
        q += step
    pose = forward(chain, q)
    turn = rotation_vector(R_goal @ pose.R_tool.swapaxes(1, 2))
    reached = (np.abs(p_goal - pose.p_tcp).max(axis=1) < 1e-9) & (np.abs(turn).max(axis=1) < 1e-9)
    return q, reached & (q > chain.lower).all(axis=1) & (q < chain.upper).all(axis=1)
