# SPDX-License-Identifier: Apache-2.0
"""Where an unknown marker sits on its link: part of the base model of an `absolute` session."""

from __future__ import annotations

import numpy as np

from ..session.data import Session
from ..typing import Array, Json
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Family

AXES = ("x", "y", "z")


class MarkerPosition(Effect):
    id = "marker_position"
    label = "marker position"
    physics = (
        "Position of each marker on its link (tool0 or base_link), relative to where the nominal robot has it. An unknown "
        "of every absolute session whose marker is not known; it says nothing about the robot."
    )
    family = Family.INSTRUMENT
    acts_on = "instrument"
    cause = Cause.MEASUREMENT
    registers = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"{a}_{name}", "m", 1e-3, group=f"marker {name}", flat=True)
            for name, known in zip(scene.instruments.markers, scene.instruments.marker_known, strict=True)
            if scene.kind == "absolute" and not known
            for a in AXES
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        unknown = [i for i, known in enumerate(scene.instruments.marker_known) if not known]
        if scene.measured_from_station is None or not len(theta):
            return np.zeros((len(scene), 3, len(theta)))
        frame = np.where(scene.moves_with_arm[:, None, None], scene.kin.R_tool, np.eye(3))
        return np.concatenate([frame * (scene.instruments.marker == i)[:, None, None] for i in unknown], axis=2)

    def placed(self, session: Session, values: dict[str, float]) -> Json:
        out: Json = {}
        for m in session.markers:
            if f"x_{m.name}" in values:
                d = np.array([values[f"{a}_{m.name}"] for a in AXES])
                out.setdefault(f"markers_in_{m.link}", {})[m.name] = (np.array(m.xyz) + d).tolist()
        return out
