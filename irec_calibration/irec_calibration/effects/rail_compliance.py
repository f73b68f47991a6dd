# SPDX-License-Identifier: Apache-2.0
"""The carriage of an external axis: a base spring whose stiffness varies along the travel."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter
from .base_compliance import base_spring_regressor

DOF = ("t_x", "t_y", "t_z", "r_x", "r_y", "r_z")
POWERS = (0, 1, 2)


class RailCompliance(Effect):
    id = "rail_compliance"
    label = "rail compliance"
    physics = (
        "The carriage and its rail give way like a base spring, differently along the travel: each of six compliances is a "
        "parabola over the rail position. Missing, the residual depends on the rail position."
    )
    elastic = True
    needs = ("ext", "load")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(
                f"{d}_s{power}",
                "m/N" if d[0] == "t" else "rad/(N m)",
                1e-8 if d[0] == "t" else 2e-8,
                lower=0.0 if power == 0 else -np.inf,
                group=d,
            )
            for d in DOF
            for power in POWERS
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        position = next(iter(scene.ext.values()))
        s = np.where(np.isfinite(position), position, 0.0) / RAIL_LENGTH_SCALE
        spring = base_spring_regressor(scene)
        return np.concatenate([spring[:, :, d : d + 1] * s[:, None, None] ** p for d in range(6) for p in POWERS], axis=2)


RAIL_LENGTH_SCALE = 1.0  # m; rail position is used in metres so that a model means the same on another session
