# SPDX-License-Identifier: Apache-2.0
"""Relaxation of gears, tool or rubber under sustained load."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter


class Creep(Effect):
    id = "creep"
    label = "creep"
    physics = (
        "Gears, tool or rubber go on yielding under a load that stays: a share of the elastic deflection times 1 - "
        "exp(-t/T), t since the load was applied; with memory 1 what was reached under the load before is kept "
        "(Kelvin-Voigt). Missing, the residual grows with the dwell under load."
    )
    needs = ("time", "load")
    needs_elastic = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return (
            Parameter("share", "1", 0.1, lower=0.0, plausible=(0.0, 1.0)),
            Parameter("T", "s", 10.0, 0.05, 1e5, start=10.0, grid=(1.0, 4.0, 15.0, 60.0)),
            Parameter("memory", "0 or 1", 1.0, 0.0, 1.0, start=0.0, grid=(0.0, 1.0)),
        )

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return theta[0] * self._shape(scene, theta[1], theta[2])

    def regressor(self, scene: Scene, theta: Array) -> Array:
        share, T, memory = theta
        h = 0.01 * T
        by_T = share * (self._shape(scene, T + h, memory) - self._shape(scene, T - h, memory)) / (2 * h)
        return np.stack([self._shape(scene, T, memory), by_T, np.zeros((len(scene), 3))], axis=2)

    def _shape(self, scene: Scene, T: float, memory: float) -> Array:
        if scene.elastic is None:
            return np.zeros((len(scene), 3))
        u = scene.elastic.displacement
        reached = 1.0 - np.exp(-np.maximum(scene.stamp - scene.load_since, 0.0) / T)
        crept = u * reached[:, None]
        if memory >= 0.5:
            for i in np.lexsort((scene.load_case, scene.stamp)):
                before = scene.previous[i]
                if before >= 0:
                    crept[i] = crept[before] + (u[i] - crept[before]) * reached[i]
        return crept
