# SPDX-License-Identifier: Apache-2.0
"""Links bend about points of their own, not about the origins of the joints in the robot description."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..robot import Robot
from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .scales import typical_compliance
from .scene import Scene
from .traits import Family

TYPICAL_OFFSET = 0.03  # m; where a casting or a bearing gives way is a few centimetres off the origin that the description has
ALONG = "z"  # the joint's own axis, in names of parameters


class BendingPlace(Effect):
    id = "bending_place"
    label = "place of bending"
    physics = (
        "The springs of link_bending sit beside the URDF origins of the joints. About an axis a through a point d off the "
        "origin a force f turns the link by c (tau - f . (a x d)), and the TCP moves by that angle times (a x r - a x d): to "
        "first order in d two coupling terms, m (V_a (e . f) + e tau_a) for each of two directions e across a, m = -c (a x d) "
        ". e, the larger the softer the spring is. Every robot has it to some extent; missing, it leaves some ten micrometres "
        "that pass for tool_compliance."
    )
    family = Family.SPRING
    elastic = True
    completes = "link_bending"
    needs = ("load",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if scene.kind == "absolute":  # under gravity the force that acts beyond a joint is another one for each joint
            return ()
        return _of_robot(scene.robot)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        n, k = len(scene), scene.n_joints
        tau = scene.load_torque_virtual().reshape(n, k, 2)
        V = scene.V.reshape(n, 3, k, 2)
        across, along = scene.kin.virtual_axis, scene.kin.axis
        moves = scene.moves_with_arm[:, None]
        out = np.empty((n, 3, k, 2, 2))
        for v in range(2):
            for i, e in enumerate((along, across[:, :, 1 - v])):
                pushed = np.einsum("nki,ni->nk", e, scene.force)
                out[:, :, :, v, i] = V[:, :, :, v] * pushed[:, None] + e.swapaxes(1, 2) * (tau[:, :, v] * moves)[:, None]
        return out.reshape(n, 3, -1)

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        entries = []
        names = [(k + 1, v, e) for k in range(scene.n_joints) for v, e in _pairs()]
        for (k, v, e), m in zip(names, theta, strict=True):
            turns, shifts = f"joint_{k}{v}", f"joint_{k}t{e}"
            entries += [(turns, shifts, float(m)), (shifts, turns, float(m))]
        return Springs(tuple(entries))


@lru_cache(maxsize=16)
def _of_robot(robot: Robot) -> tuple[Parameter, ...]:
    scale = TYPICAL_OFFSET * typical_compliance(robot)
    return tuple(
        Parameter(
            f"m_{k + 1}{v}{e}", "m/(N m)", s, plausible=(-100.0 * s, 100.0 * s), group=f"axis {k + 1}", axis=k,
            goes_with=f"c_{k + 1}{v}",
        )
        for k, s in enumerate(scale.tolist())
        for v, e in _pairs()
    )  # fmt: skip


def _pairs() -> tuple[tuple[str, str], ...]:
    """Virtual axis and direction across it."""
    return (("a", ALONG), ("a", "b"), ("b", ALONG), ("b", "a"))
