# SPDX-License-Identifier: Apache-2.0
"""A wrench filter that is designed for what was measured: it smooths and looks ahead at once (Wiener filter).

Of all filters with n taps it has the least mean square of the deviation that is left,

    mean over the postures of  E || C [ P f - Q sum_i h_i y(t - i dt) ] ||^2,

with y the measured force, f its part without sensor noise, C f the static deflection, P the answer of the TCP to a force and Q
that to an offset as it was sent, both over frequency: sensor, transport, drives and structure are in them, so the filter undoes
delay and resonance as far as the spectrum of the force lets it. Without P and Q a lead alone is undone: P = exp(j w lead), Q = 1.
Its gain at zero frequency is one exactly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal

from ..errors import RecordingError
from ..typing import Array

LONGEST = 250  # taps, of any filter that the correction takes


@dataclass(frozen=True)
class Response:
    """Answers of the TCP at one posture, in the direction that counts.

    Attributes:
        frequency: (k,), Hz, rising. to_force: complex (k,), motion per force as read, as a share of the static compliance.
        to_offset: complex (k,), motion per offset as sent.
    """

    frequency: Array
    to_force: Array
    to_offset: Array

    def at(self, frequency: Array) -> tuple[Array, Array]:
        """P and Q at frequencies (n,), Hz. Below what was measured: one, with the delay of the lowest; above: P is taken as 0."""
        f = self.frequency
        low, high = frequency < f[0], frequency > f[-1]
        out = []
        for measured in (self.to_force, self.to_offset):
            x = np.interp(frequency, f, measured.real) + 1j * np.interp(frequency, f, measured.imag)
            x[low] = np.exp(1j * np.angle(measured[0]) * frequency[low] / f[0])
            out.append(x)
        out[0][high] = 0.0
        return out[0], out[1]


@dataclass(frozen=True)
class Design:
    """A designed filter.

    Attributes:
        taps: (n,), newest sample first; rate: Hz; lead: s that it looks ahead where no responses were given.
        left: RMS of the deviation that is left as a share of that without correction, of the unsteady force.
        before: the same of a low-pass that does not look ahead, for comparison.
        acceleration: RMS of the offset's acceleration by the unsteady force and the noise, m/s^2.
    """

    taps: Array
    rate: float
    lead: float
    left: float
    before: float
    acceleration: float


def spectrum(force: Array, rate: float) -> tuple[Array, Array]:
    """Power spectrum of a force (n, 3), summed over the axes, each freed of its slow course: Hz (k,) and N^2/Hz (k,)."""
    if len(force) < 4 * 256:
        raise RecordingError(f"{len(force)} samples of force are too few to design a filter; {4 * 256} are needed")
    f, p = signal.welch(force, fs=rate, nperseg=min(1024, len(force) // 2), axis=0, detrend="linear")
    return f, p.sum(axis=1)


def missed(taps: Array, rate: float, responses: Sequence[Response], frequency: Array) -> Array:
    """RMS over the postures of |P - Q h| at frequencies (k,), Hz: share of the static deflection that is left, (k,)."""
    h = np.exp(-2j * math.pi * frequency[:, None] * np.arange(len(taps)) / rate) @ taps
    return np.asarray(np.sqrt(np.mean([np.abs(P - Q * h) ** 2 for P, Q in (r.at(frequency) for r in responses)], axis=0)))


def design(
    force: Array, rate: float, lead: float, noise: float, taps: int = 60, responses: Sequence[Response] = (),
    cutoff: float = 40.0, compliance: float = 1e-6, acceleration: float = math.inf,
) -> Design:  # fmt: skip
    """Design a filter for a recorded force.

    Args:
        force: in tool0 with the process running steadily, (n, 3), N; rate: Hz.
        lead: s from a reading to the motion that it causes (`irec latency`), 0 .. 0.1; of no account where responses are given.
        noise: of the sensor, N per sample and axis, one standard deviation.
        taps: how many samples back it looks; responses: one for each posture; cutoff: of the low-pass to compare with, Hz.
        compliance: m/N, largest of the TCP; acceleration: m/s^2, largest RMS that the offset's acceleration may have.

    Raises:
        RecordingError: a value out of range, too few samples, or no filter stays below the acceleration.
    """
    if not 0.0 <= lead <= 0.1:
        raise RecordingError(f"lead of the filter is {lead} s; 0 .. 0.1 s is possible")
    if not 2 <= taps <= LONGEST:
        raise RecordingError(f"a filter of {taps} taps; 2 to {LONGEST} are possible")
    f, density = spectrum(force, rate)
    white = 2.0 * 3.0 * noise**2 / rate  # one-sided, three axes
    grid = np.linspace(0.0, 0.5 * rate, 2049)
    measured, true = (np.interp(grid, f, x) for x in (density, np.maximum(density - white, 1e-4 * density)))
    pairs = [r.at(grid) for r in responses] or [(np.exp(2j * math.pi * grid * lead), np.ones(len(grid), dtype=complex))]
    through = np.mean([np.abs(Q) ** 2 for _, Q in pairs], axis=0)
    across = np.mean([P * Q.conj() for P, Q in pairs], axis=0)
    shake = (2.0 * math.pi * grid) ** 4 * (true + white)
    late = np.exp(-2j * math.pi * grid[:, None] * np.arange(taps) / rate)
    r = (late.conj() * (true * across)[:, None]).real.sum(axis=0)

    def solved(gentle: float) -> Array:
        R = linalg.toeplitz((late * ((true + white) * through + gentle * shake)[:, None]).real.sum(axis=0))
        R += 1e-9 * R[0, 0] * np.eye(taps)
        a, b = linalg.solve(R, r, assume_a="pos"), linalg.solve(R, np.ones(taps), assume_a="pos")
        return np.asarray(a + b * (1.0 - a.sum()) / b.sum())

    def shaken(gain: Array) -> float:
        return float(compliance * np.sqrt(((2.0 * math.pi * grid) ** 4 * measured * np.abs(gain) ** 2).sum() * grid[1]))

    def left(gain: Array) -> float:
        rest = [true * np.abs(P - Q * gain) ** 2 + white * np.abs(Q * gain) ** 2 for P, Q in pairs]
        return float(np.sqrt(np.sum(rest) / max(float(np.sum([true * np.abs(P) ** 2 for P, _ in pairs])), 1e-30)))

    for gentle in (0.0, *np.logspace(-14.0, -4.0, 31)):
        h = solved(float(gentle))
        if shaken(late @ h) <= acceleration:
            break
    else:
        raise RecordingError(f"no filter keeps the offset's acceleration below {acceleration:.3g} m/s^2 RMS; allow more")
    sos = signal.butter(2, min(cutoff, 0.45 * rate), fs=rate, output="sos")
    plain = signal.sosfreqz(sos, worN=grid, fs=rate)[1]
    return Design(h, rate, lead, left(late @ h), left(plain), shaken(late @ h))
