# SPDX-License-Identifier: Apache-2.0
"""The error of a model on poses that it was not fitted to: the one place where it is computed.

Figures that people see (`cv_rms_m`, "held-out error") are those of `diagnose.validated`, described by ESTIMATOR. Others have
other names: the error of a trial is that of an effect in the linear problem about a fitted model; the error of a recertification
is that on poses kept apart, of two models; a CODEC is the mean error over the number of training poses (Algorithm 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from ..typing import Array, BoolArray, IntArray
from .bounded import solve_bounded_gram
from .observe import Observation

FEWEST_POSES = 3  # that two models can be compared on
ESTIMATOR = (
    "bounded weighted least squares with weak priors, at the noise that the session shows; held out: each pose predicted from all"
    " others"
)
RIDGE = 1e-9  # relative to the diagonal entry: makes the solution unique along unobserved directions
# The same for parameters of absolute sessions that have a prior, for rounding only. There a station that turns moves the marker
# by far more than what is asked about, and a ridge by its size would hold that back.
ROUNDING = 1e-13
LEAST_LEFT = 1e-6  # share of a pose's equations that all poses together do not fit because of it; below, rounding tells more
AT_ONCE = 10_000_000  # numbers in the matrices that are solved together


@dataclass(frozen=True)
class HeldOut:
    """Every pose predicted from all the others.

    Attributes:
        rms_m, rms_se_m: sqrt(mean |r|^2) per sample and its standard error over poses, m; NaN where there is one pose.
        mean_m, mean_se_m: mean |r| per sample, likewise.
        poses: pose numbers, ascending; loss: squared residual in stated standard deviations, mean per equation of each, (poses,).
        residual: (m, 3), m.
    """

    rms_m: float
    rms_se_m: float
    mean_m: float
    mean_se_m: float
    poses: IntArray
    loss: Array
    residual: Array

    def rms_of(self, chosen: BoolArray) -> float:
        """As `rms_m`, of some of the samples, (m,)."""
        return rms(self.residual[chosen])


def floored(precision: Array, G: Array, rounding: float = RIDGE) -> Array:
    """Precision of normal priors, (..., p), with what makes a problem of the Gram matrix G, (..., p, p), solvable.

    That of a parameter rests on its own column only: were it relative to the largest of all columns, those of one effect would
    narrow the priors of all other parameters, and models with and without it would not be compared on the same terms.

    Args:
        rounding: least precision of parameters that have a prior, relative to their own diagonal entry; RIDGE for the others.
    """
    floor = np.where(precision > 0.0, rounding, RIDGE) * np.maximum(np.diagonal(G, axis1=-2, axis2=-1), 1e-30)
    return np.asarray(np.maximum(precision, floor))


def predicted_from_others(
    A: Array, b: Array, of_pose: Sequence[IntArray], lower: Array, upper: Array, precision: Array, rounding: float = RIDGE
) -> Array:
    """Residual of every equation, each pose predicted by bounded least squares from all others, (n,).

    Args:
        A, b: whitened equations, (n, p) and (n,); of_pose: equations of each pose.
        lower, upper: bounds, (p,); precision: of the normal prior about 0 of each parameter, (p,).
        rounding: see `floored`.
    """
    G, h = A.T @ A, A.T @ b
    K = G + np.diag(floored(precision, G, rounding))
    out = np.empty_like(b)
    known = _without_few(A, b, of_pose, K, h, lower, upper)
    for rows, values in zip(of_pose, known, strict=True):
        if values is not None:
            out[rows] = values
    others = [rows for rows, values in zip(of_pose, known, strict=True) if values is None]
    at_once = max(AT_ONCE // K.size, 1)
    for first in range(0, len(others), at_once):
        some = others[first : first + at_once]
        parts = [A[rows] for rows in some]
        K_out = K - np.stack([a.T @ a for a in parts])
        h_out = h - np.stack([a.T @ b[rows] for a, rows in zip(parts, some, strict=True)])
        x = solve_bounded_gram(K_out, h_out, lower, upper)
        for rows, a, values in zip(some, parts, x, strict=True):
            out[rows] = b[rows] - a @ values
    return out


def _without_few(
    A: Array, b: Array, of_pose: Sequence[IntArray], K: Array, h: Array, lower: Array, upper: Array
) -> list[Array | None]:
    """As `predicted_from_others` of poses with few equations, from the solution with all poses; None of those that it does not
    tell, since without them other parameters stand at their bounds, or hardly anything else says what some are.

    Equations that are taken out of a least-squares problem change its solution by their own rank only (Sherman, Morrison and
    Woodbury; Cook and Weisberg 1982, "Residuals and Influence in Regression", 2.2).

    Args:
        K, h: normal equations with the priors, (p, p) and (p,).
    """
    out: list[Array | None] = [None] * len(of_pose)
    of_length: dict[int, list[int]] = {}
    for i, rows in enumerate(of_pose):
        if 0 < len(rows) < len(h):
            of_length.setdefault(len(rows), []).append(i)
    if not of_length:
        return out
    x = solve_bounded_gram(K, h, lower, upper)
    low, high = x <= lower, x >= upper
    free, held = ~(low | high), (low | high) & (lower < upper)
    residual, gradient = b - A @ x, K[held] @ x - h[held]
    A_free, A_held = A[:, free], A[:, held]
    W = np.linalg.solve(K[np.ix_(free, free)], A_free.T).T
    for places in of_length.values():
        rows = np.array([of_pose[i] for i in places])
        a, w = A_free[rows], W[rows]
        left = np.eye(rows.shape[1]) - a @ w.transpose(0, 2, 1)
        sure = np.linalg.eigvalsh(0.5 * (left + left.transpose(0, 2, 1)))[:, 0] > LEAST_LEFT
        predicted = np.linalg.solve(np.where(sure[:, None, None], left, np.eye(rows.shape[1])), residual[rows][:, :, None])
        change = -(w.transpose(0, 2, 1) @ predicted)[:, :, 0]
        sure &= ((x[free] + change >= lower[free]) & (x[free] + change <= upper[free])).all(axis=1)
        pull = gradient + change @ K[np.ix_(held, free)].T + (A_held[rows].transpose(0, 2, 1) @ predicted)[:, :, 0]
        sure &= (np.where(low[held], pull, -pull) >= 0.0).all(axis=1)
        for i, one, told in zip(places, predicted[:, :, 0], sure, strict=True):
            out[i] = one if told else None
    return out


def held_out_error(observation: Observation, white: Array | None) -> HeldOut:
    """Figures of a held-out residual.

    Args:
        white: residual of each equation in standard deviations, (3m,); None where there is only one pose.
    """
    poses, m = observation.poses, len(observation.rows)
    if white is None:
        nan = float("nan")
        return HeldOut(nan, nan, nan, nan, poses, np.full(len(poses), nan), np.full((m, 3), nan))
    residual = observation.whiten.undo(white.reshape(-1, 3))
    _, of_row = np.unique(observation.pose, return_inverse=True)
    rows_of = np.bincount(of_row).astype(float)

    def per_pose(of_each: Array) -> Array:
        return np.asarray(np.bincount(of_row, weights=of_each) / rows_of)

    squared = (residual**2).sum(axis=1)
    size, n = np.sqrt(squared), np.sqrt(len(poses))
    loss = per_pose((white.reshape(-1, 3) ** 2).mean(axis=1)) * observation.whiten.level**2
    left = rms(residual)
    return HeldOut(
        rms_m=left,
        rms_se_m=float(per_pose(squared).std(ddof=1) / n / (2.0 * max(left, 1e-12))),
        mean_m=float(size.mean()),
        mean_se_m=float(per_pose(size).std(ddof=1) / n),
        poses=poses,
        loss=loss,
        residual=residual,
    )


def gain(before: HeldOut, after: HeldOut) -> tuple[float, float, float]:
    """Mean loss saved per equation, its standard error over poses, and the one-sided p-value of a paired t-test."""
    _, one, other = np.intersect1d(before.poses, after.poses, return_indices=True)
    saved = before.loss[one] - after.loss[other]
    n = len(saved)
    if n < FEWEST_POSES or not np.isfinite(saved).all():
        return float("nan"), float("nan"), 1.0
    mean, se = float(saved.mean()), float(saved.std(ddof=1) / np.sqrt(n))
    return mean, se, float(stdtr(n - 1, -mean / max(se, 1e-12)))


def rms(residual: Array) -> float:
    """sqrt(mean |r|^2) over rows of a residual (m, 3), in its unit; NaN where there are none."""
    return float(np.sqrt((residual**2).sum(axis=1).mean())) if len(residual) else float("nan")
