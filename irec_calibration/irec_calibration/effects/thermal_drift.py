# SPDX-License-Identifier: Apache-2.0
"""Links and tracker stand drift between the reference and the loaded sample."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter

AXES = ("x", "y", "z")


class ThermalDrift(Effect):
    id = "thermal_drift"
    label = "thermal drift"
    physics = (
        "Links and tracker stand grow while the cell warms up: v (t - t_reference), or in proportion to a logged "
        "temperature. Missing, the residual grows with the time since the reference and is blind to force."
    )
    needs = ("time",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        out = [Parameter(f"v_{a}", "m/s", 1e-6, plausible=(-1e-4, 1e-4), group="time") for a in AXES]
        for name in usable_temperatures(scene):
            out += [Parameter(f"k_{name}_{a}", "m/K", 1e-5, plausible=(-1e-3, 1e-3), group=f"temp_{name}") for a in AXES]
        return tuple(out)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        drivers = [scene.stamp] + [scene.temperature[n] - REFERENCE_TEMPERATURE for n in usable_temperatures(scene)]
        return np.concatenate([d[:, None, None] * np.eye(3) for d in drivers], axis=2)


REFERENCE_TEMPERATURE = 20.0  # degC, ISO 1


def usable_temperatures(scene: Scene) -> list[str]:
    """Names of the temperatures that were measured in every row."""
    return [n for n, values in scene.temperature.items() if np.isfinite(values).all()]
