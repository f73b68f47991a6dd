# SPDX-License-Identifier: Apache-2.0
"""Process force that courses have in common: what comes with the time since their begin, with the share of the way, and with
the time that is left.

    f(t) = a(t) + b(s(t)) + c(t_end - t) + rest,

piecewise linear, fitted to all courses at once, so that a touch-down (by time) and a corner (by place) do not blur each other
where courses differ in length. A touch-down that comes sooner or later from course to course is found by its slope, and taken at
its mean time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import linalg

from ..errors import RecordingError
from ..typing import Array

HEAD, TAIL = 2.0, 1.2  # s
SMOOTH = 0.04  # s
_FINE, _PLACES = 0.012, 121  # s between knots by time; knots by place
_SMOOTH = 20.0  # weight of the second difference between knots by place, as a share of the samples on a knot
_ROUNDS = 2  # of alignment
_FADED = 0.3  # share of the knots by time over which what comes by time goes over to nothing


@dataclass(frozen=True)
class ForcedCourse:
    """One course: share of the way 0 .. 1 (k,), rising, and force (k, 3), N, in axes that mean the same on all courses."""

    share: Array
    force: Array


@dataclass(frozen=True)
class CommonForce:
    """The force that courses have in common.

    Attributes:
        head: by the time since the begin, (h, 3), N; tail: by the time that is left, (e, 3), both at knots `step` s apart;
        middle: by the share of the way at even knots, (m, 3).
        spread: s, standard deviation of the time at which the head came. left: N, RMS of what is not common, any axis.
    """

    head: Array
    middle: Array
    tail: Array
    step: float
    spread: float
    left: float

    def along(self, share: Array, period: float) -> Array:
        """Force at equal steps of time of a course with these shares of the way (k,), (k, 3), N."""
        A = _design(np.asarray(share, dtype=float), period, 0.0, len(self.head), len(self.middle), len(self.tail), self.step)
        return np.asarray(A @ np.concatenate([self.head, self.middle, self.tail]))


def common_force(courses: Sequence[ForcedCourse], period: float, head: float = HEAD, tail: float = TAIL) -> CommonForce:
    """Fit what the courses have in common.

    Args:
        period: s between samples; head, tail: s at either end in which something may come by time.

    Raises:
        RecordingError: no course, one that is shorter than head and tail, or values that are not finite.
    """
    if not courses:
        raise RecordingError("a force profile needs one recording of a course or more")
    least = round((head + tail) / period)
    for i, course in enumerate(courses):
        if len(course.force) < least or course.force.shape != (len(course.share), 3):
            raise RecordingError(
                f"course {i + 1} has {len(course.force)} samples; {least} are needed: {head + tail:g} s, of which "
                f"{head:g} s at the begin and {tail:g} s at the end go by time"
            )
        if not (np.isfinite(course.force).all() and np.isfinite(course.share).all()):
            raise RecordingError(f"course {i + 1} holds values that are not finite")
    sizes = round(head / _FINE) + 1, _PLACES, round(tail / _FINE) + 1
    late = np.zeros(len(courses))
    for _ in range(_ROUNDS):
        x = _solved(courses, period, late, sizes)
        found = _late(courses, period, late, sizes, x)
        late = found - found.mean()
    x = _solved(courses, period, late, sizes)
    rest = [c.force - _design(c.share, period, d, *sizes, _FINE) @ x for c, d in zip(courses, late, strict=True)]
    h, m = sizes[0], sizes[0] + sizes[1]
    return CommonForce(x[:h], x[h:m], x[m:], _FINE, float(late.std()), float(np.sqrt(np.mean(np.concatenate(rest) ** 2))))


def smoothed(force: Array, period: float, width: float = SMOOTH) -> Array:
    """A force (k, n) at equal steps of time without what comes too quickly to be answered ahead of its time, (k, n).

    An offset that is as quick as the lowest mode of the arm shakes it. What is left out is answered when it is read.

    Args:
        period: s; width: s, standard deviation of the weights (Gaussian): of a sine of 0.5 Hz 1 % is left out, of 4 Hz 40 %.
    """
    return np.asarray(ndimage.gaussian_filter1d(force, width / period, axis=0, mode="nearest")) if width > 0.0 else force


def _design(share: Array, period: float, late: float, h: int, m: int, e: int, step: float) -> sparse.csr_matrix:
    """Rows of a course: weights of the knots of head, middle and tail; beyond the last knot of head and tail nothing comes."""
    t: Array = np.arange(len(share), dtype=np.float64) * np.float64(period)
    place = np.asarray(np.clip(np.interp(t - late, t, share), 0.0, 1.0) * (m - 1), dtype=np.float64)
    parts = (_hats((t - late) / step, h, True), _hats(place, m, False), _hats((t[-1] - t) / step, e, True))
    return sparse.hstack(parts, format="csr")


def _hats(x: Array, n: int, ends: bool) -> sparse.csr_matrix:
    """Piecewise linear weights at positions x of knots 0 .. n - 1; `ends`: nothing from the last knot on."""
    x = np.maximum(x, 0.0)
    inside = x < n - 1 if ends else np.ones(len(x), dtype=bool)
    i = np.minimum(x.astype(int), n - 2)
    u = np.where(inside, np.minimum(x - i, 1.0), 0.0)
    low = np.where(inside, 1.0 - u, 0.0)
    rows = np.arange(len(x))
    return sparse.csr_matrix((np.r_[low, u], (np.r_[rows, rows], np.r_[i, i + 1])), shape=(len(x), n))


def _solved(courses: Sequence[ForcedCourse], period: float, late: Array, sizes: tuple[int, int, int]) -> Array:
    """Values at all knots, (h + m + e, 3). Those of head and tail fade out: where they ended with a step, the correction would
    follow that as if it were a force."""
    n = sum(sizes)
    fade = np.concatenate([_fade(sizes[0]), np.ones(sizes[1]), _fade(sizes[2])])
    G, b, count = sparse.csr_matrix((n, n)), np.zeros((n, 3)), 0
    for course, d in zip(courses, late, strict=True):
        A = _design(course.share, period, float(d), *sizes, _FINE) @ sparse.diags(fade)
        G, b, count = G + A.T @ A, b + A.T @ course.force, count + len(course.share)
    h, m, e = sizes
    by_time = len(courses) * _FINE / period  # samples on a knot
    by_place = count / m
    # by place it changes slowly: a touch-down is told by time, however alike the courses' lengths are; what both could tell
    # (a constant) goes to the place
    ends = [by_time * (1e-3 * sparse.identity(n) + 0.3 * _bend(n)) for n in (h, e)]
    R = sparse.block_diag([ends[0], _SMOOTH * by_place * _bend(m) + 1e-6 * sparse.identity(m), ends[1]])
    return fade[:, None] * np.asarray(linalg.splu((G + R).tocsc()).solve(b))


def _fade(n: int) -> Array:
    """One, and towards the last of n knots nothing, (n,)."""
    left = np.clip((n - 1 - np.arange(n)) / (_FADED * (n - 1)), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * left))


def _bend(n: int) -> sparse.csr_matrix:
    D = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n))
    return (D.T @ D).tocsr()


def _late(courses: Sequence[ForcedCourse], period: float, late: Array, sizes: tuple[int, int, int], x: Array) -> Array:
    """By how much later than the mean the head of each course came, s, from its slope."""
    out, d = late.copy(), 0.5 * _FINE
    for i, course in enumerate(courses):
        now, sooner, later = (_design(course.share, period, late[i] + u, *sizes, _FINE) @ x for u in (0.0, -d, d))
        slope = ((later - sooner) / (2.0 * d))[: round((sizes[0] - 1) * _FINE / period)]
        steep = float((slope**2).sum())
        if steep > 0.0:
            out[i] += np.clip(float((slope * (course.force - now)[: len(slope)]).sum()) / steep, -0.05, 0.05)
    return np.clip(out, -0.2, 0.2)
