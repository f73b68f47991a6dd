# SPDX-License-Identifier: Apache-2.0
"""Instruments and channel of production, for all courses at once: force sensor, transport of the offset, position servo."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ..kinematics import Array
from .hard import Channel, ForceSensor
from .ways import PERIOD

ZEROING = 0.2  # s


class Sensor:
    """Force sensor with bandwidth, noise, drift of the bias since zeroing, and delay in whole periods."""

    def __init__(self, settings: ForceSensor | None, rows: int, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._drift = rng.normal(0.0, settings.drift, (rows, 3)) if settings else np.zeros((rows, 3))
        self._value: Array | None = None
        self._keep = math.exp(-2.0 * math.pi * settings.bandwidth * PERIOD) if settings else 0.0
        late = round(settings.delay / PERIOD) if settings else 0
        self._late: deque[Array] = deque(maxlen=late + 1)

    def gain(self, frequency: float) -> float:
        """Of a sine, Hz."""
        return 1.0 / math.hypot(1.0, frequency / self._settings.bandwidth) if self._settings else 1.0

    def in_air(self, reading: Array, rng: np.random.Generator) -> Array:
        """Mean over `ZEROING` s where nothing touches the tool, (rows, 3), N; reading: of an ideal sensor there."""
        if self._settings is None:
            return reading
        noise = self._settings.noise / math.sqrt(ZEROING / PERIOD)
        return np.asarray(reading + self._drift + rng.normal(0.0, noise, reading.shape))

    def read(self, force: Array, tooth: Array) -> Array:
        """Reading now for forces (rows, 3), N, and what is left of tooth passing in it, (rows, 3), N."""
        if self._settings is None:
            return force
        self._value = force if self._value is None else self._keep * self._value + (1.0 - self._keep) * force
        noise = self._rng.normal(0.0, self._settings.noise, force.shape)
        self._late.append(self._value + tooth + noise + self._drift)
        return self._late[0]


class OffsetPath:
    """Offsets of all rows on their way to the motors: transport with jitter, then the position servo (second order).

    Attributes:
        value, acceleration: of the motors' offset, (rows, 3), m and m/s^2.
    """

    def __init__(self, settings: Channel | None, rows: int, rng: np.random.Generator) -> None:
        self._settings, self._rng = settings, rng
        self.value, self.acceleration = np.zeros((rows, 3)), np.zeros((rows, 3))
        self._rate, self._target, self._taken = np.zeros((rows, 3)), np.zeros((rows, 3)), np.zeros(rows)
        self._under_way: deque[tuple[Array, Array]] = deque()

    def step(self, now: float, sent: Array) -> None:
        """One period; `sent` (rows, 3), m, leaves the computer now."""
        s = self._settings
        if s is None:
            before, rate = self.value, self._rate
            self.value = sent.copy()
            self._rate = (self.value - before) / PERIOD
            self.acceleration = (self._rate - rate) / PERIOD
            return
        arrives = now + s.delay + self._rng.uniform(0.0, s.jitter, len(sent))
        self._under_way.append((arrives, sent.copy()))
        while self._under_way and np.all(self._under_way[0][0] <= now):
            self._take(*self._under_way.popleft(), now)
        for stamps, offset in self._under_way:
            self._take(stamps, offset, now)
        w, zeta, fine = 2.0 * math.pi * s.servo, s.servo_damping, PERIOD / 4
        begin = self._rate
        for _ in range(4):
            self._rate = self._rate + fine * (w * w * (self._target - self.value) - 2.0 * zeta * w * self._rate)
            self.value = self.value + fine * self._rate
        self.acceleration = (self._rate - begin) / PERIOD

    def _take(self, stamps: Array, offset: Array, now: float) -> None:
        """A later packet never gives way to an earlier one."""
        there = (stamps <= now) & (stamps > self._taken)
        self._target[there] = offset[there]
        self._taken[there] = stamps[there]
