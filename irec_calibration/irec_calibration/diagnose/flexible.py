# SPDX-License-Identifier: Apache-2.0
"""How much any smooth cause without a name could still remove: a flexible regression of the residual over held-out poses."""

from __future__ import annotations

import numpy as np

from ..observe import Observation
from ..typing import Array

TREES = 60
FOLDS = 5
FEWEST_POSES = 8


def flexible_gain(observation: Observation, residual: Array) -> float:
    """RMS that extra trees remove from the residual on poses held out, m; 0 where nothing; NaN where it can't be tried.

    Args:
        residual: (m, 3), m, in base_link. Held-out prediction is tried in base and tool frame; the better one counts.
    """
    try:
        from sklearn.ensemble import ExtraTreesRegressor
        from sklearn.model_selection import GroupKFold
    except ImportError:
        return float("nan")
    if len(observation.poses) < FEWEST_POSES:
        return float("nan")
    scene, rows = observation.scene, observation.rows
    features = np.column_stack(
        [
            scene.q,
            scene.tau,
            scene.force_in_tool,
            scene.step,
            scene.p_tcp,
            scene.stamp,
            *scene.temperature.values(),
            *scene.ext.values(),
        ]
    )[rows]
    features = np.nan_to_num(features)
    R = scene.kin.R_tool[rows]
    before = float((residual**2).sum(axis=1).mean())
    best = before
    for target in (residual, np.einsum("nji,nj->ni", R, residual)):
        predicted = np.zeros_like(target)
        for train, test in GroupKFold(min(FOLDS, len(observation.poses))).split(features, groups=observation.pose):
            trees = ExtraTreesRegressor(TREES, min_samples_leaf=3, random_state=0)
            predicted[test] = trees.fit(features[train], target[train] * 1e6).predict(features[test]) * 1e-6
        best = min(best, float(((target - predicted) ** 2).sum(axis=1).mean()))
    return float(np.sqrt(before - best))
