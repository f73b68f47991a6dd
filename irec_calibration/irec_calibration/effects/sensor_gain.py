# SPDX-License-Identifier: Apache-2.0
"""Force sensor sensitivity error and crosstalk."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, SensorMap
from .scales import SURELY
from .scene import Scene
from .sensor_alignment import ABOUT_FLANGE
from .traits import Family

NAMES = ("e_xx", "e_yy", "e_xy", "e_xz", "e_yx", "e_yz", "e_zx", "e_zy")
LIMIT = 0.5
LEAST_BESIDE_TURNING = 0.1  # of the turning part, that E has besides: axes that read each other by chance don't turn the force
MOST_BESIDE_TURNING = 0.5  # likewise, of a matrix that is rather a turned sensor, where that explains as much
TURNS_MORE = 1.5  # times the other channels, RMS; chosen: of eight that are about as large two are alike by chance
LEAST_TURN, ALIKE = 0.02, 0.15  # rad; share of it by which the two axes that a turn mixes differ from one another; chosen


def crosstalk(theta: Array) -> Array:
    """The traceless matrix E of f_true = (I + E) f_measured, (3, 3): a uniform gain can't be told from a compliance scale."""
    xx, yy, xy, xz, yx, yz, zx, zy = theta
    return np.array([[xx, xy, xz], [yx, yy, yz], [zx, zy, -xx - yy]])


class SensorGain(Effect):
    id = "sensor_gain"
    label = "force sensor gain"
    physics = (
        "The force sensor's sensitivity differs between its axes or one axis reads part of another: the force that acts is "
        "(I + E) f, E traceless. Missing, the error is proportional to the force whatever the pose, along the model's own "
        "prediction."
    )
    family = Family.SENSOR
    acts_on = "wrench"
    needs = ("load",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        # a bridge or an amplifier that fails loses as much of a channel as this, so nothing within the bounds is implausible
        return tuple(Parameter(n, "1", 0.03, -LIMIT, LIMIT, group="gain" if n in ("e_xx", "e_yy") else n) for n in NAMES)

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        value, se = np.nan_to_num(np.array([values.get(n, (0.0, 0.0)) for n in NAMES])).T
        E = crosstalk(value)
        turns, rest = np.linalg.norm(E - E.T) / 2.0, np.linalg.norm(E + E.T) / 2.0
        # what it is expected to be where there is none, by the errors of the values
        by_chance = np.sqrt(2.0 * (se[:2] ** 2).sum() + 0.5 * (se[2:] ** 2).sum())
        if turns <= by_chance or np.sqrt(max(rest**2 - by_chance**2, 0.0)) >= LEAST_BESIDE_TURNING * turns:
            return ""
        angle = turns / np.sqrt(2.0)
        return f"it turns the force by {angle:.3g} rad and changes it by less than a tenth of that: a turned sensor"

    def rather(self, values: Mapping[str, float], compliance: Mapping[str, float], scene: Scene) -> str:
        E = crosstalk(np.array([values.get(n, 0.0) for n in NAMES]))
        turns = np.linalg.norm(E - E.T)
        mostly_turns = np.linalg.norm(E + E.T) <= MOST_BESIDE_TURNING * turns
        # what the largest force, along the flange's axis, does to the two others, is as likely crosstalk
        about_flange = np.sqrt(2.0) * abs(E[0, 1] - E[1, 0]) >= ABOUT_FLANGE * turns
        return "sensor_alignment" if mostly_turns and about_flange and np.any(E) else ""

    def holds(self, values: Mapping[str, float]) -> tuple[str, dict[str, float], frozenset[str]] | None:
        """Two axes across the flange's that read each other alike, with opposite signs: a sensor that is bolted on turned."""
        pair = "e_xy", "e_yx"
        if not set(pair) <= set(values):
            return None
        xy, yx = (values[n] for n in pair)
        turns = 0.5 * (yx - xy)
        others = [v for n, v in values.items() if n not in pair]
        least = max(LEAST_TURN, TURNS_MORE * float(np.sqrt(np.mean(np.square(others)))) if others else 0.0)
        if abs(turns) < least or abs(yx + xy) > 2.0 * ALIKE * abs(turns):
            return None
        return "sensor_alignment", {"w_z": turns}, frozenset(pair)

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        """Crosstalk that turns the force, by more than its errors, and does nothing else beyond them may be a turned sensor."""
        E, wide = crosstalk(theta), SURELY * np.abs(crosstalk(se))
        both = np.hypot(wide, wide.T)  # of E_ij + E_ji and of E_ij - E_ji
        turns = np.abs(E - E.T) > both
        besides = (np.abs(E + E.T) > both) & ~np.eye(3, dtype=bool) | np.diag(np.abs(np.diag(E)) > np.diag(wide))
        return "sensor_alignment" if turns.any() and not besides.any() else ""

    def wrench(self, scene: Scene, theta: Array) -> tuple[Array, Array]:
        return scene.force_in_tool @ (np.eye(3) + crosstalk(theta)).T, scene.torque_in_tool

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return SensorMap(force=np.eye(3) + crosstalk(theta))
