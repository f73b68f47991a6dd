# SPDX-License-Identifier: Apache-2.0
"""The marker is not where `marker_in_tool0` says."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .scene import Scene
from .state import ElasticResponse
from .traits import Cause, Family

AXES = ("x", "y", "z")


class MarkerOffset(Effect):
    id = "marker_offset"
    label = "marker offset"
    physics = (
        "The marker sits off its stated place in tool0 by d: the rotation of the tool, elastic and commanded, moves it by "
        "dtheta x R d. Missing, the residual is proportional to the predicted rotation of the TCP."
    )
    family = Family.INSTRUMENT
    acts_on = "instrument"
    cause = Cause.MEASUREMENT
    needs_elastic = True
    needs = ("tracker",)
    in_readings = True
    readings_against = 40.0  # nats; chosen, as of `station_registration`
    usual_visible = 0.006  # as `geometry_error`, of which it is a form
    special_of = "geometry_error"  # a last link of another length, beside which that joint's axis may lie otherwise

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if not all(scene.instruments.marker_known):  # an unknown marker is free already: marker_position
            return ()
        return tuple(Parameter(f"d_{a}", "m", 0.01, -1.5, 1.5, plausible=(-1.0, 1.0)) for a in AXES)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        arms = scene.kin.R_tool * scene.moves_with_arm[:, None, None]
        if scene.elastic is None or scene.measured_from_station is None:
            return np.zeros((len(scene), 3, 3)) if scene.measured_from_station is None else np.array(arms)
        turned = np.stack([np.cross(scene.elastic.rotation, arms[:, :, a]) for a in range(3)], axis=2)
        return arms + turned

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array | None:
        if scene.measured_from_station is None:
            return None
        arm = (scene.kin.R_tool @ theta) * scene.moves_with_arm[:, None]
        return np.cross(change.rotation, arm[:, :, None], axis=1)
