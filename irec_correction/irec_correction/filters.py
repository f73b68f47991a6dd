# SPDX-License-Identifier: Apache-2.0
"""Filters of the wrench: one sample of 6 components in, one out. Each tells what it delays."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from irec_calibration.typing import Array
from scipy import signal

from .errors import SettingsError


class Filter(Protocol):
    """One stage. `delay` is that of a slowly changing signal, s."""

    name: str
    delay: float

    def step(self, sample: Array) -> Array:
        """One sample, (6,), at the filter's rate."""
        ...

    def reset(self) -> None:
        """Begin anew: the next sample is taken as having stood for ever."""
        ...


class SecondOrderSections:
    """A linear filter as cascaded second-order sections in transposed direct form II, settled at its first sample."""

    def __init__(self, name: str, sos: Array, rate: float) -> None:
        """Args: sos: sections of unit gain at zero frequency, (s, 6), by scipy; rate: sampling rate, Hz."""
        self.name = name
        self._sections = [tuple(float(x) for x in row) for row in np.atleast_2d(sos)]
        w, h = signal.sosfreqz(sos, worN=[1e-4, 2e-4])
        phase = np.unwrap(np.angle(h))
        self.delay = float(-(phase[1] - phase[0]) / (w[1] - w[0]) / rate)
        self._settled = signal.sosfilt_zi(np.atleast_2d(sos))
        self._z: list[list[Array]] | None = None

    def reset(self) -> None:
        self._z = None

    def step(self, sample: Array) -> Array:
        if self._z is None:
            self._z = [[z1 * sample, z2 * sample] for z1, z2 in self._settled]
        x = sample
        for (b0, b1, b2, _, a1, a2), z in zip(self._sections, self._z, strict=True):
            y = b0 * x + z[0]
            z[0] = b1 * x - a1 * y + z[1]
            z[1] = b2 * x - a2 * y
            x = y
        return x


def low_pass(cutoff: float, order: int, rate: float) -> SecondOrderSections:
    """Butterworth low-pass.

    Args:
        cutoff: -3 dB frequency, Hz; order: 1 to 6; rate: of the samples, Hz.

    Raises:
        SettingsError: cutoff not below half the rate, or order out of range.
    """
    if not 0.0 < cutoff < 0.5 * rate:
        raise SettingsError(f"low-pass at {cutoff:g} Hz is not possible with samples at {rate:g} Hz; 0 .. {rate / 2:g} Hz is")
    if not 1 <= order <= 6:
        raise SettingsError(f"low-pass of order {order}; 1 to 6 are possible")
    return SecondOrderSections(f"low-pass {cutoff:g} Hz", signal.butter(order, cutoff, fs=rate, output="sos"), rate)


def notch(frequency: float, quality: float, rate: float) -> SecondOrderSections:
    """Notch.

    Args:
        frequency: Hz; quality: frequency / bandwidth; rate: of the samples, Hz.

    Raises:
        SettingsError: the frequency is not below half the rate; the message says where it folds to.
    """
    if not 0.0 < frequency < 0.5 * rate:
        folded = abs(frequency - rate * round(frequency / rate))
        raise SettingsError(
            f"notch at {frequency:g} Hz: samples at {rate:g} Hz show that frequency at {folded:g} Hz; put the notch there, "
            "or let the"
            " sensor sample faster"
        )
    if not 0.5 <= quality <= 100.0:
        raise SettingsError(f"quality of a notch is {quality:g}; 0.5 to 100 is possible")
    return SecondOrderSections(f"notch {frequency:g} Hz", signal.tf2sos(*signal.iirnotch(frequency, quality, fs=rate)), rate)


def spindle_notches(speed: float, harmonics: int, quality: float, rate: float) -> list[SecondOrderSections]:
    """Notches at the harmonics of a spindle as the samples show them; a harmonic that folds to below 1 Hz is left alone.

    Args:
        speed: 1/s (rpm / 60); harmonics: how many.
    """
    out = []
    for i in range(1, harmonics + 1):
        seen = abs(i * speed - rate * round(i * speed / rate))
        if 1.0 <= seen < 0.5 * rate:
            out.append(notch(seen, quality, rate))
    return out


class Median:
    """Median of the last samples, component by component: single spikes vanish."""

    def __init__(self, samples: int, rate: float) -> None:
        """Args: samples: odd, 3 to 15; rate: Hz."""
        if samples % 2 == 0 or not 3 <= samples <= 15:
            raise SettingsError(f"median over {samples} samples; an odd number from 3 to 15 is possible")
        self.name = f"median of {samples}"
        self.delay = (samples - 1) / 2 / rate
        self._samples: deque[Array] = deque(maxlen=samples)

    def reset(self) -> None:
        self._samples.clear()

    def step(self, sample: Array) -> Array:
        if not self._samples:
            self._samples.extend([sample] * (self._samples.maxlen or 1))
        self._samples.append(sample)
        return np.sort(np.array(self._samples), axis=0)[len(self._samples) // 2]


@dataclass(frozen=True)
class DelayCost:
    """What a delay costs at the process feed.

    Attributes:
        delay: s. path: how far the tool goes meanwhile, m. deviation: by how much the deflection has changed meanwhile, m.
    """

    delay: float
    path: float
    deviation: float

    def __str__(self) -> str:
        return (
            f"filters delay the wrench by {self.delay * 1e3:.2f} ms: {self.path * 1e3:.3f} mm of path, and"
            f" {self.deviation * 1e6:.1f} um of deviation where the deflection changes as fast as stated"
        )


def delay_cost(filters: Sequence[Filter], feed: float, deflection_slope: float) -> DelayCost:
    """Args: feed: m/s; deflection_slope: change of the deflection per metre of path, m/m."""
    delay = sum(f.delay for f in filters)
    path = delay * feed
    if not math.isfinite(path * deflection_slope):
        raise SettingsError(f"feed {feed} m/s and slope {deflection_slope} m/m of the deflection must be numbers")
    return DelayCost(delay, path, path * abs(deflection_slope))
