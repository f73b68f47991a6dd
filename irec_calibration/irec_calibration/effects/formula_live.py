# SPDX-License-Identifier: Apache-2.0
"""A formula that turns an axis by torques and angles, in the live correction: a tenth of the time of its `displacement`."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection

import numpy as np

from ..typing import Array
from .live import ColumnLaw, Tick, drives

READ = re.compile(r"(tau|tau_g|q)(_\d+)?")  # variables that a tick has


class AxisLaw(ColumnLaw):
    """What a formula gives for an axis under the process less what it gives without."""

    def __init__(self, axis: int, n_joints: int, names: Collection[str], angle: Callable[[dict[str, float]], Array]) -> None:
        """
        Args:
            axis: that it turns, from 0.
            names: variables that it reads, each as `READ` says. angle: of the axis by their values, rad.
        """
        self.columns = drives(n_joints)
        self._axis, self._angle = axis, angle
        found = [(name, *_parts(name, axis)) for name in names]
        self._tau = [(name, k) for name, kind, k in found if kind == "tau"]
        self._tau_g = [(name, k) for name, kind, k in found if kind == "tau_g"]
        self._q = [(name, k) for name, kind, k in found if kind == "q"]
        self.needs_gravity = bool(self._tau_g)
        self._out = np.zeros(n_joints)

    def displacement(self, tick: Tick, tau: Array) -> Array:
        values = {name: float(tick.q[k]) for name, k in self._q}
        values |= {name: float(tick.tau_gravity[k]) for name, k in self._tau_g}
        pressed = self._angle(values | {name: float(tau[k]) for name, k in self._tau})
        self._out[self._axis] = pressed - self._angle(values | {name: 0.0 for name, _ in self._tau})
        return self._out


def _parts(name: str, axis: int) -> tuple[str, int]:
    """Kind and axis, from 0, of a variable."""
    found = READ.fullmatch(name)
    if found is None:
        raise ValueError(f"'{name}' is no variable of a tick: {READ.pattern}")
    return found[1], axis if found[2] is None else int(found[2][1:]) - 1
