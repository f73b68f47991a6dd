# SPDX-License-Identifier: Apache-2.0
"""A wrench filter for each axis of the force and some postures, learnt from courses driven with the tracker on the tool.

Let z_a(t) be the motion of the TCP if the deflection that the model predicts for the force f_a of axis a alone, unfiltered, were
sent as an offset: the prediction passed through the measured answer of the arm to an offset. A filter with taps h_a leaves

    d(t) - sum_a sum_i h_a,i z_a(t - i dt)

of the measured deviation d. The taps with the least mean square of it know delay, drives and resonances, the friction of the
moving arm, what the force will do next as far as its past tells it, and what each axis of the force excites. Modes change with
the posture, so that some postures have taps of their own, blended by how near the robot is. Nothing but recordings goes in. Gain
at zero frequency is one for each axis; a constant and a slope of each course are left to the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from irec_calibration.typing import Array
from scipy import linalg, signal

from .errors import SettingsError
from .fir import LONGEST, LOUDEST, MOST

_FEWER = 5  # samples of which one is enough to tell the offset's acceleration; teeth that fold to 50 Hz are met at all phases
_WINDOW, _ROUGHEST = 250, 0.9  # samples of a window; share of the windows that are less rough than the rest
_DENSE, _APART = 12, 2  # taps that are free one by one, samples between those that are free beyond: linear in between
_LOW, _TRUSTED = 4.0, 6.5  # Hz: below, the answer to an offset goes over to what the lowest trusted band says
_HIGH, _GONE = 28.0, 43.0  # Hz: above, the measured answer fades out


@dataclass(frozen=True)
class DrivenCourse:
    """A course without correction.

    Attributes:
        moved: z_a of each axis in the direction that counts, (k, 3), m. deviation: measured, (k,), m.
        sent: the predicted deflection by each axis of the force, (k, 3 axes, 3), m, in base_link.
        near: weight of each posture that has taps of its own, (k, m), sums to one (`fir.nearness`).
        used: samples to learn from, (k,); the samples before them are needed as past.
    """

    moved: Array
    deviation: Array
    sent: Array
    near: Array
    used: Array


@dataclass(frozen=True)
class CourseFilter:
    """Taps (m, n, 3) for m postures, newest sample first; left, before: RMS of the deviation with these taps and unfiltered,
    m; acceleration: RMS of the offset's where it is largest, in a tenth of the time, m/s^2."""

    taps: Array
    left: float
    before: float
    acceleration: float


def impulse(frequency: Array, response: Array, rate: float, length: int = 500) -> Array:
    """Answer of the TCP to a unit offset in one sample, (length, 3, 3), from a measured frequency response.

    Args:
        frequency: Hz, even from 0 to rate / 2, (k,); response: complex, motion along the first axis per offset along the second,
            (k, 3, 3). What is below 4 Hz is told by what is just above: one with a delay, and the rise to the first mode.

    Raises:
        SettingsError: the frequencies are not such.
    """
    f, w = frequency, 2.0 * math.pi * frequency
    if len(f) < length or abs(f[0]) > 1e-9 or abs(f[-1] - 0.5 * rate) > 1e-6 * rate or response.shape != (len(f), 3, 3):
        raise SettingsError(f"an answer to offsets is needed at {length} frequencies or more from 0 to {0.5 * rate:g} Hz")
    trusted = (f >= _LOW) & (f <= _TRUSTED)
    delay = float(np.median(-np.angle(np.trace(response[trusted], axis1=1, axis2=2)) / w[trusted]))
    rise = (np.exp(1j * w * delay)[:, None, None] * response - np.eye(3))[trusted].reshape(-1, 9)
    powers = np.stack([w**2, w**4], axis=1)
    law, *_ = np.linalg.lstsq(powers[trusted].astype(complex), rise, rcond=None)
    low = np.exp(-1j * w * delay)[:, None, None] * (np.eye(3) + (powers @ law).reshape(-1, 3, 3))
    share = np.clip((f - _LOW) / (_TRUSTED - _LOW), 0.0, 1.0)[:, None, None]
    whole = np.where((f < _TRUSTED)[:, None, None], share * response + (1.0 - share) * low, response)
    last = int(np.flatnonzero(f <= _HIGH)[-1])
    fade = np.exp(-1j * (w - w[last]) * delay) * np.clip(1.0 - (f - _HIGH) / (_GONE - _HIGH), 0.0, 1.0)
    whole[last + 1 :] = response[last] * fade[last + 1 :, None, None]
    h = np.asarray(np.fft.irfft(whole, axis=0)[:length])
    end = length // 5
    h[-end:] *= (0.5 + 0.5 * np.cos(math.pi * np.arange(end) / end))[:, None, None]
    spread = np.hanning(77)[1:-1]
    # a lasting offset is answered in full
    h[: len(spread)] += (spread / spread.sum())[:, None, None] * (np.eye(3) - h.sum(axis=0))
    return h


