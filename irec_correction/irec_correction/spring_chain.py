# SPDX-License-Identifier: Apache-2.0
"""The robot as one chain of drives and springs, so that one Pinocchio call gives every column of Eq. (2)-(3).

Each virtual axis of the model becomes a joint of its own that stays at zero: a base spring is six joints below joint 1, a tool
spring three behind the last one. The Jacobian of that chain then holds actuated and virtual axes side by side.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from irec_calibration.robot import Kinematics, Robot
from irec_calibration.typing import Array

BASE_SPRING, TOOL_SPRING = "base", "tool"
BENDING_PLACES = "places"  # of link bending: shifts of each joint along its axis and along its virtual ones


_SHIFTS = ("tz", "ta", "tb")  # behind the number of the joint


@dataclass
class SpringChain:
    """Preallocated chain base_link .. tool0; not to be shared between threads.

    Attributes:
        index: name of a drive (`joint_k`, k from 1), virtual axis (`joint_ka`, `joint_kb`), shift (`joint_ktz`, `joint_kta`,
            `joint_ktb`), base spring (`base_t_x` .. `base_r_z`) or tool spring (`tool_x` ..) -> column of the Jacobian.
        n_joints: driven joints; n_columns: all.
    """

    index: dict[str, int]
    n_joints: int
    n_columns: int
    _model: pin.Model = field(repr=False)
    _data: pin.Data = field(repr=False)
    _tcp: int = field(repr=False)
    _q: Array = field(repr=False)
    _iq: Array = field(repr=False)
    J_at_base: Array = field(repr=False)
    R_tool: Array = field(repr=False)
    p_tcp: Array = field(repr=False)

    def update(self, q: Array) -> None:
        """Bring `J_at_base`, `R_tool` and `p_tcp` to joint angles q (k,), rad. The arrays are overwritten at the next call.

        `J_at_base` (6, n_columns) maps joint rates to the twist [v; w] in base_link of the tool's point that is at the origin of
        base_link just now; `p_tcp` (3,), m, and `R_tool` (3, 3) are tool0 in base_link.
        """
        self._q[self._iq] = q
        pin.computeJointJacobians(self._model, self._data, self._q)
        pin.updateFramePlacement(self._model, self._data, self._tcp)


def springs_with(columns: Iterable[str]) -> frozenset[str]:
    """Which springs a chain must have so that it has these columns, named as in `SpringChain.index`."""
    kinds = {c.partition("_")[0] if not c.endswith(_SHIFTS) else BENDING_PLACES for c in columns}
    return frozenset(kinds & {BASE_SPRING, TOOL_SPRING, BENDING_PLACES})


def build_chain(robot: Robot, springs: frozenset[str] = frozenset(), at_zero: Kinematics | None = None) -> SpringChain:
    """The chain of a robot with two virtual axes per joint and, where named in `springs`, base and tool springs and shifts.

    Args:
        at_zero: where its joints are at joint angles zero (first row), if not where the robot description has them.
    """
    kin = robot.kinematics(np.zeros(robot.n_joints)) if at_zero is None else at_zero
    model, parent, index = pin.Model(), 0, {}
    here = pin.SE3.Identity()

    def add(name: str, joint: pin.JointModel, placement: pin.SE3) -> None:
        nonlocal parent
        parent = model.addJoint(parent, joint, placement, name)
        index[name] = model.joints[parent].idx_v

    if BASE_SPRING in springs:
        for kind, make in (("t", pin.JointModelPrismaticUnaligned), ("r", pin.JointModelRevoluteUnaligned)):
            for letter, direction in zip("xyz", np.eye(3), strict=True):
                add(f"base_{kind}_{letter}", make(direction), pin.SE3.Identity())
    for k in range(robot.n_joints):
        there = pin.SE3(np.array(kin.R_joint[0, k]), np.array(kin.origin[0, k]))
        axis = kin.R_joint[0, k].T @ kin.axis[0, k]
        make = pin.JointModelPrismaticUnaligned if robot.is_prismatic[k] else pin.JointModelRevoluteUnaligned
        add(f"joint_{k + 1}", make(axis), here.actInv(there))
        for letter, direction in zip("ab", kin.virtual_in_joint[k], strict=True):
            add(f"joint_{k + 1}{letter}", pin.JointModelRevoluteUnaligned(direction), pin.SE3.Identity())
        if BENDING_PLACES in springs:
            for letter, direction in zip("zab", (axis, *kin.virtual_in_joint[k]), strict=True):
                add(f"joint_{k + 1}t{letter}", pin.JointModelPrismaticUnaligned(direction), pin.SE3.Identity())
        here = there
    tool = pin.SE3(np.array(kin.R_tool[0]), np.array(kin.p_tcp[0]))
    behind_last = here.actInv(tool)
    if TOOL_SPRING in springs:
        for letter, direction in zip("xyz", np.eye(3), strict=True):
            add(f"tool_{letter}", pin.JointModelPrismaticUnaligned(direction), behind_last)
            behind_last = pin.SE3.Identity()
    tcp = model.addFrame(pin.Frame("tool0", parent, 0, behind_last, pin.FrameType.OP_FRAME))
    data = model.createData()
    iq = np.array([index[f"joint_{k + 1}"] for k in range(robot.n_joints)])
    placement = data.oMf[tcp]
    return SpringChain(
        index=index, n_joints=robot.n_joints, n_columns=model.nv, _model=model, _data=data, _tcp=tcp, _q=np.zeros(model.nq),
        _iq=iq, J_at_base=data.J, R_tool=placement.rotation, p_tcp=placement.translation,
    )  # fmt: skip
