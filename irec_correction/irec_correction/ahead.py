# SPDX-License-Identifier: Apache-2.0
"""A wrench filter that is designed for what was measured: it smooths and looks ahead at once (Wiener filter).

Of all filters with n taps it has the least mean square of the deviation that is left,

    E || H(s) C [ f(t + lead) - sum_i h_i y(t - i dt) ] ||^2 + weight of the offset's noise,

with y the measured force, f its part without sensor noise, C f the static deflection and H the response of the structure: a force
near a mode of the arm counts as much more as the mode answers. Its gain at zero frequency is one exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from irec_calibration.typing import Array
from scipy import linalg, signal

from .errors import SettingsError

LONGEST = 250  # taps


class Fir:
    """Weighted sum of the last samples, newest first; gain one at zero frequency. `delay` is negative where it looks ahead."""

    def __init__(self, taps: Array, rate: float, name: str = "designed filter") -> None:
        """Args: taps: (n,), newest sample first; rate: Hz. Raises SettingsError."""
        self.taps = np.asarray(taps, dtype=float)
        if self.taps.ndim != 1 or not 1 <= len(self.taps) <= LONGEST or not np.isfinite(self.taps).all():
            raise SettingsError(f"a designed filter has 1 to {LONGEST} finite taps, not {np.shape(taps)}")
        if abs(self.taps.sum() - 1.0) > 1e-6:
            raise SettingsError(
                f"the taps of a designed filter sum to {self.taps.sum():.6f}; a constant force must pass unchanged"
            )
        if np.abs(self.taps).sum() > 50.0:
            raise SettingsError(f"the taps of a designed filter sum to {np.abs(self.taps).sum():.0f} in size; 50 is allowed")
        self.name = name
        self.delay = float(self.taps @ np.arange(len(self.taps)) / rate)
        self._past: Array | None = None
        self._at = 0

    def reset(self) -> None:
        """Begin anew: the next sample is taken as having stood for ever."""
        self._past = None

    def step(self, sample: Array) -> Array:
        """One sample (6,)."""
        n = len(self.taps)
        if self._past is None:
            self._past = np.tile(sample, (2 * n, 1))
        self._at = (self._at - 1) % n
        self._past[self._at] = self._past[self._at + n] = sample  # twice, so that the last n lie in one piece
        return np.asarray(self.taps @ self._past[self._at : self._at + n])


@dataclass(frozen=True)
class StructureMode:
    """One mode of the structure as the TCP shows it: Hz, share of critical damping, share of the static deflection it carries."""

    frequency: float
    damping: float
    share: float


@dataclass(frozen=True)
class Design:
    """A designed filter.

    Attributes:
        taps: (n,), newest sample first; rate: Hz; lead: s that it looks ahead.
        left: RMS of the deviation that is left as a share of that without correction, of the unsteady force.
        before: the same of a low-pass that does not look ahead, for comparison.
    """

    taps: Array
    rate: float
    lead: float
    left: float
    before: float


def response(modes: Sequence[StructureMode], frequency: Array) -> Array:
    """|H|^2 of the structure at frequencies (k,), Hz: modes with their shares, the rest answers at once."""
    f = np.asarray(frequency, dtype=float)
    H = np.full(f.shape, 1.0 - sum(m.share for m in modes), dtype=complex)
    for m in modes:
        x = f / m.frequency
        H = H + m.share / (1.0 - x * x + 2j * m.damping * x)
    return np.asarray(np.abs(H) ** 2)


def spectrum(force: Array, rate: float) -> tuple[Array, Array]:
    """Power spectrum of a force (n, 3), summed over the axes, each freed of its slow course: Hz (k,) and N^2/Hz (k,)."""
    if len(force) < 4 * 256:
        raise SettingsError(f"{len(force)} samples of force are too few to design a filter; {4 * 256} are needed")
    f, p = signal.welch(force, fs=rate, nperseg=min(1024, len(force) // 2), axis=0, detrend="linear")
    return f, p.sum(axis=1)


def design(
    force: Array, rate: float, lead: float, noise: float, taps: int = 60, modes: Sequence[StructureMode] = (),
    cutoff: float = 40.0, roughness: float = 0.0,
) -> Design:  # fmt: skip
    """Design a filter for a recorded force.

    Args:
        force: in tool0 with the process running steadily, (n, 3), N; rate: Hz.
        lead: s from a reading to the motion that it causes (`irec latency`), 0 .. 0.1.
        noise: of the sensor, N per sample and axis, one standard deviation.
        taps: how many samples back it looks; modes: of the structure; cutoff: of the low-pass to compare with, Hz.
        roughness: s^2, weight of the offset's acceleration: larger is gentler on the drives.

    Raises:
        SettingsError: a value out of range, or too few samples.
    """
    if not 0.0 <= lead <= 0.1:
        raise SettingsError(f"lead of the filter is {lead} s; 0 .. 0.1 s is possible")
    if not 2 <= taps <= LONGEST:
        raise SettingsError(f"a filter of {taps} taps; 2 to {LONGEST} are possible")
    f, measured = spectrum(force, rate)
    white = 2.0 * 3.0 * noise**2 / rate  # one-sided, three axes
    true = np.maximum(measured - white, 1e-4 * measured)
    weight = response(modes, f)
    grid = np.linspace(0.0, 0.5 * rate, 2049)
    signal_part = np.interp(grid, f, true * weight)
    noise_part = np.interp(grid, f, np.full_like(f, white) * weight)
    curvature = roughness * (2.0 * math.pi * grid) ** 4 * np.interp(grid, f, measured) * 1e-6
    step = grid[1]

    def correlation(density: Array, at: Array) -> Array:
        return np.asarray((density[None, :] * np.cos(2.0 * math.pi * at[:, None] * grid[None, :])).sum(axis=1) * step)

    lags = np.arange(taps) / rate
    R = linalg.toeplitz(correlation(signal_part + noise_part + curvature, lags))
    r = correlation(signal_part, lags + lead)
    R += 1e-9 * R[0, 0] * np.eye(taps)
    ones = np.ones(taps)
    a, b = linalg.solve(R, r, assume_a="pos"), linalg.solve(R, ones, assume_a="pos")
    h = a + b * (1.0 - ones @ a) / (ones @ b)

    def left(gain: Array) -> float:
        ahead = np.exp(2j * math.pi * grid * lead)
        rest = signal_part * np.abs(ahead - gain) ** 2 + noise_part * np.abs(gain) ** 2
        return float(np.sqrt(rest.sum() / max(signal_part.sum(), 1e-30)))

    own = np.exp(-2j * math.pi * grid[:, None] * lags[None, :]) @ h
    sos = signal.butter(2, min(cutoff, 0.45 * rate), fs=rate, output="sos")
    plain = signal.sosfreqz(sos, worN=grid, fs=rate)[1]
    return Design(h, rate, lead, left(own), left(plain))
