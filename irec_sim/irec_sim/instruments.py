# SPDX-License-Identifier: Apache-2.0
"""Noise, delay and drop-outs of the streams, each instrument with a random generator of its own (repeatable by seed)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from .kinematics import Array

T = TypeVar("T")


@dataclass(frozen=True)
class InstrumentSettings:
    """Parameters of the streams.

    Attributes:
        force_noise: N per sample and axis; torque_noise: N m; force_bias: N, of the raw reading; force_drift: N in 10 min.
        encoder_noise: rad per sample.
        tracker_white, tracker_slow: per sample, as shares of the data sheet's standard deviation; slow: air, over 10 s.
        force_delay, tracker_delay: s; the stamp is that of the reading.
        dropout: probability per tracker sample that a drop-out begins; dropout_time: its mean length, s.
    """

    force_noise: float = 2.0
    torque_noise: float = 0.3
    force_bias: tuple[float, ...] = (18.0, -11.0, 25.0, 1.2, -0.8, 0.5)
    force_drift: float = 0.5
    encoder_noise: float = 5e-7
    tracker_white: float = 0.44
    tracker_slow: float = 0.9
    force_delay: float = 0.0
    tracker_delay: float = 0.0
    dropout: float = 1e-4
    dropout_time: float = 0.05


class SlowNoise:
    """Gauss-Markov noise of unit standard deviation and a given correlation time, dim values."""

    def __init__(self, time: float, dim: int, rng: np.random.Generator) -> None:
        self._time, self._rng = time, rng
        self._value = rng.standard_normal(dim)
        self._at = 0.0

    def at(self, t: float) -> Array:
        """Value at time t >= that of the last call, s."""
        keep = math.exp(-(t - self._at) / self._time)
        self._value = keep * self._value + math.sqrt(max(0.0, 1.0 - keep * keep)) * self._rng.standard_normal(self._value.shape)
        self._at = t
        return self._value


class DropOuts:
    """Whether a stream is silent now: outages begin at random and last an exponentially distributed time."""

    def __init__(self, probability: float, mean_time: float, rng: np.random.Generator) -> None:
        self._probability, self._mean, self._rng = probability, mean_time, rng
        self._until = -math.inf

    def silent(self, t: float) -> bool:
        """To be asked once per sample, t in s."""
        if t < self._until:
            return True
        if self._probability > 0.0 and self._rng.random() < self._probability:
            self._until = t + self._rng.exponential(self._mean)
            return True
        return False


class Delay(Generic[T]):
    """Holds values back: what comes out at t was put in at t - delay or just before."""

    def __init__(self, delay: float) -> None:
        self.delay = delay
        self._queue: deque[tuple[float, T]] = deque()

    def pass_through(self, t: float, value: T) -> T:
        """Put a value in at t (s) and take out the one that is due."""
        self._queue.append((t, value))
        while len(self._queue) > 1 and self._queue[1][0] <= t - self.delay + 1e-9:
            self._queue.popleft()
        return self._queue[0][1]


class Noise:
    """The generators of all instruments of a cell, from one seed."""

    def __init__(self, seed: int, settings: InstrumentSettings, joints: int, stations: int) -> None:
        force, encoder, tracker, drop, slow, temperature = (np.random.default_rng([seed, 100 + i]) for i in range(6))
        self.settings, self._force, self._encoder, self._tracker = settings, force, encoder, tracker
        self.temperature = temperature
        self.drop_outs = [DropOuts(settings.dropout, settings.dropout_time, drop) for _ in range(stations)]
        self._air = [SlowNoise(10.0, 3, slow) for _ in range(stations)]
        self._bias = SlowNoise(600.0, 6, slow)
        self._joints = joints

    def force(self, t: float) -> Array:
        """Noise and drift of one reading of the force sensor, (6,), N and N m."""
        s = self.settings
        scale = np.array([s.force_noise] * 3 + [s.torque_noise] * 3)
        return self._force.standard_normal(6) * scale + self._bias.at(t) * s.force_drift * np.array([1, 1, 1, 0.1, 0.1, 0.1])

    def encoder(self) -> Array:
        """(joints,), rad."""
        return self._encoder.standard_normal(self._joints) * self.settings.encoder_noise

    def tracker(self, station: int, t: float, sigma: float) -> Array:
        """(3,), m, at the data sheet's standard deviation sigma."""
        s = self.settings
        return sigma * (s.tracker_white * self._tracker.standard_normal(3) + s.tracker_slow * self._air[station].at(t))
