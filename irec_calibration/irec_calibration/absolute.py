# SPDX-License-Identifier: Apache-2.0
"""What identification from an `absolute` session needs besides: where the instruments stand, which geometric parameters the poses
determine at all, and rows that are no measurement of this robot.

In such a session every row is one pose and nothing cancels: stations and markers whose pose is not known are unknowns of the fit,
and the geometry of the arm is part of the base model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from .effects import find_effect
from .model import GEOMETRIC, Estimate, Term, regressors
from .observe import Observation
from .session.data import Session
from .typing import Array, BoolArray, IntArray

GEOMETRY = "geometry_error"
DETERMINED = 2.0  # parameter scales (2 mm, 2 mrad): a geometric parameter with a larger standard error is not determined
STRUCTURAL = 1e-6  # share of a column that must be left when what is chosen already is taken out
OUTLIER = 6.0  # median residuals beyond which a row is an outlier (9 standard deviations of normal noise)
OUTLIERS_AT_MOST = 0.05  # of the rows; where more stand out they are no outliers
NEAR, NEAR_M = 0.02, 0.01  # rad, m: in every joint; poses this close should have the same error
FEWEST_PAIRS = 10
REPEATING = 0.6  # difference within pairs over the residual itself; independent errors would differ by 1.4 times their size
REPEATS = "the residual repeats with the pose"
THINNED_TO = 1000  # poses; a comparison of many models does not get better by more


def base_terms() -> tuple[Term, ...]:
    """The geometric model: stations, markers, geometry, without values."""
    return tuple(Term(find_effect(e)) for e in GEOMETRIC)


def completed(terms: Sequence[Term], observation: Observation) -> tuple[Term, ...]:
    """Terms of an absolute session with what every model of it needs; terms of a loaded session as they are.

    Unknown stations and markers get their terms; `geometry_error` without values gets those parameters that the
    poses determine.
    """
    if observation.session.kind != "absolute":
        return tuple(terms)
    present = {t.effect.id for t in terms}
    registering = [find_effect(e) for e in GEOMETRIC if e != GEOMETRY]
    out = [Term(e) for e in registering if e.id not in present and e.parameters(observation.scene)] + list(terms)
    out = [t for t in out if not t.effect.registers or t.effect.parameters(observation.scene)]
    for i, term in enumerate(out):
        if term.effect.id == GEOMETRY and not term.estimates:
            own = {p.name: p for p in term.effect.parameters(observation.scene)}
            kept = determined_geometry(tuple(out), i, observation)
            out[i] = replace(term, estimates={n: Estimate(0.0, unit=own[n].unit) for n in own if n in kept})
    return tuple(t for t in out if t.effect.id != GEOMETRY or t.estimates)


def determined_geometry(terms: tuple[Term, ...], index: int, observation: Observation) -> set[str]:
    """Names of the geometric parameters that a session determines beside stations and markers.

    Orthogonal-triangular decomposition of the whitened columns with pivoting: joint zeros are preferred, then places of axes and
    tilts, each time the one of which most is left. Chosen are those with a standard error below `DETERMINED`.

    Args:
        terms: all terms.
        index: of `geometry_error` among them.
    """
    scene = observation.scene
    placing = [replace(t, estimates={}) for t in terms if t.effect.registers]
    geometry = replace(terms[index], estimates={})
    # where the model has the marker, not where it was measured: else errors of the geometry pass for a difference between a
    # turned station and a turned first axis
    blocks = regressors([*placing, geometry], replace(scene, measured_from_station=scene.modelled_from_station))
    scale = np.array([p.scale for t in (*placing, geometry) for p in t.effect.parameters(scene)])
    A = observation.whiten(observation.of(np.concatenate(blocks, axis=2)) * scale).reshape(-1, len(scale))
    b = observation.whiten(observation.y).reshape(-1)
    R: Array = np.asarray(np.linalg.qr(np.column_stack([A, b]), mode="r"))
    names = [p.name for p in geometry.effect.parameters(scene)]
    first = len(scale) - len(names)
    excess = _excess(R, len(b))
    R = R[:, :-1]
    norm = np.linalg.norm(R, axis=0)
    left = R.copy()
    chosen: list[int] = []
    groups = [list(range(first)), [first + i for i, n in enumerate(names) if n.startswith("zero")]]
    groups.append([j for j in range(first, len(scale)) if j not in groups[1]])
    for group in groups:
        open_ = list(group)
        while open_:
            size = np.linalg.norm(left[:, open_], axis=0)
            best = int(np.argmax(size))
            j = open_.pop(best)
            if size[best] <= max(STRUCTURAL * norm[j], excess / DETERMINED):
                break
            u = left[:, j] / size[best]
            left = left - np.outer(u, u @ left)
            chosen.append(j)
    return {names[j - first] for j in chosen if j >= first}


def _excess(R: Array, equations: int) -> float:
    """How many times larger than stated the noise seems to be beside the best fit of all columns; at least 1."""
    A, b = R[:, :-1], R[:, -1]
    u, s, _ = np.linalg.svd(A)
    known = u[:, : int((s > STRUCTURAL * s[0]).sum())]
    left = float(np.sqrt(max(b @ b - ((known.T @ b) ** 2).sum(), 0.0)))
    return max(1.0, left / np.sqrt(max(equations - A.shape[1], 1)))


def held_geometry(terms: Sequence[Term], observation: Observation) -> tuple[str, ...]:
    """Geometric parameters that are held at zero because others of the model do the same in these poses."""
    for term in terms:
        if term.effect.id == GEOMETRY and observation.session.kind == "absolute":
            return tuple(p.name for p in term.effect.parameters(observation.scene) if p.name not in term.estimates)
    return ()


def outlying(residual: Array) -> BoolArray:
    """Rows whose residual stands out, (m,); none where too many would."""
    size = np.linalg.norm(residual, axis=1)
    out: BoolArray = size > OUTLIER * np.median(size)
    return out if out.mean() <= OUTLIERS_AT_MOST else np.zeros(len(size), dtype=bool)


def thinned(observation: Observation, most: int = THINNED_TO) -> Observation:
    """An observation with at most so many whole poses, spread evenly over the session; history and time stay as they were."""
    poses = observation.poses
    if len(poses) <= most or observation.session.kind != "absolute":
        return observation
    kept = poses[np.unique(np.linspace(0, len(poses) - 1, most).astype(int))]
    note = f"{len(kept)} of {len(poses)} poses, spread evenly, are used for comparing models"
    few = observation.only(np.isin(observation.pose, kept))
    index = np.arange(len(few.rows))
    few = replace(few, session=few.session.select(few.rows), scene=few.scene.take(few.rows), rows=index)
    return noted(few, note)


@dataclass(frozen=True)
class NearPairs:
    """Pairs of poses that are close in all joints, and the residuals there.

    Attributes:
        first, second: index of the observed row of each, (pairs,).
        difference_m, residual_m: median norm of the residuals' difference over pairs, and of the residual itself, m.
    """

    first: IntArray
    second: IntArray
    difference_m: float
    residual_m: float

    @property
    def repeats(self) -> bool:
        """The residual is a property of the pose, not noise."""
        return len(self.first) >= FEWEST_PAIRS and self.difference_m < REPEATING * self.residual_m


def near_pairs(observation: Observation, residual: Array) -> NearPairs:
    """Residuals of poses that are close to each other but not measured in succession.

    Args:
        residual: (m, 3), m.
    """
    scene, session, rows = observation.scene, observation.session, observation.rows
    spread = np.where(scene.kin.is_prismatic, NEAR_M / NEAR, 1.0)
    found = cKDTree(scene.q[rows] / spread).query_pairs(NEAR, p=np.inf, output_type="ndarray")
    order = np.argsort(np.argsort(session.stamp[rows], kind="stable"))
    apart = observation.pose[found[:, 0]] != observation.pose[found[:, 1]]
    apart &= session.marker[rows[found[:, 0]]] == session.marker[rows[found[:, 1]]]
    if session.clock != "none":
        # the arm must have been elsewhere in between: a pose that was only nudged proves nothing
        apart &= np.abs(order[found[:, 0]] - order[found[:, 1]]) > 1
    found = found[apart]
    size = float(np.median(np.linalg.norm(residual, axis=1)))
    change = np.linalg.norm(residual[found[:, 0]] - residual[found[:, 1]], axis=1)
    return NearPairs(found[:, 0], found[:, 1], float(np.median(change)) if len(change) else float("nan"), size)


def repeating(pairs: NearPairs) -> str:
    """A sentence where the residual repeats with the pose, else an empty string."""
    if not pairs.repeats:
        return ""
    return (
        f"{REPEATS}: in {len(pairs.first)} pairs of poses within {NEAR} rad in every joint, not measured in succession, it "
        "differs by"
        f" {1e3 * pairs.difference_m:.3f} mm (median), while it is {1e3 * pairs.residual_m:.3f} mm itself; it is missing "
        "from the model, not noise"
    )


def noted(observation: Observation, note: str) -> Observation:
    """The observation with a note for the user on its session."""
    session: Session = observation.session
    return replace(observation, session=replace(session, notes=(*session.notes, note)))
