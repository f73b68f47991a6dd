# SPDX-License-Identifier: Apache-2.0
"""The robot controller: position servo, force controller, and the correction channel that holds and fades."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .kinematics import Array


@dataclass(frozen=True)
class Servo:
    """Position servo of all axes: first order with a velocity limit. time_constant s; velocity (n,) rad/s."""

    time_constant: float
    velocity: Array

    def follow(self, q: Array, command: Array, dt: float) -> Array:
        """Joint angles dt seconds later, (n,), rad."""
        step = (command - q) * (1.0 - math.exp(-dt / self.time_constant))
        limit = self.velocity * dt
        return q + np.clip(step, -limit, limit)


@dataclass(frozen=True)
class ForceController:
    """Integrates a TCP displacement along x, y, z of tool0 until the force set point is read.

    Attributes:
        bandwidth: rad/s, of the closed loop on a contact of `stiffness` (N/m, robot and disc in series).
        speed: m/s, largest TCP speed; the speed of the advance before contact.
        lateral_onset: N of normal force before which lateral set points are not sought (there is nothing to push against).
    """

    bandwidth: float = 14.0
    stiffness: float = 7.0e5
    speed: float = 0.005
    lateral_onset: float = 60.0

    def displacement(self, setpoint: Array, reading: Array, dt: float) -> Array:
        """Displacement of the commanded TCP in dt, in tool0, (3,), m; forces of the environment on the robot, N."""
        wanted = setpoint - reading
        if abs(reading[2]) < self.lateral_onset:
            wanted = np.array([0.0, 0.0, wanted[2]])
        velocity = -self.bandwidth / self.stiffness * wanted
        size = math.sqrt(float(velocity @ velocity))
        return velocity * (dt * min(1.0, self.speed / size)) if size > 0.0 else np.zeros(3)


@dataclass
class OffsetChannel:
    """Correction input: holds the last offset when none comes, then fades it out, and fades in again.

    Attributes:
        hold_after, fade_after: s without a new offset; fade_time: s from full to nothing and back.
        max_translation: m; max_turn: rad; larger offsets are cut.
    """

    hold_after: float = 0.02
    fade_after: float = 0.1
    fade_time: float = 0.5
    max_translation: float = 0.005
    max_turn: float = math.radians(1.0)
    late: int = 0

    def __post_init__(self) -> None:
        self._wanted = np.zeros(6)
        self._received = -math.inf
        self._weight = 0.0
        self._late_now = False
        self._fading = False

    def fade(self) -> None:
        """Two nodes send offsets: keep the last one, fade it out, take none before it is at zero."""
        self._fading = True

    def take(self, translation: Array, turn: Array, now: float) -> None:
        """A new offset (m and rotation vector in base_link) arrived at `now` s."""
        if self._fading:
            return
        for part, value, limit in ((slice(0, 3), translation, self.max_translation), (slice(3, 6), turn, self.max_turn)):
            size = float(np.linalg.norm(value))
            self._wanted[part] = value * (limit / size) if size > limit else value
        self._received = now
        self._late_now = False

    def applied(self, now: float, dt: float, enabled: bool) -> Array:
        """Offset to apply in this cycle, (6,): m and rad in base_link."""
        age = now - self._received
        if age > self.hold_after and math.isfinite(age) and not self._late_now:
            self.late += 1
            self._late_now = True
        self._fading = self._fading and self._weight > 0.0
        rising = enabled and age <= self.fade_after and not self._fading
        self._weight = min(1.0, max(0.0, self._weight + (dt if rising else -dt) / self.fade_time))
        if self._weight == 0.0:
            return np.zeros(6)
        return self._wanted * (0.5 - 0.5 * math.cos(math.pi * self._weight))
