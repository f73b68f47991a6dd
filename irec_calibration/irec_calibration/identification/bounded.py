# SPDX-License-Identifier: Apache-2.0
"""Bounded least squares on the Gram matrix: min 1/2 x'Gx - h'x with lower <= x <= upper, many problems at once.

Least squares |Ax - d|^2 with bounds needs only G = A'A and h = A'd. Grams of pose blocks add up, so that a training
set which grows by one pose costs one addition and one small solve, not a factorisation of the whole stack.

The method is block principal pivoting (Judice and Pires 1994, "A block principal pivoting algorithm for large-scale
strictly monotone linear complementarity problems"), extended to two-sided bounds: every variable is at its lower
bound, free, or at its upper bound; all that violate the optimality conditions change sides together; where that stops
helping, the worst alone; and where even that goes round in circles, the last alone (Murty's rule, finite for every
positive definite G, but for as many exchanges as there are sets). What is not settled then is solved by an active set.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from ..errors import SolveError
from ..typing import Array, BoolArray, IntArray

_PATIENCE = 1  # block exchanges that may fail to reduce the violations before single ones take over
_MAX_SWEEPS = 400
ITERATIONS = 20  # per variable, of the active set; it needs about one
AT_BOUND = 1e-12  # of 1 and the bound


def solve_bounded_gram(
    G: ArrayLike,
    h: ArrayLike,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    start: ArrayLike | None = None,
) -> Array:
    """Minimise 1/2 x'Gx - h'x subject to lower <= x <= upper (the Gram form of the paper's Eq. 19, with bounds).

    G: (..., p, p) symmetric positive definite; h: (..., p); lower, upper: broadcast to (..., p), infinite where there
    is no bound, equal where a variable is fixed. start: (..., p) an x of a neighbouring problem: its variables that
    stand at a bound are tried there first (fewer sweeps, the same result). Returns x (..., p); a variable held by its
    bound equals it exactly, so `x == lower` is the active set.

    Scale the columns so that the diagonal of G is about 1 and add a small ridge where the model is rank-deficient:
    the accuracy of x is about 1e-16 times the condition number of G.

    Raises SolveError: a value that is not finite, lower > upper, G not positive definite.
    """
    gram = np.asarray(G, dtype=float)
    rhs = np.asarray(h, dtype=float)
    p = rhs.shape[-1]
    if gram.shape[-2:] != (p, p):
        raise SolveError(f"the Gram matrix has shape {gram.shape}, the right-hand side {rhs.shape}: they do not match")
    shape = np.broadcast_shapes(gram.shape[:-1], rhs.shape)
    gram = np.broadcast_to(gram, (*shape, p)).reshape(-1, p, p)
    rhs = np.broadcast_to(rhs, shape).reshape(-1, p)
    low = np.broadcast_to(np.asarray(lower, dtype=float), shape).reshape(-1, p)
    high = np.broadcast_to(np.asarray(upper, dtype=float), shape).reshape(-1, p)
    _check(gram, rhs, low, high)

    fixed = low == high
    side = np.where(fixed, -1, 0).astype(np.int64)  # -1 at the lower bound, 0 free, 1 at the upper bound
    if start is not None:
        x0 = np.broadcast_to(np.asarray(start, dtype=float), shape).reshape(-1, p)
        side[x0 <= low] = -1
        side[(x0 >= high) & ~fixed] = 1

    x = np.empty_like(rhs)
    open_ = np.arange(len(rhs))  # problems not yet solved
    fewest = np.full(len(rhs), p + 1)
    patience = np.full(len(rhs), _PATIENCE)
    for _ in range(_MAX_SWEEPS):
        xo, wish, excess = _sweep(gram[open_], rhs[open_], low[open_], high[open_], side[open_], fixed[open_])
        change = wish != side[open_]
        count = change.sum(axis=1)
        done = count == 0
        x[open_[done]] = xo[done]
        if done.all():
            return x.reshape(shape)
        open_, change, wish, count, excess = open_[~done], change[~done], wish[~done], count[~done], excess[~done]
        better = count < fewest[open_]
        fewest[open_] = np.where(better, count, fewest[open_])
        patience[open_] = np.where(better, _PATIENCE, patience[open_] - 1)
        one_at_a_time = patience[open_] < 0
        worst = np.argmax(np.where(change, excess, -1.0), axis=1)
        last = p - 1 - np.argmax(change[:, ::-1], axis=1)
        single = np.where(patience[open_] < -2 * p, last, worst)
        change &= ~one_at_a_time[:, None] | (np.arange(p) == single[:, None])
        side[open_] = np.where(change, wish, side[open_])
    for k in open_:
        x[k] = _by_active_set(gram[k], rhs[k], low[k], high[k])
    return x.reshape(shape)


def _by_active_set(gram: Array, rhs: Array, low: Array, high: Array) -> Array:
    """One problem that exchanges go round in circles in, by an active set (Stark and Parker 1995, "Bounded-variable least
    squares"): slower, and its loss falls with each step.

    Args:
        gram: (p, p); rhs, low, high: (p,).
    """
    x, free = low.copy(), low < high
    if not free.any():
        return x
    root = np.linalg.cholesky(gram[np.ix_(free, free)])
    right = solve_triangular(root, rhs[free] - gram[np.ix_(free, ~free)] @ low[~free], lower=True)
    found = lsq_linear(root.T, right, (low[free], high[free]), method="bvls", tol=1e-15, max_iter=ITERATIONS * int(free.sum()))
    if found.status <= 0:
        raise SolveError(
            f"a bounded problem did not settle: the Gram matrix is too badly conditioned (condition number"
            f" {np.linalg.cond(gram):.1e}); scale the columns or add a ridge"
        )
    x[free] = found.x
    for bound in (low, high):  # what is held by its bound equals it
        known = np.where(np.isfinite(bound), bound, 0.0)
        x = np.where(np.isfinite(bound) & (np.abs(x - known) <= AT_BOUND * (1.0 + np.abs(known))), bound, x)
    return x


def _check(gram: Array, rhs: Array, low: Array, high: Array) -> None:
    if not (np.isfinite(gram).all() and np.isfinite(rhs).all()):
        raise SolveError("the normal equations hold a value that is not finite")
    empty = ~(low <= high) | (low == np.inf) | (high == -np.inf)
    if empty.any():
        row, col = np.argwhere(empty)[0]
        raise SolveError(f"parameter {col}: lower bound {low[row, col]:g} and upper bound {high[row, col]:g} leave no value")
    try:
        np.linalg.cholesky(gram)
    except np.linalg.LinAlgError:
        raise SolveError(
            "the Gram matrix is not positive definite: some parameters cannot be told apart by this data; add a ridge"
        ) from None


def _sweep(
    gram: Array, rhs: Array, low: Array, high: Array, side: IntArray, fixed: BoolArray
) -> tuple[Array, IntArray, Array]:
    """Solve for the free variables: x, the side on which each variable should be, how badly it is on the wrong one."""
    eps = np.finfo(float).eps
    free = side == 0
    at_bound = np.where(side < 0, low, np.where(side > 0, high, 0.0))
    K = np.where(free[:, :, None] & free[:, None, :], gram, 0.0)
    diag = np.arange(rhs.shape[1])
    K[:, diag, diag] += ~free
    b = np.where(free, rhs - np.einsum("nij,nj->ni", gram, at_bound), at_bound)
    x = np.linalg.solve(K, b[:, :, None])[:, :, 0]
    x = np.where(free, x, at_bound)
    gradient = np.einsum("nij,nj->ni", gram, x) - rhs
    # rounding error of the gradient: a bound variable with less is where it belongs (prevents endless exchange on ties);
    # |G_ij| <= scale_i scale_j for a positive definite matrix
    scale = np.sqrt(np.einsum("nii->ni", gram))
    magnitude = scale * np.sum(scale * np.abs(x), axis=1, keepdims=True) + np.abs(rhs)
    noise = 4 * eps * magnitude
    wish = np.where(free & (x < low), -1, np.where(free & (x > high), 1, side))
    wish = np.where((side < 0) & ~fixed & (gradient < -noise), 0, wish)
    wish = np.where((side > 0) & ~fixed & (gradient > noise), 0, wish)
    excess = np.where(free, np.maximum(low - x, x - high) * scale, np.abs(gradient) / scale)
    return x, wish.astype(np.int64), excess
