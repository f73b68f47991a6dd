# SPDX-License-Identifier: Apache-2.0
"""A formula that turns an axis by torques and angles, in the live correction: a tenth of the time of its `displacement`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection

import numpy as np

from ..errors import EffectError
from ..typing import Array
from .live import ColumnLaw, Tick, drives

READ = re.compile(r"(tau|tau_g|q)(_\d+)?")  # variables that a tick has


class AxisLaw(ColumnLaw):
    """What a formula gives for an axis under the process less what it gives without."""

    def __init__(
        self, formula: str, axis: int, n_joints: int, names: Collection[str], angle: Callable[[dict[str, float]], Array]
    ) -> None:
        """
        Args:
            formula: for messages. axis: that it turns, from 0.
            names: variables that it reads, each as `READ` says. angle: of the axis by their values, rad.
        """
        self.columns = drives(n_joints)
        self._formula, self._axis, self._angle = formula, axis, angle
        of: dict[str, list[tuple[str, int]]] = {"tau": [], "tau_g": [], "q": []}
        for found in filter(None, map(READ.fullmatch, names)):
            of[found[1]].append((found[0], axis if found[2] is None else int(found[2][1:]) - 1))
        self._tau, self._tau_g, self._q = of["tau"], of["tau_g"], of["q"]
        self.needs_gravity = bool(self._tau_g)
        self._out = np.zeros(n_joints)

    def displacement(self, tick: Tick, tau: Array) -> Array:
        values = {name: float(tick.q[k]) for name, k in self._q}
        values |= {name: float(tick.tau_gravity[k]) for name, k in self._tau_g}
        pressed = self._angle(values | {name: float(tau[k]) for name, k in self._tau})
        angle = float(pressed - self._angle(values | {name: 0.0 for name, _ in self._tau}))
        if not math.isfinite(angle):
            raise EffectError(f"formula '{self._formula}': not a finite number at the present joint angles and torques")
        self._out[self._axis] = angle
        return self._out
