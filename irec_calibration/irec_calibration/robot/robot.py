# SPDX-License-Identifier: Apache-2.0
"""Kinematics and gravity of a serial robot from its URDF, by Pinocchio, batched over the rows of a session.

All positions and axes are in `base_link`, SI units.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..errors import RobotError
from ..files.regular import URDF_LIMIT, read_text
from ..typing import Array, BoolArray, IntArray
from .description import completed
from .kinematics import Kinematics


@dataclass(frozen=True)
class Payload:
    """Extra mass fixed to `tool0`.

    Attributes:
        mass: kg.
        com: centre of mass in `tool0`, shape (3,), m.
    """

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Robot:
    """A serial chain base_link .. tool0 with joints of one degree of freedom each."""

    def __init__(self, urdf_text: str, source: str = "<text>") -> None:
        """Build from URDF text.

        Args:
            urdf_text: the description; joints on the path from `base_link` to `tool0` are the robot's.
            source: where the text came from, for messages.

        Raises:
            RobotError: not a URDF, links missing, a mass that can't be, or no moving joint on the path.
        """
        self.urdf_text = urdf_text
        self.source = source
        self.sha256 = hashlib.sha256(urdf_text.encode()).hexdigest()
        try:
            root = ElementTree.fromstring(urdf_text)
        except (ElementTree.ParseError, ValueError, RecursionError) as error:
            raise RobotError(f"{source}: not a robot description (URDF): {error}") from error
        self._declared = {j.get("name"): j.get("type") for j in root.findall("joint")}
        self.completed_urdf = completed(urdf_text, root, source)  # what Pinocchio reads
        try:
            self._model = pin.buildModelFromXML(self.completed_urdf)
        except Exception as error:  # Pinocchio raises plain RuntimeError or ValueError
            raise RobotError(f"{source}: not a robot description that can be read: {_unread(urdf_text) or error}") from error
        self._data = self._model.createData()
        for link in ("base_link", "tool0"):
            if not self._model.existFrame(link):
                raise RobotError(f"{source}: link '{link}' is missing; session format needs base_link .. tool0")
        self.name = self._model.name
        self._tcp = self._model.getFrameId("tool0")
        self._base = self._model.getFrameId("base_link")
        self._joints = self._path_joints()
        self.n_joints = len(self._joints)
        if self.n_joints == 0:
            raise RobotError(f"{source}: no moving joint between base_link and tool0")
        m = self._model
        self.joint_names = tuple(m.names[j] for j in self._joints)
        self._iq = np.array([m.joints[j].idx_q for j in self._joints])
        self._iv = np.array([m.joints[j].idx_v for j in self._joints])
        self._continuous = np.array([m.joints[j].nq == 2 for j in self._joints])
        limited = ~self._continuous
        self.lower = np.where(limited, m.lowerPositionLimit[self._iq], -np.inf)
        self.upper = np.where(limited, m.upperPositionLimit[self._iq], np.inf)
        self.velocity = np.array(m.velocityLimit[self._iv])
        self.effort = np.array(m.effortLimit[self._iv])
        axes, self.is_prismatic = self._axes_in_joint()
        self._axis_in_joint = axes
        self._virtual_in_joint = np.stack([_orthogonal_pair(a) for a in axes])
        self._last: tuple[object, Kinematics] = (None, None)  # type: ignore[assignment]

    @classmethod
    def from_urdf(cls, path: str | Path) -> Robot:
        """Read a URDF file. Raises RobotError when it can't be read."""
        return cls(read_text(path, "robot description", RobotError, URDF_LIMIT), str(path))

    def has_link(self, name: str) -> bool:
        """Whether the description has a link of this name."""
        return bool(self._model.existBodyName(name))

    def _path_joints(self) -> list[int]:
        m = self._model
        stop = parent_joint(m.frames[self._base])
        joint, path = parent_joint(m.frames[self._tcp]), []
        while joint not in (stop, 0):
            path.append(joint)
            joint = m.parents[joint]
        if joint != stop:
            raise RobotError(f"{self.source}: tool0 is not downstream of base_link")
        path.reverse()
        for j in path:
            if m.joints[j].nv != 1:
                raise RobotError(f"{self.source}: joint '{m.names[j]}' has {m.joints[j].nv} degrees of freedom, 1 allowed")
        return path

    def _axes_in_joint(self) -> tuple[Array, BoolArray]:
        axes, prismatic = [], []
        q0 = pin.neutral(self._model)
        for j, name in zip(self._joints, self.joint_names, strict=True):
            data = self._model.createData()
            v = np.zeros(self._model.nv)
            v[self._model.joints[j].idx_v] = 1.0
            pin.forwardKinematics(self._model, data, q0, v)
            slides = self._declared.get(name) == "prismatic"
            twist = pin.getVelocity(self._model, data, j, pin.ReferenceFrame.LOCAL)
            axes.append(twist.linear if slides else twist.angular)
            prismatic.append(slides)
        return np.array(axes), np.array(prismatic)

    @cached_property
    def branch_joints(self) -> tuple[str, ...]:
        """Names of moving joints of one degree of freedom that are not on the path to tool0: they move masses only."""
        m = self._model
        return tuple(m.names[j] for j in range(1, m.njoints) if j not in self._joints and m.joints[j].nv == 1)

    def _full_q(self, q: Array, branches: dict[str, float] | None = None) -> Array:
        full = pin.neutral(self._model)
        for name, value in (branches or {}).items():
            joint = self._model.joints[self._model.getJointId(name)]
            full[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(value), np.sin(value)) if joint.nq == 2 else value
        for i, (iq, continuous) in enumerate(zip(self._iq, self._continuous, strict=True)):
            if continuous:
                full[iq : iq + 2] = np.cos(q[i]), np.sin(q[i])
            else:
                full[iq] = q[i]
        return full

    def kinematics(self, q: Array) -> Kinematics:
        """Forward kinematics of every row.

        Args:
            q: joint angles, shape (n, k), rad (m for prismatic joints).

        Raises:
            RobotError: wrong number of columns.
        """
        q = np.atleast_2d(np.asarray(q, dtype=float))
        if q.shape[1] != self.n_joints:
            raise RobotError(f"{self.source}: {q.shape[1]} joint values given, the robot has {self.n_joints}")
        key = (q.shape, hash(q.tobytes()))
        if self._last[0] == key:
            return self._last[1]
        distinct, index = _distinct(q)  # markers of one pose share their joint angles
        n, k = distinct.shape
        origin, R_joint = np.empty((n, k, 3)), np.empty((n, k, 3, 3))
        p_tcp, R_tool = np.empty((n, 3)), np.empty((n, 3, 3))
        model, data, tcp, base = self._model, self._data, self._tcp, self._base
        for row in range(n):
            pin.forwardKinematics(model, data, self._full_q(distinct[row]))
            T_base = pin.updateFramePlacement(model, data, base)
            T = T_base.actInv(pin.updateFramePlacement(model, data, tcp))
            p_tcp[row], R_tool[row] = T.translation, T.rotation
            for i, j in enumerate(self._joints):
                T = T_base.actInv(data.oMi[j])
                origin[row, i], R_joint[row, i] = T.translation, T.rotation
        axis = np.einsum("nkij,kj->nki", R_joint, self._axis_in_joint)
        axis, origin, R_joint, p_tcp, R_tool = (a[index] for a in (axis, origin, R_joint, p_tcp, R_tool))
        for a in (axis, origin, R_joint, p_tcp, R_tool):
            a.setflags(write=False)
        found = Kinematics(axis, origin, R_joint, p_tcp, R_tool, self.is_prismatic, self._virtual_in_joint)
        self._last = (key, found)  # reading, gravity and scene ask for the same rows one after the other
        return found

    @cached_property
    def moved_masses(self) -> Array:
        """Mass of the link that each joint moves, with what is fixed to it, shape (k,), kg; 0 where none is given."""
        return np.array([self._model.inertias[j].mass for j in self._joints])

    @cached_property
    def tool_mass(self) -> float:
        """Mass of what is fixed to the link that the last joint moves, kg: of a tool, where the description has one.

        A link called flange is the robot's.
        """
        frames = self._model.frames
        child = {f.parentFrame: f.name for f in frames if f.type == pin.FrameType.BODY}
        fixed = [i for i, f in enumerate(frames) if f.type == pin.FrameType.FIXED_JOINT and f.parentJoint == self._joints[-1]]
        return sum(float(frames[i].inertia.mass) for i in fixed if "flange" not in child.get(i, "").lower())

    @cached_property
    def reach(self) -> float:
        """Length of the chain from base_link to tool0, with the stroke of joints that slide, m; it reaches no farther."""
        m = self._model
        lengths = [float(np.linalg.norm(m.jointPlacements[j].translation)) for j in self._joints]
        stroke = np.where(self.is_prismatic & np.isfinite(self.upper - self.lower), self.upper - self.lower, 0.0)
        return sum(lengths) + float(np.linalg.norm(m.frames[self._tcp].placement.translation)) + float(stroke.sum())

    def gravity_torque(
        self,
        q: Array,
        gravity_in_base: Array | tuple[float, float, float] = (0.0, 0.0, -9.81),
        payload: Payload | None = None,
        branches: dict[str, Array] | None = None,
    ) -> Array:
        """Torque that gravity exerts about each axis, shape (n, k), N m (N for prismatic joints).

        Args:
            q: shape (n, k), rad.
            gravity_in_base: acceleration of free fall in base_link, m/s^2.
            payload: extra mass on tool0.
        """
        kin = self.kinematics(q)
        force, moment = self.gravity_wrench(q, gravity_in_base, payload, branches)
        carried = np.where(self.is_prismatic[None, :, None], force, moment)
        return np.einsum("nki,nki->nk", kin.axis, carried)

    def gravity_wrench(
        self,
        q: Array,
        gravity_in_base: Array | tuple[float, float, float] = (0.0, 0.0, -9.81),
        payload: Payload | None = None,
        branches: dict[str, Array] | None = None,
    ) -> tuple[Array, Array]:
        """Weight of everything that each joint carries, and its moment about the joint's origin, in base_link.

        Args:
            q: shape (n, k), rad.
            gravity_in_base: m/s^2.
            payload: extra mass on tool0.
            branches: name of a joint off the path (`branch_joints`) -> its position, (n,), rad or m; 0 where not given.

        Returns:
            force (n, k, 3), N, and moment (n, k, 3), N m.
        """
        q = np.atleast_2d(np.asarray(q, dtype=float))
        model = self._model
        if payload is not None and payload.mass > 0.0:
            model = model.copy()
            frame = model.frames[self._tcp]
            inertia = pin.Inertia(payload.mass, np.asarray(payload.com, dtype=float), np.zeros((3, 3)))
            model.appendBodyToJoint(parent_joint(frame), inertia, frame.placement)
        data = model.createData()
        g = np.asarray(gravity_in_base, dtype=float)
        names = list(branches or {})
        together = np.column_stack([q, *(np.nan_to_num((branches or {})[n]) for n in names)])
        distinct, index = _distinct(together)
        mass, arm = np.empty((len(distinct), self.n_joints)), np.empty((len(distinct), self.n_joints, 3))
        for row in range(len(distinct)):
            others = dict(zip(names, distinct[row, self.n_joints :].tolist(), strict=True))
            pin.centerOfMass(model, data, self._full_q(distinct[row, : self.n_joints], others), True)
            R_base = pin.updateFramePlacement(model, data, self._base).rotation
            for i, j in enumerate(self._joints):
                mass[row, i] = data.mass[j]
                arm[row, i] = R_base.T @ (data.oMi[j].rotation @ data.com[j])
        arm[mass == 0.0] = 0.0  # without any mass there is no centre of it: Pinocchio's is not a number
        force = mass[:, :, None] * g
        moment = np.cross(arm, force)
        return force[index], moment[index]


