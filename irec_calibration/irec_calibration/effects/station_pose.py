# SPDX-License-Identifier: Apache-2.0
"""Where a tracker station stands: part of the base model of an `absolute` session."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from ..session.data import Session
from ..typing import Array, BoolArray, Json
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Family

AXES = ("x", "y", "z")


class StationPose(Effect):
    id = "station_pose"
    label = "station pose"
    physics = (
        "Pose of each tracker station in base_link, relative to where the nominal robot has it: a displacement and a "
        "rotation vector w. An unknown of every absolute session whose station is not known; it says nothing about the "
        "robot. Of a station that is known the place alone is free: it was measured against base_link, which no marker "
        "shows, and the first axis stands beside that by some tenths of a millimetre; how far it is turned is "
        "station_registration."
    )
    family = Family.INSTRUMENT
    acts_on = "instrument"
    cause = Cause.MEASUREMENT
    registers = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        out = []
        for s, known in zip(scene.stations, scene.instruments.station_known, strict=True):
            if not known or scene.kind == "absolute":
                out += [Parameter(f"{a}_{s}", "m", 1e-3, group=f"station {s}", flat=True) for a in AXES]
            if not known:
                out += [Parameter(f"w_{a}_{s}", "rad", 1e-3, group=f"station {s}", flat=True) for a in AXES]
        return tuple(out)

    def displacement(self, scene: Scene, theta: Array) -> Array:
        out = np.zeros((len(scene), 3))
        v = self._measured(scene)
        for _, rows, d, w in self._by_station(scene, theta):
            out[rows] = -d if w is None else v[rows] - Rotation.from_rotvec(w).apply(v[rows]) - d
        return out

    def regressor(self, scene: Scene, theta: Array) -> Array:
        out = np.zeros((len(scene), 3, len(theta)))
        v = self._measured(scene)
        for first, rows, _, w in self._by_station(scene, theta):
            out[rows, :, first : first + 3] = -np.eye(3)
            if w is None:
                continue
            turned = Rotation.from_rotvec(w).apply(v[rows])
            out[rows, :, first + 3 : first + 6] = np.swapaxes(np.cross(turned[:, None, :], left_jacobian(w).T[None]), 1, 2)
        return out

    def placed(self, session: Session, values: dict[str, float]) -> Json:
        out: Json = {}
        for s in session.stations:
            if f"x_{s.name}" in values:
                d, w = (np.array([values.get(f"{p}{a}_{s.name}", 0.0) for a in AXES]) for p in ("", "w_"))
                turned = Rotation.from_rotvec(w) * Rotation.from_quat(s.quat_xyzw)
                out[s.name] = {"xyz": (np.array(s.xyz) + d).tolist(), "quat_xyzw": turned.as_quat().tolist()}
        return {"stations_in_base_link": out} if out else {}

    def _measured(self, scene: Scene) -> Array:
        if scene.measured_from_station is None:
            return np.zeros((len(scene), 3))
        return np.nan_to_num(scene.measured_from_station)

    def _by_station(self, scene: Scene, theta: Array) -> Iterator[tuple[int, BoolArray, Array, Array | None]]:
        """Index of its first value, rows, displacement and rotation vector of each station; None where that is known."""
        first = 0
        for i, known in enumerate(scene.instruments.station_known):
            if known and scene.kind != "absolute":
                continue
            w = None if known else theta[first + 3 : first + 6]
            yield first, scene.station == i, theta[first : first + 3], w
            first += 3 if known else 6


def left_jacobian(w: Array) -> Array:
    """d exp(w) = [J_l(w) dw]x exp(w), (3, 3)."""
    angle = float(np.linalg.norm(w))
    K = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    if angle < 1e-6:
        return np.eye(3) + 0.5 * K
    return np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * K @ K
