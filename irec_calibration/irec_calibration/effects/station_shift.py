# SPDX-License-Identifier: Apache-2.0
"""A tracker station was bumped in mid-session."""

from __future__ import annotations

import numpy as np

from ..typing import Array, BoolArray
from .base import Effect, Parameter
from .scene import Scene
from .traits import Cause, Evidence, Family

AXES = ("x", "y", "z")
FEWEST = 3  # poses on either side of a shift, as where it is asked whether one of a loaded session lasts


class StationShift(Effect):
    id = "station_shift"
    label = "station shift"
    physics = (
        "A station was moved or bumped: every measured position from one sample on is shifted, and in an absolute session, "
        "which sees the whole workspace from it, turned about the station. In a loaded session it "
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
        else:
            moments = moments[_has_poses_on_both_sides(scene, moments)]
        between = tuple(float(t) for t in moments)
        if not between:
            return ()
        tilts = scene.kind == "absolute"
        shift = [Parameter(f"d_{a}", "m", 1e-4, plausible=(-0.05, 0.05), group="shift" if tilts else "") for a in AXES]
        if tilts:
            shift += [Parameter(f"r_{a}", "rad", 1e-4, plausible=(-0.02, 0.02), group="tilt") for a in AXES]
        middle = between[len(between) // 2]
        course = float(stamps[-1] - stamps[0])
        return (*shift, Parameter("t_shift", "s", course, stamps[0], stamps[-1], start=middle, grid=between))

    def displacement(self, scene: Scene, theta: Array) -> Array:
        out: Array = self._columns(scene, theta) @ theta[:-1]
        return out

    def regressor(self, scene: Scene, theta: Array) -> Array:
        return np.concatenate([self._columns(scene, theta), np.zeros((len(scene), 3, 1))], axis=2)

    def _columns(self, scene: Scene, theta: Array) -> Array:
        ways = np.tile(np.eye(3), (len(scene), 1, 1))
        if scene.kind == "absolute":
            ways = np.concatenate([ways, turned_about_station(scene)], axis=2)
        return np.asarray((scene.stamp > theta[-1])[:, None, None] * ways)


def turned_about_station(scene: Scene) -> Array:
    """How each row moves where its station turns about x, y, z of base_link, (n, 3, 3), m/rad; none in predictions."""
    if scene.measured_from_station is None:
        return np.zeros((len(scene), 3, 3))
    return np.cross(np.eye(3)[None], scene.noise_free_from_station()[:, None]).swapaxes(1, 2)


def _parts_a_pose(scene: Scene, moments: Array) -> BoolArray:
    """Moments between the reference of some row and that row: at others a shift does not show in a loaded session."""
    start, end = scene.stamp[scene.reference], scene.stamp
    # rows that began before a moment minus rows that had ended by then
    begun = np.searchsorted(np.sort(np.minimum(start, end)), moments, side="left")
    over = np.searchsorted(np.sort(np.maximum(start, end)), moments, side="right")
    parted: BoolArray = begun > over
    return parted


def _has_poses_on_both_sides(scene: Scene, moments: Array) -> BoolArray:
    """Moments before and after which an absolute session has several poses: what one alone shows is an accident of that pose."""
    order = np.argsort(scene.stamp, kind="stable")
    stamp, pose = scene.stamp[order], scene.pose[order]
    first = np.flatnonzero(np.append(True, pose[1:] != pose[:-1]))  # of each visit
    begin, end = stamp[first], stamp[np.append(first[1:], len(stamp)) - 1]
    before, after = np.searchsorted(end, moments), len(begin) - np.searchsorted(begin, moments)
    enough: BoolArray = np.minimum(before, after) >= FEWEST
    return enough
