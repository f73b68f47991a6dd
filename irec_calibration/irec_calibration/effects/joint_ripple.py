# SPDX-License-Identifier: Apache-2.0
"""Errors of a gear or an encoder that repeat many times per turn of the joint."""

from __future__ import annotations

import numpy as np

from ..typing import Array, IntArray
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Family

FEWEST, MOST = 3, 32  # repeats per turn; fewer are `encoder_harmonics`, and smooth functions
TYPICAL = 3e-5  # rad; transmission errors of sound gears are up to 1.5e-4
LARGEST = 1.5e-3  # rad; ten times the transmission error of sound gears (0.5 arcmin)


class JointRipple(Effect):
    id = "joint_ripple"
    label = "joint ripple"
    physics = (
        "Teeth, the wave generator of a strain wave gear and the tracks of an encoder make joint errors that repeat many times "
        f"per turn: J_k sum_m (a_m sin m q_k + b_m cos m q_k), m = {FEWEST} .. {MOST}. Missing, the residual repeats with the "
        "pose and looks like noise wherever poses are not close together; in a loaded session it all but cancels. It stands in "
        "for what has no name and is never a verdict: which of these it is, no pose tells."
    )
    family = Family.ANGLE_ERROR
    cause = Cause.STATE
    needs = ("tracker",)
    stands_in = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{t}{m}_{k + 1}", "rad", TYPICAL, plausible=(-LARGEST, LARGEST), group=f"axis {k + 1}", axis=int(k))
            for k in _turning(scene)
            for m in range(FEWEST, MOST + 1)
            for t in "ab"
        )

    def too_far(self, scene: Scene, theta: Array) -> set[int]:
        """Joints, counted from 0, that it would turn by more than gears and encoders do, somewhere in the rows of a scene."""
        k = _turning(scene)
        angle = np.einsum("nkp,kp->nk", _waves(scene), theta.reshape(len(k), -1))  # rad
        return set(k[np.abs(angle).max(axis=0) > LARGEST].tolist())

    def regressor(self, scene: Scene, theta: Array) -> Array:
        waves = _waves(scene)
        columns: Array = scene.J[:, :, _turning(scene), None] * waves[:, None]
        return columns.reshape(len(scene), 3, waves[0].size)


def _waves(scene: Scene) -> Array:
    """Sine and cosine of each order, (n, turning axes, 2 orders)."""
    angle = scene.q[:, _turning(scene), None] * np.arange(FEWEST, MOST + 1)
    return np.stack([np.sin(angle), np.cos(angle)], axis=3).reshape(*angle.shape[:2], 2 * angle.shape[2])


def _turning(scene: Scene) -> IntArray:
    return np.flatnonzero(scene.driven & ~scene.kin.is_prismatic)
