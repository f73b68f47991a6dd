# SPDX-License-Identifier: Apache-2.0
"""Wrong tool mass in the weight removal of the force sensor."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, SensorMap
from .scene import Scene
from .traits import Evidence, Family


class ToolWeight(Effect):
    id = "tool_weight"
    label = "tool weight removal"
    physics = (
        "The weight that is taken off the force reading belongs to another tool mass or centre of mass: the reading holds "
        "R^T g dm too much. It turns with the flange and shows at the reference, where no force acts; that reading is the "
        "evidence for it, since in the difference to the reference it cancels."
    )
    family = Family.SENSOR
    evidence = Evidence.REFERENCE_READINGS
    acts_on = "wrench"

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return (Parameter("dm", "kg", 2.0, -500.0, 500.0, plausible=(-100.0, 100.0)),)

    def reading(self, scene: Scene, theta: Array) -> Array:
        """What the sensor reads too much, in tool0, (n, 3), N."""
        return theta[0] * np.einsum("nji,j->ni", scene.kin.R_tool, scene.gravity_in_base)

    def wrench(self, scene: Scene, theta: Array) -> tuple[Array, Array]:
        return scene.force_in_tool - self.reading(scene, theta), scene.torque_in_tool

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return SensorMap(weight=-theta[0] * np.eye(3))