def _distinct(q: Array) -> tuple[Array, IntArray]:
    """Distinct rows and where each row is among them."""
    rows, index = np.unique(q, axis=0, return_inverse=True)
    return rows, index.ravel()


def _unread(urdf_text: str) -> str:
    """Why Pinocchio, which names no reason, can't read a description that is XML; empty where it is not known."""
    if "${" in urdf_text or "<xacro:" in urdf_text:
        return "it holds xacro expressions, as ${...}; expand it first: xacro robot.urdf.xacro > robot.urdf"
    for joint in ElementTree.fromstring(urdf_text).iter("joint"):
        if joint.get("type") in ("revolute", "prismatic") and joint.find("limit") is None:
            return f"joint '{joint.get('name')}' is {joint.get('type')} and has no <limit lower= upper= effort= velocity=>"
    return ""


def parent_joint(frame: pin.Frame) -> int:
    """Index of the joint that carries a frame; Pinocchio 2, the one with wheels for numpy 1, calls it `parent`."""
    return int(frame.parentJoint if hasattr(frame, "parentJoint") else frame.parent)


def _orthogonal_pair(axis: Array) -> Array:
    """Two unit vectors orthogonal to a joint axis, along coordinate axes of the joint frame where that is possible."""
    axis = axis / np.linalg.norm(axis)
    dominant = int(np.argmax(np.abs(axis)))
    pair: list[Array] = []
    for other in (d for d in range(3) if d != dominant):
        e = np.zeros(3)
        e[other] = 1.0
        for known in (axis, *pair):
            e -= (e @ known) * known
        pair.append(e / np.linalg.norm(e))
    return np.array(pair)
