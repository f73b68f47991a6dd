# SPDX-License-Identifier: Apache-2.0
"""A tracker station was bumped in mid-session."""

from __future__ import annotations

import numpy as np

from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Evidence, Family

AXES = ("x", "y", "z")


class StationShift(Effect):
    id = "station_shift"
    label = "station shift"
    physics = (
        "A station was moved or bumped: every measured position from one sample on is shifted. In a loaded session it "
        "breaks the pair of reference and loaded rows of one pose; poses that are wholly before or after do not see it."
    )
    family = Family.TIME
    evidence = Evidence.ONE_POSE
    acts_on = "instrument"
    cause = Cause.MEASUREMENT
    needs = ("time", "tracker")

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        stamps = np.unique(scene.stamp)
        if len(stamps) < 3:
            return ()
        moments = 0.5 * (stamps[1:] + stamps[:-1])
        if scene.kind == "loaded":
            moments = moments[_parts_a_pose(scene, moments)]
        between = tuple(float(t) for t in moments)
        if not between:
            return ()
        shift = [Parameter(f"d_{a}", "m", 1e-4, plausible=(-0.05, 0.05)) for a in AXES]
        middle = between[len(between) // 2]
        course = float(stamps[-1] - stamps[0])
        return (*shift, Parameter("t_shift", "s", course, stamps[0], stamps[-1], start=middle, grid=between))

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return (scene.stamp > theta[3])[:, None] * theta[:3]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        out = np.zeros((len(scene), 3, 4))
        out[:, :, :3] = (scene.stamp > theta[3])[:, None, None] * np.eye(3)
        return out


def _parts_a_pose(scene: Scene, moments: Array) -> BoolArray:
    """Moments between the reference of some row and that row: at others a shift does not show in a loaded session."""
    start, end = scene.stamp[scene.reference], scene.stamp
    # rows that began before a moment minus rows that had ended by then
    begun = np.searchsorted(np.sort(np.minimum(start, end)), moments, side="left")
    over = np.searchsorted(np.sort(np.maximum(start, end)), moments, side="right")
    parted: BoolArray = begun > over
    return parted
