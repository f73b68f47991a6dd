# SPDX-License-Identifier: Apache-2.0
"""Where an unknown marker sits on its link: part of the base model of an `absolute` session."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter

AXES = ("x", "y", "z")


class MarkerPosition(Effect):
    id = "marker_position"
    label = "marker position"
    physics = (
        "Position of each marker on its link (tool0 or base_link), relative to where the nominal robot has it. An unknown "
        "of every absolute session whose marker is not known; it says nothing about the robot."
    )
    acts_on = "instrument"
    in_prediction = False
    registers = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{a}_{name}", "m", 1e-3, group=f"marker {name}", flat=True)
            for name, known in zip(scene.markers, scene.marker_known, strict=True)
            if scene.kind == "absolute" and not known
            for a in AXES
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        unknown = [i for i, known in enumerate(scene.marker_known) if not known]
        if scene.measured_from_station is None or not len(theta):
            return np.zeros((len(scene), 3, len(theta)))
        frame = np.where(scene.moves_with_arm[:, None, None], scene.kin.R_tool, np.eye(3))
        return np.concatenate([frame * (scene.marker == i)[:, None, None] for i in unknown], axis=2)
