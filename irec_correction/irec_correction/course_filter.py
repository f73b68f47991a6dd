# SPDX-License-Identifier: Apache-2.0
"""A wrench filter for some postures, each axis from its own or from all axes of the force, learnt from courses driven with the
tracker on the tool.

Let z_ab(t) be the motion of the TCP if the deflection that the model predicts for a force along axis a of the tool, as large as
the force f_b of axis b is, were sent as an offset: the prediction passed through the measured answer of the arm to an offset. A
filter with taps h_ab leaves

    d(t) - sum_ab sum_i h_ab,i z_ab(t - i dt)

of the measured deviation d. The taps with the least mean square of it know delay, drives and resonances, the friction of the
moving arm, what the force will do next as far as its past tells it, and what each axis of the force excites: a mode that a force
along one axis sets off may be quieted best by an offset along another one. Modes change with the posture, so that some postures
have taps of their own, blended by how near the robot is. Nothing but recordings goes in. At zero frequency each axis passes as
it is and no other one; a constant and a slope of each course are left to the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from irec_calibration.typing import Array
from scipy import linalg

from .errors import SettingsError
from .fir import LONGEST, LOUDEST, MOST

# samples for each number that is looked for; where there are more, only every second or third is learnt from: what is left
# changes slowly against that
_ENOUGH, _EVERY = 50, 3
_FEWER = 5  # of these, of which one is enough to tell the offset's acceleration; teeth that fold to 50 Hz are met at all phases
_WINDOW, _ROUGHEST = 250, 0.9  # samples of a window; share of the windows that are less rough than the rest
_DENSE, _APART = 12, 2  # taps that are free one by one, samples between those that are free beyond: linear in between
_DENSE_CROSSED, _APART_CROSSED = 8, 3  # the same of an axis that is answered along another one


@dataclass(frozen=True)
class DrivenCourse:
    """A course without correction.

    Attributes:
        moved: z_ab in the direction that counts, (k, 3 axes a, 3 axes b), m. deviation: measured, (k,), m.
        slope: the predicted deflection per force along each axis, (k, 3 axes, 3), m/N, in base_link; force: that is filtered,
        (k, 3), N, in tool0.
        near: weight of each posture that has taps of its own, (k, m), sums to one (`fir.nearness`).
        used: samples to learn from, (k,); the samples before them are needed as past.
    """

    moved: Array
    deviation: Array
    slope: Array
    force: Array
    near: Array
    used: Array


@dataclass(frozen=True)
class CourseFilter:
    """Taps (m, n, 3 axes, 3 axes that they are from) for m postures, newest sample first; left, before: RMS of the deviation
    with these taps and unfiltered, m; acceleration: RMS of the offset's where it is largest, in a tenth of the time, m/s^2."""

    taps: Array
    left: float
    before: float
    acceleration: float


