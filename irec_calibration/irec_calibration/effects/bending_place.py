# SPDX-License-Identifier: Apache-2.0
"""Links bend about points of their own, not about the origins of the joints in the robot description."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from ..robot import Robot
from ..typing import Array, IntArray
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .scales import typical_compliance
from .scene import Scene
from .traits import Family

# Where a casting or a bearing gives way is off the origin that the description has by this share of the arm's length: 3 cm of
# an arm of 3 m
TYPICAL_OFFSET = 0.01
# A drive turns about its own axis. With a link that bends in the plane of the arm, at half its length and by a sixth of what the
# drive gives way, the place is this share of the way to the next axis; what holds a drive is off by a centimetre at least.
SHARE_OF_LINK, LEAST_OFFSET = 0.08, 0.01
ALONG = "z"  # the joint's own axis, in names of parameters
ACROSS = ("a", "b")


class BendingPlace(Effect):
    id = "bending_place"
    label = "place of bending"
    physics = (
        "The springs of joint_torsion and link_bending sit beside the URDF origins of the joints: a link bends over its "
        "length, in the plane of the arm too, where that looks like a softer drive. About an axis a through a point d off the "
        "origin a force f turns the link by c (tau - f . (a x d)), and the TCP moves by that angle times (a x r - a x d): to "
        "first order in d two coupling terms, m (V_a (e . f) + e tau_a) for each of two directions e across a, "
        "m = -c (a x d) . e, the larger the softer the spring is. Every robot has it to some extent; missing, it leaves some ten "
        "micrometres that pass for tool_compliance or base_compliance."
    )
    family = Family.SPRING
    elastic = True
    completes = "link_bending"
    needs = ("load",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if scene.kind == "absolute":  # under gravity the force that acts beyond a joint is another one for each joint
            return ()
        soft = typical_compliance(scene.robot)
        across = TYPICAL_OFFSET * _lengths(scene.robot).sum() * soft
        far = {"a": across, "b": across, ALONG: _offset_of_drives(scene.robot) * soft}
        return tuple(
            Parameter(
                f"m_{k + 1}{axis}{e}", "m/(N m)", float(far[axis][k]), plausible=(-3.0 * float(soft[k]), 3.0 * float(soft[k])),
                group=f"axis {k + 1}", axis=k, goes_with=f"c_{k + 1}{axis if axis != ALONG else ''}",
                level="in the plane" if axis == ALONG else "across",
            )
            for k, axis, e in _springs(scene)
        )  # fmt: skip

    def regressor(self, scene: Scene, theta: Array) -> Array:
        n, k = len(scene), scene.n_joints
        tau = scene.load_torque_virtual().reshape(n, k, 2)
        V = scene.V.reshape(n, 3, k, 2)
        across, along = scene.kin.virtual_axis, scene.kin.axis
        moves = scene.moves_with_arm[:, None]
        bent = np.empty((n, 3, k, 2, 2))
        for v in range(2):
            for i, e in enumerate((along, across[:, :, 1 - v])):
                pushed = np.einsum("nki,ni->nk", e, scene.force)
                bent[:, :, :, v, i] = V[:, :, :, v] * pushed[:, None] + e.swapaxes(1, 2) * (tau[:, :, v] * moves)[:, None]
        turning = _turning(scene)
        turned = np.empty((n, 3, len(turning), 2))
        by_drive = scene.load_torque()[:, turning] * moves
        for i in range(2):
            e = across[:, turning, i]
            pushed = np.einsum("nki,ni->nk", e, scene.force)
            turned[:, :, :, i] = scene.J[:, :, turning] * pushed[:, None] + e.swapaxes(1, 2) * by_drive[:, None]
        return np.concatenate([bent.reshape(n, 3, -1), turned.reshape(n, 3, -1)], axis=2)

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        entries = []
        for (k, axis, e), m in zip(_springs(scene), theta, strict=True):
            turns, shifts = f"joint_{k + 1}{axis if axis != ALONG else ''}", f"joint_{k + 1}t{e}"
            entries += [(turns, shifts, float(m)), (shifts, turns, float(m))]
        return Springs(tuple(entries))


@lru_cache(maxsize=16)
def _lengths(robot: Robot) -> Array:
    """From each joint to the next one, from the last one to the TCP, (k,), m; of a joint that slides none."""
    kin = robot.kinematics(np.zeros((1, robot.n_joints)))
    following = np.concatenate([kin.origin[0, 1:], kin.p_tcp])
    return np.asarray(np.linalg.norm(following - kin.origin[0], axis=1) * ~kin.is_prismatic)


@lru_cache(maxsize=16)
def _offset_of_drives(robot: Robot) -> Array:
    """How far off its axis what gives way as a drive does is typically, (k,), m."""
    kin = robot.kinematics(np.zeros((1, robot.n_joints)))
    following = np.concatenate([kin.origin[0, 1:], kin.p_tcp])
    away = np.linalg.norm(np.cross(kin.axis[0], following - kin.origin[0]), axis=1)
    return np.asarray(np.maximum(SHARE_OF_LINK * away, LEAST_OFFSET))


def _turning(scene: Scene) -> IntArray:
    """Joints whose drive gives way by an angle."""
    return np.flatnonzero(scene.driven & ~scene.kin.is_prismatic)


def _springs(scene: Scene) -> Iterator[tuple[int, str, str]]:
    """Joint from 0, axis that the spring turns about, and direction across it, of each parameter."""
    for k in range(scene.n_joints):
        for axis, other in zip(ACROSS, ACROSS[::-1], strict=True):
            yield k, axis, ALONG
            yield k, axis, other
    for k in _turning(scene).tolist():
        for e in ACROSS:
            yield k, ALONG, e
