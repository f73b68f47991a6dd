# SPDX-License-Identifier: Apache-2.0
"""How much any smooth cause outside the catalogue could still remove: a kernel regression of the residual over held-out poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..identification.observe import Observation
from ..typing import Array, IntArray
from .settings import SETTINGS, Settings

RIDGES = (0.03, 0.3, 3.0)  # noise over signal, in variance


@dataclass(frozen=True)
class Flexible:
    """What a flexible regression of a residual gains on held-out poses.

    Attributes:
        gain_m: RMS that it removes, m; 0 where nothing, NaN where it can't be tried.
        significant: it gains on held-out poses by far more than by chance.
        variables: session columns whose loss costs most of the gain, strongest first.
    """

    gain_m: float
    significant: bool = False
    variables: tuple[str, ...] = ()


def flexible_gain(observation: Observation, residual: Array, settings: Settings = SETTINGS) -> Flexible:
    """Predict the residual of each pose from all others as a smooth function of all variables of a session.

    Args:
        residual: (m, 3), m, in base_link. Base and tool frame are tried; the better one counts.
    """
    poses = observation.poses
    if len(poses) < settings.flexible.fewest_poses:
        return Flexible(float("nan"))
    if len(residual) > settings.flexible.most_rows:
        count = max(settings.flexible.most_rows * len(poses) // len(residual), settings.flexible.fewest_poses)
        keep = np.isin(observation.pose, poses[np.unique(np.linspace(0, len(poses) - 1, count).astype(int))])
    else:
        keep = np.ones(len(residual), dtype=bool)
    scene, rows = observation.scene, observation.rows[keep]
    table = {f"joint_{k + 1}": scene.q[rows, k] for k in range(scene.n_joints)}
    table |= {f"tau_{k + 1}": scene.load_torque()[rows, k] for k in range(scene.n_joints)}
    table |= {f"force_{a}": scene.force_in_tool[rows, i] for i, a in enumerate("xyz")}
    if scene.clock == "time":
        table["stamp"] = scene.stamp[rows]
    table |= {f"temp_{n}": v[rows] for n, v in scene.temperature.items()}
    table |= {f"ext_{n}": v[rows] for n, v in scene.ext.items()}
    names = [n for n, v in table.items() if np.isfinite(v).all() and np.ptp(v) > 1e-9 * max(1.0, float(np.abs(v).max()))]
    X = np.stack([(table[n] - table[n].mean()) / table[n].std() for n in names], axis=1)
    r = residual[keep]
    R = scene.kin.R_tool[rows]
    pose = observation.pose[keep]
    size = np.median(np.linalg.norm(r, axis=1)) * 6.0
    r = r * np.minimum(1.0, size / np.maximum(np.linalg.norm(r, axis=1), 1e-300))[:, None]
    targets = (r, np.einsum("nji,nj->ni", R, r))
    best = max((_saved(X, t, pose, ridge), i, ridge) for i, t in enumerate(targets) for ridge in RIDGES)
    (mean, t_value), i, ridge = best
    significant = mean > 0.0 and t_value > settings.flexible_sigmas
    variables: tuple[str, ...] = ()
    if significant:
        cost = [mean - _saved(np.delete(X, k, axis=1), targets[i], pose, ridge)[0] for k in range(len(names))]
        variables = tuple(names[k] for k in np.argsort(cost)[::-1][:3] if cost[k] > 0.0)
    return Flexible(float(np.sqrt(max(mean, 0.0))), significant, variables)


def _saved(X: Array, target: Array, pose: IntArray, ridge: float) -> tuple[float, float]:
    """Mean squared error that a kernel ridge regression saves on held-out poses, and its t value over poses."""
    d2 = ((X[:, None, :] - X[None, :, :]) ** 2).sum(axis=2) / (2.0 * SETTINGS.flexible.length**2 * X.shape[1])
    K = np.exp(-d2)
    which = np.unique(pose)
    fold = np.random.default_rng(0).permutation(len(which)) % SETTINGS.flexible.folds
    fold_of_row = fold[np.searchsorted(which, pose)]
    saved = np.empty(len(target))
    for f in range(SETTINGS.flexible.folds):
        test = fold_of_row == f
        train = ~test
        A = K[np.ix_(train, train)] + ridge * np.eye(int(train.sum()))
        predicted = K[np.ix_(test, train)] @ np.linalg.solve(A, target[train])
        saved[test] = (target[test] ** 2).sum(axis=1) - ((target[test] - predicted) ** 2).sum(axis=1)
    per_pose = np.array([saved[pose == p].mean() for p in which])
    mean = float(saved.mean())
    return mean, float(per_pose.mean() / max(per_pose.std(ddof=1) / np.sqrt(len(which)), 1e-300))