def spread_postures(q: Array, count: int) -> Array:
    """Joint angles (count, joints), rad, in the middle of as many groups of postures q (k, joints); fewer where q has fewer."""
    few = np.unique(np.round(q[:: max(1, len(q) // 4000)], 4), axis=0)
    middle = few[np.unique(np.linspace(0, len(few) - 1, count).astype(int))]
    for _ in range(50):
        owner = np.argmin(((few[:, None] - middle[None]) ** 2).sum(axis=2), axis=1)
        middle = np.array([few[owner == k].mean(axis=0) if (owner == k).any() else middle[k] for k in range(len(middle))])
    return np.asarray(np.unique(np.round(middle, 6), axis=0))


def learn(
    courses: Sequence[DrivenCourse], rate: float, acceleration: float, taps: int = 60, crossed: bool = False
) -> CourseFilter:
    """Taps with the least mean square of what is left on these courses.

    Args:
        acceleration: m/s^2, largest RMS that the offset's acceleration may have in the roughest tenth of the time, by windows of
            250 samples: a limit that acts in a few cuts makes the largest deviation.
        taps: how many samples back the filter looks. crossed: each axis from all axes of the force, not from its own alone.

    Raises:
        SettingsError: a value out of range, too few samples, or no filter stays below the acceleration.
    """
    if not 2 <= taps <= LONGEST:
        raise SettingsError(f"a filter of {taps} taps; 2 to {LONGEST} are possible")
    postures = courses[0].near.shape[1] if courses else 1
    if not 1 <= postures <= MOST:
        raise SettingsError(f"a filter for {postures} postures; 1 to {MOST} are possible")
    shape = _Shape(taps, postures, crossed)
    samples, unknowns = int(sum(c.used.sum() for c in courses)), shape.unknowns
    if samples < 10 * unknowns:
        raise SettingsError(
            f"{samples} samples are too few to learn {taps} taps for each axis at {postures} postures; {10 * unknowns} are needed"
        )
    sums = _sums(courses, shape, rate)
    G = sums.G + 1e-9 * np.trace(sums.G) / unknowns * np.eye(unknowns)
    one, through = shape.gains()

    def solved(gentle: float) -> Array:
        both = linalg.solve(G + gentle * sums.S, np.column_stack([sums.b, one.T]), assume_a="pos")
        x, y = both[:, 0], both[:, 1:]
        return np.asarray(x + y @ np.linalg.solve(one @ y, through - one @ x))

    def allowed(h: Array) -> bool:
        return sums.shaken(h) <= acceleration and float(np.abs(shape.taps(h)).sum(axis=1).max()) <= LOUDEST

    steps = np.logspace(-12.0, -4.0, 3073)  # fine, so that what is allowed is used
    low, high = -1, len(steps)  # the gentler, the less it shakes: the first of the steps that is allowed
    found: Array | None = None
    while high - low > 1:
        middle = (low + high) // 2
        h = solved(steps[middle])
        if allowed(h):
            high, found = middle, h
        else:
            low = middle
    if found is None:
        raise SettingsError(f"no filter keeps the offset's acceleration below {acceleration:.3g} m/s^2 RMS; allow more")
    given = shape.taps(found)
    given[:, 0] += np.eye(3) - given.sum(axis=1)  # to the last digit
    return CourseFilter(given, sums.left(found), sums.left(shape.plain()), sums.shaken(found))


class _Shape:
    """How taps are made of the numbers that are looked for: for each posture, each axis from its own or from each."""

    def __init__(self, taps: int, postures: int, crossed: bool) -> None:
        own, other = _basis(taps, _DENSE, _APART), _basis(taps, _DENSE_CROSSED, _APART_CROSSED)
        self._pairs = [(a, b) for a in range(3) for b in range(3) if crossed or a == b]
        self._bases = [own if a == b else other for a, b in self._pairs]
        self._ends = np.cumsum([0, *(x.shape[1] for x in self._bases)])
        self._length, self._postures = taps, postures
        self.unknowns = postures * int(self._ends[-1])

    def features(self, x: Array, near: Array, at: Array) -> Array:
        """x (k, 3, 3) at samples `at` and before each, newest first, summed by the bases, weighted for each posture (k, m) by how
        near the robot is now; before the begin the first value, (len(at), unknowns)."""
        before = self._length - 1
        back = at[:, None] + before - np.arange(self._length)
        whole = np.concatenate([np.repeat(x[:1], before, axis=0), x])
        past = np.concatenate(
            [whole[:, a, b][back] @ basis for (a, b), basis in zip(self._pairs, self._bases, strict=True)], axis=1
        )
        return np.asarray((near[at][:, :, None] * past[:, None, :]).reshape(len(at), -1))

    def taps(self, h: Array) -> Array:
        """(postures, taps, 3, 3) of the numbers (unknowns,)."""
        each, out = h.reshape(self._postures, -1), np.zeros((self._postures, self._length, 3, 3))
        for n, (a, b) in enumerate(self._pairs):
            out[:, :, a, b] = each[:, self._ends[n] : self._ends[n + 1]] @ self._bases[n].T
        return out

    def gains(self) -> tuple[Array, Array]:
        """Rows that sum the taps, and what they sum to: one for an axis from itself, else zero."""
        rows = np.zeros((len(self._pairs), int(self._ends[-1])))
        for n, basis in enumerate(self._bases):
            rows[n, self._ends[n] : self._ends[n + 1]] = basis.sum(axis=0)
        return np.kron(np.eye(self._postures), rows), np.tile([float(a == b) for a, b in self._pairs], self._postures)

    def plain(self) -> Array:
        """The numbers of the filter that passes the force as it is."""
        h = np.zeros((self._postures, int(self._ends[-1])))
        h[:, [end for end, (a, b) in zip(self._ends, self._pairs, strict=False) if a == b]] = 1.0
        return h.ravel()


@dataclass(frozen=True)
class _Sums:
    """Sums of products over all courses: of the features (G), with the deviation (b), of the offset's acceleration everywhere (S)
    and where it is roughest (worst)."""

    G: Array
    b: Array
    power: float
    samples: int
    S: Array
    worst: Array
    most: int

    def left(self, h: Array) -> float:
        """RMS of the deviation, m."""
        return math.sqrt(max(self.power - 2.0 * float(self.b @ h) + float(h @ self.G @ h), 0.0) / self.samples)

    def shaken(self, h: Array) -> float:
        """RMS of the acceleration where it is roughest, m/s^2."""
        return math.sqrt(3.0 * float(h @ self.worst @ h) / self.most)


def _sums(courses: Sequence[DrivenCourse], shape: _Shape, rate: float) -> _Sums:
    n = shape.unknowns
    G, S, worst = (np.zeros((n, n)) for _ in range(3))
    b, power, samples, most = np.zeros(n), 0.0, 0, 0
    every = min(max(int(sum(c.used.sum() for c in courses)) // (_ENOUGH * n), 1), _EVERY)
    for number, (c, at_worst) in enumerate(zip(courses, _rough(courses), strict=True)):
        used = np.flatnonzero(c.used)
        at = used[number % every :: every]
        free = np.linalg.qr(np.stack([np.ones(len(at)), np.linspace(-1.0, 1.0, len(at))], axis=1))[0]
        A = shape.features(c.moved, c.near, at)
        A -= free @ (free.T @ A)
        d = c.deviation[at] - free @ (free.T @ c.deviation[at])
        G, b, power, samples = G + A.T @ A, b + A.T @ d, power + float(d @ d), samples + len(at)
        for k in range(3):
            quick = _quick(c.slope[:, :, k, None] * c.force[:, None, :]) * rate**2
            few = used[(number + k) % (_FEWER * every) :: _FEWER * every]  # an RMS of fewer samples is the same
            B = shape.features(quick, c.near, few)
            S += _FEWER * (B.T @ B)
            B = B[at_worst[few]]
            worst, most = worst + B.T @ B, most + len(B)
    return _Sums(G, b, power, samples, S, worst, most)


def _quick(x: Array) -> Array:
    """Second differences of x (k, ...), 0 at the begin."""
    out = np.zeros_like(x)
    out[2:] = np.diff(x, 2, axis=0)
    return out


def _rough(courses: Sequence[DrivenCourse]) -> list[Array]:
    """Samples of each course that lie in the roughest tenth of the windows, by what would be sent unfiltered, each (k,)."""
    levels = []
    for c in courses:
        size = (_quick((c.slope * c.force[:, :, None]).sum(axis=1)) ** 2).sum(axis=1) * c.used
        window = np.arange(len(size)) // _WINDOW
        levels.append((np.bincount(window, size) / np.maximum(np.bincount(window, c.used), 1))[window])
    least = np.quantile(np.concatenate([x[c.used] for x, c in zip(levels, courses, strict=True)]), _ROUGHEST)
    return [np.asarray((x >= least) & c.used) for x, c in zip(levels, courses, strict=True)]


def _basis(taps: int, dense: int, apart: int) -> Array:
    """Taps as sums of few numbers, (taps, numbers): each of the newest is free, the older ones are linear between knots. Old taps
    that differ from one to the next serve nothing but noise: a drive follows no offset that changes so quickly."""
    knots = np.unique(np.r_[np.arange(min(dense, taps)), np.arange(dense - 1, taps, apart), taps - 1])
    return np.stack([np.interp(np.arange(taps), knots, one) for one in np.eye(len(knots))], axis=1)
