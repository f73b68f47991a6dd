# SPDX-License-Identifier: Apache-2.0
"""How late the robot follows the force, from a recording with the correction in force.

A correction moves the TCP by a matrix times the force of a while ago. So the motion, freed of the slow way, is regressed on the
force of `delay` ago; the delay at which the least is left is the latency (a cross-correlation of three axes with three). What
happens before the wrench is stamped (in the sensor) does not show in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from ..errors import RecordingError
from ..typing import Array

LONGEST = 0.15  # s
STEP = 1e-3  # s, between delays that are tried
LEAST_EXPLAINED = 0.3  # share of the motion's variance below which nothing is said
BLOCKS = 6
_LOW, _HIGH = 1.0, 15.0  # Hz: above the way, below what neither servo nor filters pass


@dataclass(frozen=True)
class Latency:
    """Attributes: delay, se: s; explained: share of the motion's variance; delays, curve: what was tried, (k,) s and (k,)."""

    delay: float
    se: float
    explained: float
    delays: Array
    curve: Array


def find_latency(force_stamp: Array, force: Array, motion_stamp: Array, motion: Array, rate: float = 250.0) -> Latency:
    """Delay from force to motion.

    Args:
        force: (n, 3), N, and motion: of the TCP, (m, 3), m, in one frame; stamps in s on one clock.
        rate: Hz, to which both are brought.

    Raises:
        RecordingError: too short, or the motion does not follow the force (the correction was off, or nothing happened).
    """
    begin, end = max(force_stamp[0], motion_stamp[0]), min(force_stamp[-1], motion_stamp[-1])
    if not end - begin > 5.0:
        raise RecordingError(f"force and motion overlap for {max(end - begin, 0.0):.1f} s; 5 s are needed to find a delay")
    t = np.arange(begin, end, 1.0 / rate)
    sos = signal.butter(2, [_LOW, _HIGH], btype="band", fs=rate, output="sos")

    def banded(stamp: Array, values: Array) -> Array:
        even = np.stack([np.interp(t, stamp, values[:, k]) for k in range(3)], axis=1)
        return np.asarray(signal.sosfiltfilt(sos, even, axis=0))

    f, x = banded(force_stamp, force), banded(motion_stamp, motion)
    delays = np.arange(0.0, LONGEST + STEP / 2, STEP)
    keep = slice(round(rate), len(t) - round(rate))
    late = [np.stack([np.interp(t - d, t, f[:, k]) for k in range(3)], axis=1)[keep] for d in delays]
    x = x[keep]
    curve = np.array([_explained(y, x) for y in late])
    best = int(np.argmax(curve))
    if curve[best] < LEAST_EXPLAINED:
        raise RecordingError(
            f"the force explains {100 * curve[best]:.0f} % of the TCP's unsteady motion at best, "
            f"{100 * LEAST_EXPLAINED:.0f} % are"
            " needed: record with the correction in force and a force that changes"
        )
    blocks = [np.array([_explained(y[b], x[b]) for y in late]) for b in _blocks(len(x))]
    each = [_peak(delays, c) for c in blocks]
    return Latency(_peak(delays, curve), float(np.std(each, ddof=1) / np.sqrt(len(each))), float(curve[best]), delays, curve)


def _blocks(n: int) -> list[slice]:
    edges = np.linspace(0, n, BLOCKS + 1).astype(int)
    return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]


def _explained(f: Array, x: Array) -> float:
    A, *_ = np.linalg.lstsq(f, x, rcond=1e-6)
    return float(1.0 - ((x - f @ A) ** 2).sum() / max(float((x**2).sum()), 1e-30))


def _peak(delays: Array, curve: Array) -> float:
    """Top of the parabola through the best three."""
    i = int(np.clip(np.argmax(curve), 1, len(curve) - 2))
    a, b, c = curve[i - 1 : i + 2]
    bend = a - 2.0 * b + c
    return float(delays[i] + (0.5 * (a - c) / bend * STEP if bend < 0.0 else 0.0))
