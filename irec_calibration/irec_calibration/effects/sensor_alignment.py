# SPDX-License-Identifier: Apache-2.0
"""Force sensor mounted rotated about the flange axis."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, SensorMap
from .scene import Scene
from .traits import Family

AXES = ("x", "y", "z")
ABOUT_FLANGE = 0.9  # of a turn, about the axis of the flange; chosen: turned sensors had 0.96 and more, crosstalk 0.86


class SensorAlignment(Effect):
    id = "sensor_alignment"
    label = "force sensor alignment"
    physics = (
        "The force sensor is mounted turned: the force that acts is R f with a small rotation vector in tool0 (mostly "
        "about the sensor's mounting axis). Missing, the lateral load cases N, E, S, W rotate into each other."
    )
    family = Family.SENSOR
    acts_on = "wrench"
    needs = ("load",)
    special_of = "sensor_gain"  # crosstalk that turns the force and does nothing else

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        # a sensor can be bolted on at any angle, so nothing within the bounds is implausible
        return tuple(Parameter(f"w_{a}", "rad", 0.03, -0.8, 0.8, group=f"about {a}") for a in AXES)

    def simpler(self, values: Mapping[str, float]) -> bool:
        # a turn about another axis makes lateral forces of the largest, along the flange's, as crosstalk of that channel does
        turn = np.array([values.get(f"w_{a}", 0.0) for a in AXES])
        return bool(abs(turn[2]) >= ABOUT_FLANGE * np.linalg.norm(turn))

    def wrench(self, scene: Scene, theta: Array) -> tuple[Array, Array]:
        R = Rotation.from_rotvec(theta).as_matrix()
        return scene.force_in_tool @ R.T, scene.torque_in_tool @ R.T

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        R = Rotation.from_rotvec(theta).as_matrix()
        return SensorMap(force=R, torque=R)
