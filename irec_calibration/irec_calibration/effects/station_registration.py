# SPDX-License-Identifier: Apache-2.0
"""The tracker station is turned against what the session says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .scales import SURELY
from .scene import Scene
from .state import ElasticResponse
from .traits import Cause, Family

AXES = ("x", "y", "z")
# RMS over x, y, z; a first axis or a base frame that is off as every robot's does the same to all that a station sees
USUAL_RAD = 0.6e-3
MOST_ABOUT = 2.0  # times the RMS about other axes, by which a station is turned about one
USUAL_ABSOLUTE_RAD = 1e-3  # where a session shows the frame itself, and not only how displacements turn
ALL = "all stations"


class StationRegistration(Effect):
    id = "station_registration"
    label = "station registration"
    physics = (
        "The rotation of a tracker station in base_link is off by a small rotation vector w (true = exp(w) stated); of several, "
        "which were measured in one network, all may be off alike. "
        "Missing, the residual is proportional to the measured displacement and perpendicular to it."
    )
    family = Family.INSTRUMENT
    acts_on = "instrument"
    cause = Cause.MEASUREMENT
    needs_elastic = True
    needs = ("tracker",)
    in_readings = True
    readings_against = 40.0  # nats; chosen: sessions are known in which what was turned is the displacement alone
    usual_in = ("absolute", "loaded")
    usual_beside = 0.02  # chosen; on outside simulators 1.3 % where no station was turned, 1.9 % and more where one was
    usual_by_known = True  # a turn about the first axis may as well be that axis' zero

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        known = [scene.stations[s] for s in _known(scene)]  # an unknown one has its whole pose free: station_pose
        of = [(f"_{s}", f"station {s}") for s in known] + ([("", ALL)] if len(known) > 1 else [])
        return tuple(
            Parameter(f"w_{a}{s}", "rad", 0.01, -1.0, 1.0, plausible=(-0.2, 0.2), group=group) for s, group in of for a in AXES
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.measured_from_station is None:
            return np.zeros((len(scene), 3, len(theta)))
        d = scene.noise_free_from_station()
        turned = np.stack([-np.cross(e, d) for e in np.eye(3)], axis=2)
        known = _known(scene)
        if not known:
            return turned[:, :, :0]
        of = [scene.station == s for s in known] + ([np.isin(scene.station, known)] if len(known) > 1 else [])
        return np.concatenate([turned * rows[:, None, None] for rows in of], axis=2)

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        common = np.array([values.get(f"w_{a}", 0.0) for a in AXES])
        stations = {n.split("_", 2)[2] for n in values if n.count("_") > 1}
        turned = [common, *(common + [values.get(f"w_{a}_{s}", 0.0) for a in AXES] for s in stations)]
        most = USUAL_ABSOLUTE_RAD if scene.kind == "absolute" else USUAL_RAD
        return all(float(np.sqrt(np.mean(w**2))) <= most for w in turned)

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        """A turn of all stations about the first axis (theta, rad) is what the zero of that axis does to all that they see, where
        they are turned about other axes by no more than usual, for certain, and by less than half of that."""
        if not len(theta) or scene.kin.is_prismatic[0]:
            return ""
        axis = scene.kin.axis[0, 0]
        turned = _of_each(theta)
        about = np.median(turned @ axis)
        rest = turned - about * axis
        surely = np.maximum(np.abs(rest) - SURELY * _of_each(se), 0.0)
        beside = float(np.sqrt(np.mean(surely**2)))
        across = float(np.sqrt(0.5 * np.mean((rest**2).sum(axis=1))))  # RMS of the two directions
        return "geometry_error" if beside <= USUAL_RAD and abs(about) > MOST_ABOUT * across else ""

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array | None:
        if scene.kind == "absolute" or scene.measured_from_station is None:
            return None
        turn = np.zeros((len(scene), 3))
        for s, w in zip(_known(scene), _of_each(theta), strict=True):
            turn[scene.station == s] = w
        return -np.cross(turn[:, :, None], scene.change(change.displacement), axis=1)


def _of_each(values: Array) -> Array:
    """Rotation vector of each station that is known, with what all have in common, (stations, 3)."""
    of = values.reshape(-1, 3)
    return of[:-1] + of[-1] if len(of) > 1 else of


def _known(scene: Scene) -> list[int]:
    """Stations whose place is stated."""
    return [s for s in range(len(scene.stations)) if scene.instruments.station_known[s]]
