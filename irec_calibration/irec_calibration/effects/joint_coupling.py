# SPDX-License-Identifier: Apache-2.0
"""Wrist gears couple the last three axes: off-diagonal compliance."""

from __future__ import annotations

import numpy as np

from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .scales import typical_compliance
from .scene import Scene
from .traits import Family


class JointCoupling(Effect):
    id = "joint_coupling"
    label = "wrist coupling"
    physics = (
        "The last axes are driven through each other's gears, so that the torque of one wrist axis moves another: J_k c_kl "
        "tau_l for each pair of the last three axes. Missing, the torque of one wrist axis shows in the direction of "
        "another."
    )
    family = Family.SPRING
    elastic = True

    def pairs(self, scene: Scene) -> list[tuple[int, int]]:
        return [(k, j) for i, k in enumerate(scene.wrist) for j in scene.wrist[i + 1 :]]

    def in_wrist(self, scene: Scene) -> BoolArray:
        return np.ones(len(self.parameters(scene)), dtype=bool)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        out = []
        for k, j in self.pairs(scene):
            size = 0.3 * float(np.sqrt(scale[k] * scale[j]))
            for a, b in ((k, j), (j, k)):
                name = f"c_{a + 1}{b + 1}"
                out.append(Parameter(name, "rad/(N m)", size, plausible=(-50 * size, 50 * size), group=f"axes {k + 1}-{j + 1}"))
        return tuple(out)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        tau = scene.load_torque()
        columns = [scene.J[:, :, a] * tau[:, None, b] for k, j in self.pairs(scene) for a, b in ((k, j), (j, k))]
        return np.stack(columns, axis=2) if columns else np.zeros((len(scene), 3, 0))

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        pairs = [pair for k, j in self.pairs(scene) for pair in ((k, j), (j, k))]
        return Springs(tuple((f"joint_{a + 1}", f"joint_{b + 1}", float(v)) for (a, b), v in zip(pairs, theta, strict=True)))
