# SPDX-License-Identifier: Apache-2.0
"""Where the residual is: ranked views with effect size and a test that takes poses as its units.

Each view is a small set of columns along which the residual might lie. Its share of the squared residual is tested by
flipping the sign of whole poses at random: under the null the residual of a pose has no preferred sign, whatever its rows
share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..identification.observe import Observation
from ..identification.validation import rms
from ..lengths import length
from ..typing import Array
from .result import View
from .settings import SETTINGS

DRAWS = 4000
BINS = 4


@dataclass(frozen=True)
class _Side:
    """One view: columns (m, 3, d) and the label of the bin of each row, (m,)."""

    name: str
    words: str
    columns: Array
    labels: list[str]


def views(observation: Observation, residual: Array, predicted: Array) -> tuple[View, ...]:
    """All views of a residual, the largest significant share first.

    Args:
        residual, predicted: (m, 3), m, in base_link.
    """
    rng = np.random.default_rng(0)
    poses = observation.poses
    flips = rng.choice((-1.0, 1.0), (DRAWS, len(poses)))
    index = np.searchsorted(poses, observation.pose)
    r = observation.whiten(residual)
    total = float((r**2).sum())
    sides = [s for s in _sides(observation, predicted) if np.any(np.abs(s.columns) > 0)]
    out = []
    for side in sides:
        d = side.columns.shape[2]
        columns = observation.whiten(side.columns).reshape(-1, d)
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        Q = u[:, s > 1e-8 * max(s[0], 1e-30)]
        per_row = (Q * r.reshape(-1, 1)).reshape(len(r), 3, -1).sum(axis=1)
        per_pose = np.zeros((len(poses), Q.shape[1]))
        np.add.at(per_pose, index, per_row)
        found = float((per_pose.sum(axis=0) ** 2).sum())
        by_chance = ((flips @ per_pose) ** 2).sum(axis=1)
        p = (1.0 + float((by_chance >= found * (1 - 1e-12)).sum())) / (DRAWS + 1.0) if len(poses) >= SETTINGS.where_poses else 1.0
        corrected = min(1.0, p * len(sides))
        share = found / total if total > 0.0 else 0.0
        # what as many columns would catch of plain noise
        by_noise = min(Q.shape[1] / r.size, 0.999)
        share = max(0.0, (share - by_noise) / (1.0 - by_noise))
        out.append(_view(side, residual, share, corrected))
    out.append(_worst_pose(observation, residual))
    return tuple(sorted(out, key=lambda v: (not v.shows, -v.share)))


def _view(side: _Side, residual: Array, share: float, p: float) -> View:
    labels = np.array(side.labels)
    left = {str(x): rms(residual[labels == x]) for x in dict.fromkeys(side.labels)}
    worst = max(left, key=lambda k: left[k])
    where = f", most at {worst} ({length(left[worst])})" if len(left) > 1 else ""
    shows = p <= SETTINGS.where_p and share >= SETTINGS.where_share
    if not shows:
        sentence = f"No sign that the residual {side.words}."
    else:
        sentence = f"{100 * share:.0f} % of the squared residual {side.words}{where}."
    return View(side.name, worst, left[worst], share, p, sentence, shows)


def _worst_pose(observation: Observation, residual: Array) -> View:
    squared = (residual**2).sum(axis=1)
    sums = {int(p): float(squared[observation.pose == p].sum()) for p in observation.poses}
    worst = max(sums, key=lambda k: sums[k])
    share = sums[worst] / max(sum(sums.values()), 1e-300)
    left = rms(residual[observation.pose == worst])
    typical = float(np.sqrt(np.median([s / (observation.pose == p).sum() for p, s in sums.items()])))
    stands_out = len(sums) >= SETTINGS.where_poses and left > 3.0 * max(typical, observation.whiten.floor)
    sentence = (
        f"Pose {worst} has {100 * share:.0f} % of the squared residual "
        f"({length(left)}, the typical pose {length(typical)})."
    )
    return View("pose", str(worst), left, share, 0.0 if stands_out else 1.0, sentence, stands_out)


def _sides(observation: Observation, predicted: Array) -> list[_Side]:
    scene, rows, session = observation.scene, observation.rows, observation.session
    m = len(rows)
    eye = np.tile(np.eye(3), (m, 1, 1))
    tool = scene.kin.R_tool[rows]
    commanded = observation.of(scene.p_observed) if scene.kind == "loaded" else scene.p_observed[rows]
    J = scene.J[rows]
    tau, gravity = scene.load_torque()[rows], scene.tau_gravity[rows] * (scene.kind == "loaded")
    all_rows = ["all"] * m
    cases = [session.case_name(int(j)) for j in scene.load_case[rows]]
    out = [
        _Side("base frame", "is a constant vector in the base frame", eye, all_rows),
        _Side("tool frame", "is a constant vector in the tool frame", tool, all_rows),
        _Side("along predicted", "lies along the predicted deflection", predicted[:, :, None], all_rows),
        _Side("along displacement", "is parallel to the measured displacement", (commanded + predicted)[:, :, None], all_rows),
        _Side("across displacement", "is a rotation of the measured displacement", _turned(commanded + predicted), all_rows),
        _Side("load_case", "depends on the load case", _by_label(cases, tool), [f"load case {c}" for c in cases]),
    ]  # fmt: skip

    def smooth(name: str, words: str, values: Array, frame: Array = eye) -> None:
        if not np.isfinite(values).all() or np.ptp(values) <= 1e-9 * max(1.0, float(np.abs(values).max())):
            return
        v = (values - values.mean()) / values.std()
        columns = np.concatenate([frame * v[:, None, None], frame * (v**2 - 1.0)[:, None, None]], axis=2)
        out.append(_Side(name, words, columns, _bins(name, values)))

    for k in range(scene.n_joints):
        t, axis = tau[:, k], J[:, :, k : k + 1]
        scale = max(float(np.abs(t).max()), 1e-9)
        bins = _bins(f"tau_{k + 1}", t)
        out.append(_Side(f"tau_{k + 1}", f"turns axis {k + 1} in proportion to its torque", axis * t[:, None, None], bins))
        bent = axis * ((t / scale) ** 3)[:, None, None]
        out.append(_Side(f"tau_{k + 1} cubed", f"turns axis {k + 1} nonlinearly in its torque", bent, bins))
        side = np.sign(t + gravity[:, k]) - np.sign(gravity[:, k])
        total = f"turns axis {k + 1} where its total torque (with gravity) changes sign"
        out.append(
            _Side(f"sign tau_{k + 1}", total, axis * side[:, None, None], [f"sign {s:+.0f}" for s in np.sign(t + gravity[:, k])])
        )
        step = f"turns axis {k + 1} in proportion to its step"
        out.append(_Side(f"step_{k + 1}", step, axis * scene.step[rows, k, None, None], all_rows))
        smooth(f"joint_{k + 1}", f"depends on the angle of joint {k + 1}", scene.q[rows, k])
    smooth("reach", "depends on the reach", np.linalg.norm(scene.p_tcp[rows], axis=1))
    for a, letter in enumerate("xyz"):
        smooth(f"tcp_{letter}", f"depends on where on the surface the pose is (base {letter})", scene.p_tcp[rows, a])
    for name, values in scene.ext.items():
        smooth(f"ext_{name}", f"depends on the external axis {name}", values[rows])
    if scene.clock == "time":
        smooth("stamp", "depends on the time in the session", scene.stamp[rows])
        since = scene.stamp[rows] - scene.stamp[scene.reference[rows]] if scene.kind == "loaded" else scene.stamp[rows] * 0.0
        smooth("time since reference", "grows with the time since the reference", since)
    for name, values in scene.temperature.items():
        smooth(f"temp_{name}", f"depends on the temperature {name}", values[rows])
    if len(scene.stations) > 1:
        at = [scene.stations[s] for s in scene.station[rows]]
        out.append(_Side("station", "depends on the tracker station", _by_label(at, eye), [f"station {s}" for s in at]))
    before = scene.load_case[np.maximum(scene.previous[rows], 0)]
    if scene.kind == "loaded" and len(np.unique(before)) > 2:
        came = [f"after {session.case_name(int(j))}" for j in before]
        out.append(_Side("order", "depends on the load case before", _by_label(came, tool), came))
    return out


def _turned(v: Array) -> Array:
    return np.stack([np.cross(e, v) for e in np.eye(3)], axis=2)


def _by_label(labels: list[str], frame: Array) -> Array:
    array = np.array(labels)
    return np.concatenate([frame * (array == x)[:, None, None] for x in dict.fromkeys(labels)], axis=2)


def _bins(name: str, values: Array) -> list[str]:
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    return [f"{name} {edges[i]:.3g} .. {edges[i + 1]:.3g}" for i in which]
