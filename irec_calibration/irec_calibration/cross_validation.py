# SPDX-License-Identifier: Apache-2.0
"""Cross-validation over poses: how well a model predicts where it was not fitted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .model import Term, total_displacement
from .observe import Observation
from .system import free_regressors, linearise, solve
from .typing import Array, BoolArray

FOLDS = 10


def pose_folds(observation: Observation, folds: int = FOLDS, seed: int = 0) -> list[BoolArray]:
    """Masks of held-out equations (3m,), whole poses each; as many folds as poses where there are fewer."""
    poses = observation.poses.copy()
    np.random.default_rng(seed).shuffle(poses)
    per_equation = np.repeat(observation.pose, 3)
    return [np.isin(per_equation, part) for part in np.array_split(poses, min(folds, len(poses)))]


def held_out_residual(terms: Sequence[Term], observation: Observation, folds: int = FOLDS) -> Array:
    """Residual of each observed row predicted from poses without its own, (m, 3), m. NaN where there is only one pose.

    The system is linearised once about the values given: exact for linear effects.
    """
    if len(observation.poses) < 2:
        return np.full((len(observation.rows), 3), np.nan)
    scene = observation.scene
    system = linearise(terms, observation)
    A = observation.of(np.concatenate(free_regressors(terms, scene), axis=2)) * system.scale
    theta_0 = np.array([terms[i].estimates[p.name].value for i, p in zip(system.owner, system.parameters, strict=True)])
    x_0 = theta_0 / system.scale - system.centre
    base = observation.y - observation.of(total_displacement(terms, scene))
    residual = np.empty_like(base).reshape(-1)
    for held in pose_folds(observation, folds):
        x = solve(system, ~held)
        residual[held] = (base - A @ (x - x_0)).reshape(-1)[held]
    return residual.reshape(-1, 3)


def rms(residual: Array) -> float:
    """sqrt(mean |r|^2) over rows of a residual (m, 3), in its unit."""
    return float(np.sqrt((residual**2).sum(axis=1).mean()))
