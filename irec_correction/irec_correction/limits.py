# SPDX-License-Identifier: Apache-2.0
"""Limits on magnitude, rate and acceleration of an offset: the last stage before the robot, whatever came before it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from irec_calibration.typing import Array

from .errors import SettingsError

ON_TARGET = 1e-9  # m or rad; closer than this counts as reached
SHORTEST_STEP = 1e-3  # of the period; a second tick at the same time moves nothing


@dataclass(frozen=True)
class Bounds:
    """Limits of a vector (norms).

    Attributes:
        magnitude: m or rad.
        rate: m/s or rad/s.
        acceleration: m/s^2 or rad/s^2.
    """

    magnitude: float
    rate: float
    acceleration: float

    def __post_init__(self) -> None:
        for name in ("magnitude", "rate", "acceleration"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise SettingsError(f"limit of the offset: {name} is {value}, it must be a number above 0")


class VectorLimiter:
    """Follows a target of 3 components within its bounds.

    The step in one tick is never above `rate * period`, whatever the target does and however late the tick comes. Magnitude goes
    before acceleration: at the edge of the allowed ball the vector stops there.
    """

    def __init__(self, bounds: Bounds, period: float) -> None:
        """Args: period: nominal time between two ticks, s."""
        if not (math.isfinite(period) and period > 0.0):
            raise SettingsError(f"period of the correction is {period} s, it must be above 0")
        self.bounds, self.period = bounds, period
        self.reset()

    def reset(self) -> None:
        """Begin at zero."""
        self.value = np.zeros(3)
        self._velocity = np.zeros(3)
        self._target = np.zeros(3)

    def resynchronise(self, value: Array) -> None:
        """The robot stands at a value (3,): go on from there, from rest."""
        self.value = value.copy()
        self._velocity = np.zeros(3)

    def step(self, target: Array, dt: float) -> bool:
        """One tick towards a target (3,); the result is in `value`. Not finite means: stay where you are.

        Args:
            dt: time since the tick before, s; counts as one period at most.

        Returns:
            True where a limit was active.
        """
        b = self.bounds
        dt = min(max(dt, 0.0), self.period) if math.isfinite(dt) else 0.0
        if dt < SHORTEST_STEP * self.period:
            return False
        if not np.all(np.isfinite(target)):
            target = self.value.copy()
        wanted = _shortened(target, b.magnitude)
        limited = wanted is not target
        target_velocity = _shortened((wanted - self._target) / dt, b.rate)
        behind = self._target - self.value  # where the tick before should have ended; 0 while the target is followed
        distance = _norm(behind)
        velocity = target_velocity
        if distance > 0.0:
            half = 0.5 * b.acceleration * dt  # speed from which braking still ends at the target, discrete steps of dt
            braking = math.sqrt(half * half + 2.0 * b.acceleration * distance) - half
            velocity = _shortened(target_velocity + behind * (min(distance / dt, braking) / distance), b.rate)
        self._target = wanted.copy()
        change = _shortened(velocity - self._velocity, b.acceleration * dt)
        velocity = self._velocity + change
        # a limit that was lowered under way is reached at the rate, not by a step
        new = _shortened(self.value + velocity * dt, max(b.magnitude, _norm(self.value)))
        self._velocity = (new - self.value) / dt
        limited = limited or _norm(wanted - new) > ON_TARGET
        self.value = new
        return limited


def _norm(v: Array) -> float:
    x, y, z = v.tolist()
    return math.sqrt(x * x + y * y + z * z)


def _shortened(v: Array, longest: float) -> Array:
    length = _norm(v)
    return v if length <= longest else v * (longest / length)


@dataclass(frozen=True)
class OffsetLimits:
    """Limits of translation (m) and rotation (rad) of the offset."""

    translation: Bounds = Bounds(3e-3, 0.02, 0.5)
    rotation: Bounds = Bounds(5e-3, 0.05, 2.0)


class OffsetLimiter:
    """Both parts of an offset. See `VectorLimiter`."""

    def __init__(self, limits: OffsetLimits, period: float) -> None:
        self.translation = VectorLimiter(limits.translation, period)
        self.rotation = VectorLimiter(limits.rotation, period)

    def set_limits(self, limits: OffsetLimits) -> None:
        """Other limits from the next tick on; an offset beyond them goes back at the rate."""
        self.translation.bounds, self.rotation.bounds = limits.translation, limits.rotation

    def reset(self) -> None:
        """Begin at zero: only where nobody follows the offset just now."""
        for part in (self.translation, self.rotation):
            part.reset()

    def resynchronise(self, translation: Array, rotation: Array) -> None:
        """The robot stands at this offset, (3,) m and (3,) rad: go on from there, from rest."""
        self.translation.resynchronise(translation)
        self.rotation.resynchronise(rotation)

    def step(self, translation: Array, rotation: Array, dt: float) -> bool:
        """One tick towards targets (3,) m and (3,) rad; dt, s. True where a limit was active."""
        a = self.translation.step(translation, dt)
        b = self.rotation.step(rotation, dt)
        return a or b
