# SPDX-License-Identifier: Apache-2.0
"""Error over held-out poses, and whether one model beats another there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from ..typing import Array
from .evidence import Block
from .study import Study


@dataclass(frozen=True)
class HeldOut:
    """Every pose predicted from all the others.

    Attributes:
        rms_m, rms_se_m: sqrt(mean |r|^2) per sample and its standard error over poses, m; NaN where there is one pose.
        loss: squared residual in standard deviations, mean per equation of each pose, (poses,).
        residual: (m, 3), m.
    """

    rms_m: float
    rms_se_m: float
    loss: Array
    residual: Array


def held_out(study: Study, block: Block | None = None) -> HeldOut:
    """Held-out error of the model of a study, with further columns where given."""
    columns = study.base if block is None else study.base + block
    bench = study.bench
    if len(bench.poses) < 2:
        m = len(study.observation.rows)
        return HeldOut(float("nan"), float("nan"), np.full(len(bench.poses), np.nan), np.full((m, 3), np.nan))
    white = bench.held_out(columns)
    residual = study.observation.whiten.undo(white.reshape(-1, 3))
    count = bench.by_pose(np.ones(len(white)))
    per_pose = bench.by_pose(np.repeat((residual**2).sum(axis=1), 3)) / count
    rms = float(np.sqrt((residual**2).sum(axis=1).mean()))
    se = float(per_pose.std(ddof=1) / np.sqrt(len(per_pose)) / (2.0 * max(rms, 1e-12)))
    return HeldOut(rms, se, bench.by_pose(white**2) / count, residual)


def gain(before: HeldOut, after: HeldOut) -> tuple[float, float, float]:
    """Mean loss saved per equation, its standard error over poses, and the one-sided p-value of a paired t-test."""
    saved = before.loss - after.loss
    n = len(saved)
    if n < 3 or not np.isfinite(saved).all():
        return float("nan"), float("nan"), 1.0
    mean, se = float(saved.mean()), float(saved.std(ddof=1) / np.sqrt(n))
    return mean, se, float(student.sf(mean / max(se, 1e-12), n - 1))
