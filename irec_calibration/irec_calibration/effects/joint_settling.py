# SPDX-License-Identifier: Apache-2.0
"""The reported joint angle was read before the arm had settled."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Family
from .travel import travel_to_reference


class JointSettling(Effect):
    id = "joint_settling"
    label = "joint settling"
    physics = (
        "The controller's joint angle was read while the arm was still creeping into place: J_k a_k times the step of "
        "joint k since the previous row; a > 0: the arm was further along the step than reported. With travel 1 the "
        "reference of a loaded session was read too early as well, after the travel from the pose before. Missing, the "
        "residual is proportional to the step just made, not to its sign: it imitates backlash."
    )
    family = Family.ANGLE_ERROR
    cause = Cause.MOTION
    needs = ("step",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        loaded = scene.kind == "loaded"
        axes = tuple(
            Parameter(
                f"a_{k + 1}", "1", 1e-2 if loaded else 1e-4, -1.0, 1.0, plausible=(-0.5, 0.5), group=f"axis {k + 1}", axis=int(k)
            )
            for k in np.flatnonzero(scene.driven)
        )
        return (*axes, Parameter("travel", "0 or 1", 1.0, 0.0, 1.0, start=1.0, grid=(0.0, 1.0))) if loaded else axes

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return self._columns(scene, theta) @ theta[: int(scene.driven.sum())]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        columns = self._columns(scene, theta)
        by_travel = np.zeros((len(scene), 3, len(theta) - columns.shape[2]))
        return np.concatenate([columns, by_travel], axis=2)

    def _columns(self, scene: Scene, theta: Array) -> Array:
        step = scene.step
        if scene.kind == "loaded" and theta[-1] >= 0.5:
            step = step + travel_to_reference(scene)
        return (scene.J * step[:, None, :])[:, :, scene.driven]
