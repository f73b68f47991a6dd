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
    """Precision of normal priors, (..., p), with what makes a problem of the Gram matrix G, (p, p), solvable.

    That of a parameter rests on its own column only: were it relative to the largest of all columns, those of one effect would
    narrow the priors of all other parameters, and models with and without it would not be compared on the same terms.

    Args:
        rounding: least precision of parameters that have a prior, relative to their own diagonal entry; RIDGE for the others.
    """
    floor = np.where(precision > 0.0, rounding, RIDGE) * np.maximum(G.diagonal(), 1e-30)
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
    parts = [A[rows] for rows in of_pose]
    G_out = G - np.stack([a.T @ a for a in parts])
    h_out = h - np.stack([a.T @ b[rows] for a, rows in zip(parts, of_pose, strict=True)])
    x = solve_bounded_gram(G_out + np.diag(floored(precision, G, rounding)), h_out, lower, upper)
    out = np.empty_like(b)
    for rows, a, values in zip(of_pose, parts, x, strict=True):
        out[rows] = b[rows] - a @ values
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
