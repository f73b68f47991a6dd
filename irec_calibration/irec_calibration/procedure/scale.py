# SPDX-License-Identifier: Apache-2.0
"""The scale of the force sensor in the course of a run: by the weight of the tool, wherever the robot stands in free air.

One orientation tells nothing, since the bias of the raw sensor is not known. A run does not turn the tool for that, as no move of
the procedure is known to be free of everything that stands about; where its places do not, it says that nobody knows the scale.
"""

from __future__ import annotations

import numpy as np

from ..cell import Cell
from ..files.regular import is_there
from ..poses.store import read_poses
from ..typing import Array
from .weighing import (
    GRAVITY,
    LEAST_STATED,
    RUN_HIGH,
    RUN_LEAST,
    RUN_LOW,
    RUN_SPREAD,
    WEIGHT_REST,
    Weighed,
    nothing_stated,
    scale_advice,
    sensor_in_tool,
    stated_mass,
    tells_pounds,
    weigh,
)

MOST_READINGS = 50
MEANS = (
    "a sensor of another unit or gain, as one in pounds, would not be noticed, and the robot press several times as hard as asked"
)
CHECK = "check_driver -p level:=moves -p approach:=true, which turns the wrist in free air"


class Scale:
    """Weighs the tool in the course of a run, from orientation to orientation.

    Attributes:
        verified: the weight was seen to be what is stated, so well that another unit would have been told from it.
    """

    def __init__(self, cell: Cell) -> None:
        self._cell, self._R_sensor = cell, sensor_in_tool(cell.robot, cell.raw["force_sensor"]["frame"])
        self._stated = stated_mass(cell)
        self._R: list[Array] = []
        self._force: list[Array] = []
        self.verified = False

    def problem(self, R_tool_in_base: Array, raw: Array) -> str:
        """Why the force sensor's scale can't be right; empty: it may be, or not enough is known yet. raw: its force, (3,), N."""
        low, high = self._stated
        if low < LEAST_STATED:
            return ""
        self._R = [*self._R, R_tool_in_base @ self._R_sensor][-MOST_READINGS:]
        self._force = [*self._force, raw][-MOST_READINGS:]
        w = self._weighed()
        seen, slack = abs(w.mass), w.slack
        if not self._sure(w):
            return ""
        if RUN_LOW * low - slack <= seen <= RUN_HIGH * high + slack:
            self.verified = self.verified or tells_pounds(w, RUN_LOW, low)
            return ""
        return (
            f"the force sensor weighs {seen:.1f} kg of tool (wrench_raw in {len(self._R)} places), {self._said} kg are stated"
            f" (links beyond {self._cell.raw['force_sensor']['frame']} in the robot description, tool.payload), limit {RUN_LOW:g}"
            f" to {RUN_HIGH:g} of it: {scale_advice(seen / (0.5 * (low + high)))}"
        )

    def doubt(self) -> str:
        """Why nobody knows whether the scale is right, and what to do; empty: it was verified."""
        return "" if self.verified else self._doubt(*self._why())

    def doubt_before(self, R_tool_in_base: Array) -> str:
        """The same, as far as it is known before a run; empty: the run may verify it.

        Args:
            R_tool_in_base: orientations that the tool will stand in, in free air, (n, 3, 3).
        """
        if nothing := nothing_stated(self._cell):
            return self._doubt(nothing, f"state tool.payload.mass, and run {CHECK}")
        down = np.einsum("nji,j->ni", R_tool_in_base @ self._R_sensor, GRAVITY)
        spread = float(((down - down.mean(axis=0)) ** 2).sum())
        return "" if spread >= RUN_SPREAD else self._doubt(*_alike(spread, len(down)))

    @property
    def _said(self) -> str:
        low, high = self._stated
        return f"{low:g}" if low == high else f"{low:g} to {high:g}"

    def _weighed(self) -> Weighed:
        return weigh(np.array(self._R), np.array(self._force))

    def _sure(self, w: Weighed) -> bool:
        return w.spread >= RUN_SPREAD and w.rest <= WEIGHT_REST and abs(w.mass) >= max(RUN_LEAST * self._stated[0], w.slack)

    def _why(self) -> tuple[str, str]:
        """What is not known, and what to do."""
        if nothing := nothing_stated(self._cell):
            return nothing, f"state tool.payload.mass, and run {CHECK}"
        frame = self._cell.raw["force_sensor"]["frame"]
        if not self._R:
            return f"no readings of wrench_raw in '{frame}' came while the robot stood in free air", "publish wrench_raw"
        w = self._weighed()
        if w.spread < RUN_SPREAD:
            return _alike(w.spread, len(self._R))
        if w.rest > WEIGHT_REST:
            return (
                f"wrench_raw does not turn as a weight and a bias do ({w.rest:.0f} N are left, limit {WEIGHT_REST:g} N)",
                f"see that it is in '{frame}' and that nothing touches the tool, and run {CHECK}",
            )
        return (
            f"wrench_raw weighs {abs(w.mass):.1f} kg, {self._said} kg are stated: too little to tell the scale (is the sensor set"
            " to zero at each pose, is the tool light?)",
            "hang a known weight on the tool",
        )

    def _doubt(self, why: str, do: str) -> str:
        return f"the scale of the force could not be verified: {why}; {MEANS}. {do[0].upper()}{do[1:]}"


def scale_notes(cell: Cell) -> list[str]:
    """Why no run with the poses of a cell can verify the scale of its force sensor, as notes; the poses need not be there yet.

    Raises:
        PlanError: the pose file can't be read.
    """
    if not nothing_stated(cell) and not is_there(cell.poses_path):
        return []
    there = read_poses(cell.poses_path).poses if is_there(cell.poses_path) else ()
    q = np.array([cell.home, *(pose.q for pose in there)])
    doubt = Scale(cell).doubt_before(cell.robot.kinematics(q).R_tool)
    return [doubt] if doubt else []


def _alike(spread: float, places: int) -> tuple[str, str]:
    """Of orientations in which gravity has this sum of squares about its mean, m^2/s^4."""
    return (
        f"the tool hangs alike in all {places} places in free air (gravity in the sensor's frame has a sum of squares about its"
        f" mean of {spread:.2g} m^2/s^4, {RUN_SPREAD:g} are needed: two orientations 26 degrees apart)",
        f"run {CHECK}, or give poses that incline the tool otherwise",
    )
