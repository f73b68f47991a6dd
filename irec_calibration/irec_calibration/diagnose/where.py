# SPDX-License-Identifier: Apache-2.0
"""Where the residual is: ranked views with effect size and a test that takes poses as its units.

Each view is a small set of columns along which the residual might lie. Its share of the squared residual is tested by
flipping the sign of whole poses at random: under the null the residual of a pose has no preferred sign, whatever its rows
share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..identification.observe import Observation
from ..identification.validation import rms
from ..lengths import length
from ..typing import Array
from .result import View
from .settings import SETTINGS

DRAWS = 4000
BINS = 4
SIGNS = {-1: "negative", 0: "vanishing", 1: "positive"}


@dataclass(frozen=True)
class _Side:
    """One view: columns (m, 3, d), the bin of each row, (m,), and how a bin is said in a sentence."""

    name: str
    words: str
    columns: Array
    labels: list[str]
    said: str = "{}"


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
    where = f", most with {side.said.format(worst)} ({length(left[worst])} there)" if len(left) > 1 else ""
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
    stands_out = len(sums) >= SETTINGS.where_poses and left > SETTINGS.where_typical * max(typical, observation.whiten.floor)
    sentence = (
        f"Pose {worst} has {100 * share:.0f} % of the squared residual ({length(left)}, the typical pose {length(typical)})."
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
        _Side("load_case", "depends on the load case", _by_label(cases, tool), cases, "load case {}"),
    ]  # fmt: skip

    def smooth(name: str, words: str, values: Array, said: str) -> None:
        if not np.isfinite(values).all() or np.ptp(values) <= 1e-9 * max(1.0, float(np.abs(values).max())):
            return
        v = (values - values.mean()) / values.std()
        columns = np.concatenate([eye * v[:, None, None], eye * (v**2 - 1.0)[:, None, None]], axis=2)
        out.append(_Side(name, words, columns, _bins(values), said))

    for k in range(scene.n_joints):
        t, axis = tau[:, k], J[:, :, k : k + 1]
        scale = max(float(np.abs(t).max()), 1e-9)
        about, said, bins = f"is a rotation about axis {k + 1}", f"tau_{k + 1} of {{}} N m", _bins(t)
        out.append(_Side(f"tau_{k + 1}", f"{about} in proportion to its torque", axis * t[:, None, None], bins, said))
        bent = axis * ((t / scale) ** 3)[:, None, None]
        out.append(_Side(f"tau_{k + 1} cubed", f"{about} that is not in proportion to its torque", bent, bins, said))
        total = np.sign(t + gravity[:, k])
        side = axis * (total - np.sign(gravity[:, k]))[:, None, None]
        words = f"{about} that jumps where its total torque (gravity included) changes sign"
        signs = [SIGNS[int(x)] for x in total]
        out.append(_Side(f"sign tau_{k + 1}", words, side, signs, "a {} total torque"))
        step = f"{about} in proportion to its motion since the sample before"
        out.append(_Side(f"step_{k + 1}", step, axis * scene.step[rows, k, None, None], all_rows))
        slides = bool(scene.kin.is_prismatic[k])
        at_joint = scene.q[rows, k] if slides else np.rad2deg(scene.q[rows, k])
        smooth(f"joint_{k + 1}", f"depends on joint {k + 1}", at_joint, f"joint_{k + 1} at {{}} {'m' if slides else 'deg'}")
    smooth("reach", "depends on the reach", np.linalg.norm(scene.p_tcp[rows], axis=1), "a reach of {} m")
    for a, letter in enumerate("xyz"):
        smooth(f"tcp_{letter}", f"depends on the place of the pose (base {letter})", scene.p_tcp[rows, a], f"{letter} at {{}} m")
    for name, values in scene.ext.items():
        smooth(f"ext_{name}", f"depends on the external axis {name}", values[rows], f"ext_{name} at {{}}")
    if scene.clock == "time":
        passed = scene.stamp[rows] - scene.stamp.min()
        smooth("stamp", "depends on the time in the session", passed, "{} s after the first sample")
        since = scene.stamp[rows] - scene.stamp[scene.reference[rows]] if scene.kind == "loaded" else scene.stamp[rows] * 0.0
        smooth("time since reference", "grows with the time since the reference", since, "{} s since the reference")
    for name, values in scene.temperature.items():
        smooth(f"temp_{name}", f"depends on the temperature {name}", values[rows], f"temp_{name} at {{}} degC")
    if len(scene.stations) > 1:
        at = [scene.stations[s] for s in scene.station[rows]]
        out.append(_Side("station", "depends on the tracker station", _by_label(at, eye), at, "station {}"))
    before = scene.load_case[np.maximum(scene.previous[rows], 0)]
    if scene.kind == "loaded" and len(np.unique(before)) > 2:
        came = [session.case_name(int(j)) for j in before]
        out.append(_Side("order", "depends on the load case before", _by_label(came, tool), came, "{} before"))
    if observation.sees is None:
        return out
    # without a tracker the point is believed to stay: what seems to move it is the residual itself
    return [replace(s, columns=observation.sees @ s.columns) for s in out if not s.name.endswith("displacement")]


def _turned(v: Array) -> Array:
    return np.stack([np.cross(e, v) for e in np.eye(3)], axis=2)


def _by_label(labels: list[str], frame: Array) -> Array:
    array = np.array(labels)
    return np.concatenate([frame * (array == x)[:, None, None] for x in dict.fromkeys(labels)], axis=2)


def _bins(values: Array) -> list[str]:
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    span = float(np.ptp(values))
    digits = int(np.clip(2 - np.floor(np.log10(span)), 0, 12)) if span > 0.0 else 3
    ends = [f"{e + 0.0:.{digits}f}" for e in np.round(edges, digits)]
    return [f"{ends[i]} to {ends[i + 1]}" for i in which]
