# SPDX-License-Identifier: Apache-2.0
"""Modes of arm and head from a tap or a swept force: frequency, damping, share of the static deflection.

The response of the TCP to the force is estimated over frequency and fitted by

    X(w) / F(w) = exp(-j w tau) [ sum_m R_m / (w_m^2 - w^2 + 2 j zeta_m w_m w) + D ],

R_m and D real 3 x 3 matrices (linear, solved for), w_m, zeta_m and the delay tau of the tracker by least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, signal

from ..errors import RecordingError
from ..typing import Array

LOWEST, HIGHEST = 2.0, 40.0  # Hz
MOST = 4
WORTH = 0.75  # a further mode has to lower the sum of squares to this share
LEAST_COHERENCE = 0.5
LEAST_FORCE = 0.2  # share of the largest force over frequency below which a frequency is left out


@dataclass(frozen=True)
class FoundMode:
    """frequency: Hz, damping: share of critical, share: of the static compliance (trace); direction: unit, largest answer."""

    frequency: float
    damping: float
    share: float
    direction: Array


@dataclass(frozen=True)
class Structure:
    """Modes found, and how well: left: RMS of the fit as a share of the response; delay: s, of the motion's instrument."""

    modes: tuple[FoundMode, ...]
    static: Array
    delay: float
    left: float
    frequency: Array
    measured: Array
    fitted: Array


