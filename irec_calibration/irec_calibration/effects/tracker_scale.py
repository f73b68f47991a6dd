# SPDX-License-Identifier: Apache-2.0
"""The tracker measures lengths too long or too short."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .scene import Scene
from .state import ElasticResponse
from .traits import Cause, Family

LARGEST = 0.1  # share of the distance
# Of readings of positions: links are known to a millimetre in a metre, and a scale that is wrong by five times as much would make
# all of them wrong alike, which poses hardly tell from it.
LARGEST_OF_POSITIONS = 5e-3  # share of the distance
USUAL = 1.5e-4  # share of the distance; a base that is off by some tenths of a millimetre moves what a known station sees as much


class TrackerScale(Effect):
    id = "tracker_scale"
    label = "tracker scale"
    physics = (
        "Refraction, temperature or a wrong scale factor make the tracker's lengths (1 + s) times the true ones. Missing, "
        "the residual is parallel to the measured displacement."
    )
    family = Family.INSTRUMENT
    acts_on = "instrument"
    cause = Cause.MEASUREMENT
    needs_elastic = True
    needs = ("tracker",)
    in_readings = True
    readings_against = 40.0  # nats; chosen, as of `station_registration`
    usual_in = ("absolute",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        limit = LARGEST_OF_POSITIONS if scene.kind == "absolute" else LARGEST
        return (Parameter("s", "1", 0.01, -0.5, 0.5, plausible=(-limit, limit)),)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.measured_from_station is None:
            return np.zeros((len(scene), 3, 1))
        if scene.kind == "absolute" and scene.instruments.modelled_from_station is not None:
            # the measured vector itself would let a fit with free geometry shrink robot, measurement and error together
            return scene.instruments.modelled_from_station[:, :, None]
        return scene.noise_free_from_station()[:, :, None]

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        return abs(values.get("s", 0.0)) <= USUAL

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array | None:
        if scene.kind == "absolute" or scene.measured_from_station is None:
            return None
        return theta[0] * scene.change(change.displacement)
