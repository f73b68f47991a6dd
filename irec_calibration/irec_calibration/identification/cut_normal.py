# SPDX-License-Identifier: Apache-2.0
"""Samples of a normal distribution that is cut at bounds, as that of compliances, none of which is negative.

Elliptical slice sampling under linear constraints (Gessner, Kanjilal and Hennig 2020, "Integrals over Gaussians under linear
domain constraints"): from x a direction is drawn as the normal distribution has it; the angles at which the ellipse through both
crosses a bound are known in closed form, and the next sample is drawn from the arcs that lie inside. No step is rejected and
nothing is to be tuned.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from scipy.linalg import solve_triangular

from ..errors import SolveError
from ..typing import Array

TURN = 2.0 * np.pi
NOT_DEFINITE = "the precision of a normal distribution is not positive definite: nothing can be drawn of it"
WARM_UP = 4  # one sample in so many is thrown away at the begin


def samples(mean: Array, precision: Array, lower: Array, upper: Array, start: Array, count: int, rng: Generator) -> Array:
    """Samples of N(mean, precision^-1) within bounds, (count, p), each near the one before.

    Args:
        mean: (p,), may lie outside of the bounds; precision: (p, p), positive definite.
        lower, upper: (p,), infinite where there is no bound, equal where a value is held.
        start: (p,), within the bounds.

    Raises:
        SolveError: the precision is not positive definite.
    """
    held = lower == upper
    if held.any():
        free = np.flatnonzero(~held)
        out = np.tile(lower, (count, 1))
        if len(free):
            try:
                shift = np.linalg.solve(precision[np.ix_(free, free)], precision[np.ix_(free, held)] @ (lower - mean)[held])
            except np.linalg.LinAlgError as error:
                raise SolveError(NOT_DEFINITE) from error
            rest = precision[np.ix_(free, free)], lower[free], upper[free], start[free]
            out[:, free] = samples(mean[free] - shift, *rest, count, rng)
        return out
    try:
        L = np.linalg.cholesky(precision)
    except np.linalg.LinAlgError as error:
        raise SolveError(NOT_DEFINITE) from error
    below, above = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    low, high = (lower - mean)[below], (upper - mean)[above]
    limit = np.concatenate([low, -high])  # of s x >= limit
    skipped = count // WARM_UP
    towards = solve_triangular(L.T, rng.standard_normal((len(mean), skipped + count)), lower=False).T
    x = np.clip(start, lower, upper) - mean
    out = np.empty((skipped + count, len(mean)))
    for i, v in enumerate(towards):
        inside = _arcs(np.concatenate([x[below], -x[above]]), np.concatenate([v[below], -v[above]]), limit)
        angle = _drawn(*inside, float(rng.uniform()))
        x = x * np.cos(angle) + v * np.sin(angle)
        x[below], x[above] = np.maximum(x[below], low), np.minimum(x[above], high)  # but for rounding it is
        out[i] = x
    return np.asarray(out[skipped:] + mean)


def _arcs(c: Array, s: Array, limit: Array) -> tuple[Array, Array]:
    """Where c cos t + s sin t >= limit for all constraints, 0 <= t < 2 pi: begins and ends of arcs; t = 0 is inside."""
    radius = np.hypot(c, s)
    crosses = radius > np.abs(limit)
    half = np.arccos(limit[crosses] / radius[crosses])
    begin = np.mod(np.arctan2(s[crosses], c[crosses]) + half, TURN)  # of what is outside
    length = TURN - 2.0 * half
    wrapped = begin + 0.5 * length > TURN  # at a bound the begin is 0, or a turn less rounding
    begin = np.where(wrapped, 0.0, begin)
    end = np.minimum(begin + length, TURN)
    order = np.argsort(begin)
    reached = np.maximum.accumulate(np.concatenate([[0.0], end[order]]))
    return reached, np.maximum(np.concatenate([begin[order], [TURN]]), reached)


def _drawn(begin: Array, end: Array, share: float) -> float:
    """The angle at a share of the whole length of arcs."""
    length = np.cumsum(end - begin)
    at = share * length[-1]
    i = min(int(np.searchsorted(length, at)), len(length) - 1)
    return float(end[i] - (length[i] - at))