def find_structure(force: Array, motion: Array, rate: float) -> Structure:
    """Modes from force (n, 3), N, and motion of the TCP (n, 3), m, in one frame at one rate (Hz).

    Raises:
        RecordingError: too short, or the motion does not follow the force.
    """
    n = min(len(force), len(motion))
    length = min(n, int(8.0 * rate))
    if n < 8.0 * rate:
        raise RecordingError(f"{n / rate:.1f} s of force and motion; 8 s are needed to tell modes")
    f, F, H = frequency_response(force[:n], motion[:n], rate, length // 2)
    used = (f >= LOWEST) & (f <= min(HIGHEST, 0.4 * rate))
    Fs, H = F[used], H[used]
    power = np.stack([signal.welch(motion[:n, k], fs=rate, nperseg=length // 2)[1] for k in range(3)]).sum(axis=0)[used]
    weight = np.sqrt(np.maximum(np.trace(Fs, axis1=1, axis2=2).real, 0.0))
    told = np.einsum("kij,kjl,kil->k", H, Fs, H.conj()).real / np.maximum(power, 1e-300)
    if float(np.median(told)) < LEAST_COHERENCE:
        raise RecordingError(
            f"the force explains {100 * float(np.median(told)):.0f} % of the motion between {LOWEST:g} and {HIGHEST:g} Hz:"
            " tap harder, sweep longer, or keep the process off"
        )
    pushed = weight > LEAST_FORCE * weight.max()  # where there was no force, there is only noise
    return _fit(f[used][pushed], H[pushed], weight[pushed] / weight.max())


def frequency_response(given: Array, motion: Array, rate: float, samples: int) -> tuple[Array, Array, Array]:
    """Motion of the TCP (n, 3) per force or offset that was given (n, 3), over frequency.

    Returns:
        frequency (k,), Hz; spectrum of what was given (k, 3, 3); response (k, 3, 3), complex. Averaged over blocks of `samples`.
    """
    kind = {"fs": rate, "nperseg": samples, "axis": 0}
    f, S = signal.csd(given[:, :, None], given[:, None, :], **kind)
    _, X = signal.csd(given[:, :, None], motion[:, None, :], **kind)
    S = S + 1e-9 * np.trace(S, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return f, S, np.linalg.solve(S, X).swapaxes(1, 2)


def _fit(f: Array, H: Array, weight: Array) -> Structure:
    size = np.linalg.norm(H.reshape(len(f), 9), axis=1)
    peaks, _ = signal.find_peaks(np.log(size), prominence=0.2)
    order = peaks[np.argsort(-size[peaks])]  # the largest answer first: a prominent peak may be noise
    starts = [float(f[i]) for i in order] or [float(f[int(np.argmax(size))])]
    target = H.reshape(len(f), 9)
    best = start = np.zeros(0), np.inf
    for count in range(1, min(MOST, len(starts) + 1) + 1):
        guess = starts[:count] + [0.5 * (starts[0] + f[-1])] * (count - len(starts[:count]))
        tries = [guess] if best is start else [guess, [*np.exp(best[0][: count - 1]), 1.12 * float(np.exp(best[0][0]))]]
        fits = [_solve(f, target, weight, np.array(g)) for g in tries]
        x, cost = min(fits, key=lambda pair: pair[1])
        if cost > WORTH * best[1]:
            break
        best = (x, cost)
    x = best[0]
    model, R, D, w, zeta = _model(f, target, weight, x)
    static = sum(R[m] / w[m] ** 2 for m in range(len(w))) + D
    whole = float(np.trace(static))
    modes = []
    for m in np.argsort(w):
        values, vectors = np.linalg.eigh(0.5 * (R[m] + R[m].T))
        k = int(np.argmax(np.abs(values)))
        share = float(np.trace(R[m]) / w[m] ** 2 / whole)
        modes.append(FoundMode(float(w[m] / (2 * np.pi)), float(zeta[m]), share, vectors[:, k]))
    heavy = weight[:, None]
    left = float(np.sqrt((np.abs(heavy * (model - target)) ** 2).sum() / (np.abs(heavy * target) ** 2).sum()))
    norm = np.linalg.norm(model, axis=1)
    return Structure(tuple(modes), static, float(x[-1]), left, f, size, norm)


def _basis(f: Array, x: Array) -> tuple[Array, Array, Array]:
    count = (len(x) - 1) // 2
    w, zeta = 2.0 * np.pi * np.exp(x[:count]), np.exp(x[count : 2 * count])
    s = 2.0 * np.pi * f[:, None]
    modal = 1.0 / (w**2 - s**2 + 2j * zeta * w * s)
    return np.exp(-1j * s * x[-1]) * np.concatenate([modal, np.ones((len(f), 1))], axis=1), w, zeta


def _linear(B: Array, target: Array, weight: Array) -> Array:
    A = weight[:, None] * B
    scale = np.linalg.norm(A, axis=0)
    real = np.concatenate([A.real, A.imag]) / scale
    y = weight[:, None] * target
    solved, *_ = np.linalg.lstsq(real, np.concatenate([y.real, y.imag]), rcond=1e-10)
    return np.asarray(solved / scale[:, None])


def _model(f: Array, target: Array, weight: Array, x: Array) -> tuple[Array, Array, Array, Array, Array]:
    B, w, zeta = _basis(f, x)
    c = _linear(B, target, weight)
    return B @ c, c[:-1].reshape(-1, 3, 3), c[-1].reshape(3, 3), w, zeta


def _solve(f: Array, target: Array, weight: Array, start: Array) -> tuple[Array, float]:
    count = len(start)
    x0 = np.r_[np.log(start), np.full(count, np.log(0.05)), 0.0]
    low = np.r_[np.full(count, np.log(0.5 * f[0])), np.full(count, np.log(2e-3)), -0.02]
    high = np.r_[np.full(count, np.log(2.0 * f[-1])), np.full(count, np.log(0.6)), 0.1]
    scale = np.sqrt((np.abs(weight[:, None] * target) ** 2).sum())

    def residual(x: Array) -> Array:
        B = _basis(f, x)[0]
        r = weight[:, None] * (B @ _linear(B, target, weight) - target) / scale
        return np.concatenate([r.real.ravel(), r.imag.ravel()])

    found = optimize.least_squares(residual, np.clip(x0, low + 1e-9, high - 1e-9), bounds=(low, high), max_nfev=60)
    return found.x, float(2.0 * found.cost)
