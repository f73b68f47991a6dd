# SPDX-License-Identifier: Apache-2.0
"""The reported joint angle was read before the arm had settled."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter


class JointSettling(Effect):
    id = "joint_settling"
    label = "joint settling"
    physics = (
        "The controller's joint angle was read while the arm was still creeping into place: J_k a_k times the step of joint k since the "
        "previous row; a > 0: the arm was further along the step than reported. Missing, the residual is proportional to the step just made, "
        "not to its sign: it imitates backlash."
    )
    needs = ("step",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"a_{k + 1}", "1", 1e-2 if scene.kind == "loaded" else 1e-4, -1.0, 1.0, plausible=(-0.5, 0.5), group=f"axis {k + 1}")
            for k in np.flatnonzero(scene.driven)
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        return (scene.J * scene.step[:, None, :])[:, :, scene.driven]
