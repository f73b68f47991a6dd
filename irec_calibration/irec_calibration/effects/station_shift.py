# SPDX-License-Identifier: Apache-2.0
"""A tracker station was bumped in mid-session."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter

AXES = ("x", "y", "z")


class StationShift(Effect):
    id = "station_shift"
    label = "station shift"
    physics = (
        "A station was moved or bumped: every measured position from one sample on is shifted. In a loaded session it "
        "breaks the pair of reference and loaded rows of one pose; poses that are wholly before or after do not see it."
    )
    acts_on = "instrument"
    in_prediction = False
    needs = ("time",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        stamps = np.unique(scene.stamp)
        if len(stamps) < 3:
            return ()
        between = tuple(float(t) for t in 0.5 * (stamps[1:] + stamps[:-1]))
        shift = [Parameter(f"d_{a}", "m", 1e-4, plausible=(-0.05, 0.05)) for a in AXES]
        middle = between[len(between) // 2]
        return (
            *shift,
            Parameter("t_shift", "s", float(stamps[-1] - stamps[0]), stamps[0], stamps[-1], start=middle, grid=between),
        )

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return (scene.stamp > theta[3])[:, None] * theta[:3]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        out = np.zeros((len(scene), 3, 4))
        out[:, :, :3] = (scene.stamp > theta[3])[:, None, None] * np.eye(3)
        return out