def moved_by(impulses: Sequence[Array], near: Array, offset: Array) -> Array:
    """Motion of the TCP for an offset (k, 3), m, that stood before the first sample, (k, 3).

    Args:
        impulses: of some postures, each as `impulse`; near: weight of each posture at each sample, (k, postures), sums to one.
    """
    out = np.zeros_like(offset)
    for i, h in enumerate(impulses):
        if near[:, i].max() <= 1e-3:
            continue
        past = np.concatenate([np.repeat(offset[:1], len(h), axis=0), offset])
        answer = sum(signal.fftconvolve(past[:, None, b], h[:, :, b], axes=0)[len(h) : len(past)] for b in range(3))
        out += near[:, i, None] * answer
    return out


def spread_postures(q: Array, count: int) -> Array:
    """Joint angles (count, joints), rad, in the middle of as many groups of postures q (k, joints); fewer where q has fewer."""
    few = np.unique(np.round(q[:: max(1, len(q) // 4000)], 4), axis=0)
    middle = few[np.unique(np.linspace(0, len(few) - 1, count).astype(int))]
    for _ in range(50):
        owner = np.argmin(((few[:, None] - middle[None]) ** 2).sum(axis=2), axis=1)
        middle = np.array([few[owner == k].mean(axis=0) if (owner == k).any() else middle[k] for k in range(len(middle))])
    return np.asarray(np.unique(np.round(middle, 6), axis=0))


def learn(courses: Sequence[DrivenCourse], rate: float, acceleration: float, taps: int = 60) -> CourseFilter:
    """Taps with the least mean square of what is left on these courses.

    Args:
        acceleration: m/s^2, largest RMS that the offset's acceleration may have in the roughest tenth of the time, by windows of
            250 samples: a limit that acts in a few cuts makes the largest deviation.
        taps: how many samples back the filter looks.

    Raises:
        SettingsError: a value out of range, too few samples, or no filter stays below the acceleration.
    """
    if not 2 <= taps <= LONGEST:
        raise SettingsError(f"a filter of {taps} taps; 2 to {LONGEST} are possible")
    postures = courses[0].near.shape[1] if courses else 1
    if not 1 <= postures <= MOST:
        raise SettingsError(f"a filter for {postures} postures; 1 to {MOST} are possible")
    basis = _basis(taps)
    samples, unknowns = int(sum(c.used.sum() for c in courses)), 3 * basis.shape[1] * postures
    if samples < 10 * unknowns:
        raise SettingsError(
            f"{samples} samples are too few to learn {taps} taps for each axis at {postures} postures; {10 * unknowns} are needed"
        )
    G, S, worst = (np.zeros((unknowns, unknowns)) for _ in range(3))
    b, power, rough, most = np.zeros(unknowns), 0.0, _rough(courses), 0
    for c, at_worst in zip(courses, rough, strict=True):
        at = np.flatnonzero(c.used)
        free = np.linalg.qr(np.stack([np.ones(len(at)), np.linspace(-1.0, 1.0, len(at))], axis=1))[0]
        A = _features(c.moved, c.near, at, basis)
        A -= free @ (free.T @ A)
        d = c.deviation[at] - free @ (free.T @ c.deviation[at])
        G, b, power = G + A.T @ A, b + A.T @ d, power + float(d @ d)
        for k in range(3):
            quick = _quick(c.sent[:, :, k]) * rate**2
            few = at[k::_FEWER]  # an RMS of fewer samples is the same
            B = _features(quick, c.near, few, basis)
            S += _FEWER * (B.T @ B)
            B = B[at_worst[few]]
            worst, most = worst + B.T @ B, most + len(B)
    one = np.kron(np.eye(3 * postures), basis.sum(axis=0))
    G += 1e-9 * np.trace(G) / len(G) * np.eye(len(G))

    def left(h: Array) -> float:
        return math.sqrt(max(float(power - 2.0 * b @ h + h @ G @ h), 0.0) / samples)

    plain = np.zeros(unknowns)
    plain[:: basis.shape[1]] = 1.0
    for gentle in np.logspace(-12.0, -4.0, 97):
        R = G + gentle * S
        both = linalg.solve(R, np.column_stack([b, one.T]), assume_a="pos")
        x, y = both[:, 0], both[:, 1:]
        h = x + y @ np.linalg.solve(one @ y, 1.0 - one @ x)
        shaken = math.sqrt(3.0 * float(h @ worst @ h) / most)
        found = (h.reshape(postures, 3, -1) @ basis.T).swapaxes(1, 2)
        if shaken <= acceleration and np.abs(found).sum(axis=1).max() <= LOUDEST:
            return CourseFilter(found / found.sum(axis=1, keepdims=True), left(h), left(plain), shaken)
    raise SettingsError(f"no filter keeps the offset's acceleration below {acceleration:.3g} m/s^2 RMS; allow more")


def _quick(x: Array) -> Array:
    """Second differences of x (k, n), 0 at the begin."""
    out = np.zeros_like(x)
    out[2:] = np.diff(x, 2, axis=0)
    return out


def _rough(courses: Sequence[DrivenCourse]) -> list[Array]:
    """Samples of each course that lie in the roughest tenth of the windows, by what would be sent unfiltered, each (k,)."""
    levels = []
    for c in courses:
        size = (_quick(c.sent.sum(axis=1)) ** 2).sum(axis=1) * c.used
        window = np.arange(len(size)) // _WINDOW
        levels.append((np.bincount(window, size) / np.maximum(np.bincount(window, c.used), 1))[window])
    least = np.quantile(np.concatenate([x[c.used] for x, c in zip(levels, courses, strict=True)]), _ROUGHEST)
    return [np.asarray((x >= least) & c.used) for x, c in zip(levels, courses, strict=True)]


def _basis(taps: int) -> Array:
    """Taps as sums of few numbers, (taps, numbers): each of the newest is free, the older ones are linear between knots. Old taps
    that differ from one to the next serve nothing but noise: a drive follows no offset that changes so quickly."""
    knots = np.unique(np.r_[np.arange(min(_DENSE, taps)), np.arange(_DENSE - 1, taps, _APART), taps - 1])
    return np.stack([np.interp(np.arange(taps), knots, one) for one in np.eye(len(knots))], axis=1)


def _features(x: Array, near: Array, at: Array, basis: Array) -> Array:
    """x (k, 3) at samples `at` and before each, newest first, summed by the columns of `basis` (taps, numbers), weighted for each
    posture (k, m) by how near the robot is now; before the begin the first value, (len(at), m 3 numbers)."""
    taps = len(basis)
    back = at[:, None] + taps - 1 - np.arange(taps)
    past = np.concatenate([np.concatenate([np.repeat(x[:1, a], taps - 1), x[:, a]])[back] @ basis for a in range(3)], axis=1)
    return np.asarray((near[at][:, :, None] * past[:, None, :]).reshape(len(at), -1))
