# SPDX-License-Identifier: Apache-2.0
"""Temperatures of a simulated cell over hours: the shop swings slowly, gears warm up above it."""

from __future__ import annotations

import math

import numpy as np

from .kinematics import Array
from .sensing import AMBIENT

KEPT = 1.0  # s for which temperatures of gears are not computed again


class Heat:
    """Drawn from a seed; the same seed gives the same hours."""

    def __init__(self, seed: int, n: int) -> None:
        rng = np.random.default_rng([seed, 99])
        self._rise, self._warm_time = rng.uniform(6.0, 18.0, n), rng.uniform(1200.0, 3600.0, n)
        self._swing = rng.uniform(0.3, 1.0), rng.uniform(1500.0, 3500.0), rng.uniform(0.0, 2.0 * math.pi)
        self._last: tuple[float, Array] = (-math.inf, np.zeros(n))

    def ambient(self, t: float) -> float:
        """Of the air at t s, degC."""
        size, period, phase = self._swing
        return AMBIENT + size * math.sin(2.0 * math.pi * t / period + phase) + 2e-4 * t

    def gears(self, t: float) -> Array:
        """Of each gear at t s, (n,), degC."""
        if t - self._last[0] > KEPT:
            self._last = t, self.ambient(t) + 3.0 + self._rise * (1.0 - np.exp(-t / self._warm_time))
        return self._last[1]
