# SPDX-License-Identifier: Apache-2.0
"""How the TCP answers to an offset: from a measured frequency response, and along a course."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from irec_calibration.typing import Array
from scipy import signal

from .errors import SettingsError

_LOW, _TRUSTED = 4.0, 6.5  # Hz: below, the answer to an offset goes over to what the lowest trusted band says
_HIGH, _GONE = 28.0, 43.0  # Hz: above, the measured answer fades out


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


def moved_by_axes(impulses: Sequence[Array], near: Array, slope: Array, force: Array, counts: Array) -> Array:
    """What `moved_by` is along `counts` (k, 3) for offsets of the size of each axis of the force along each axis, (k, 3, 3).

    The slope (k, 3, 3), m/N, is taken where the robot is now: it changes little while an offset acts.
    """
    out = np.zeros((len(force), 3, 3))
    for i, h in enumerate(impulses):
        if near[:, i].max() <= 1e-3:
            continue
        past = np.concatenate([np.repeat(force[:1], len(h), axis=0), force])
        answer = signal.fftconvolve(past[:, :, None, None], h[:, None], axes=0)[len(h) : len(past)]
        out += near[:, i, None, None] * (slope @ np.einsum("km,kbmp->kpb", counts, answer))
    return out
