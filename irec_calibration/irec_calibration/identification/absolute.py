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

from ..effects import absent, find_effect, known_effects, parameters_of
from ..effects.scene import Scene
from ..model import GEOMETRIC, Estimate, Term, regressors
from ..session.data import Session
from ..typing import Array, IntArray
from .observe import Observation
from .settings import ABSOLUTE
from .tool_weight import as_read


def base_terms() -> tuple[Term, ...]:
    """The geometric model: stations, markers, geometry, without values."""
    return tuple(Term(find_effect(e)) for e in GEOMETRIC)


def completed(terms: Sequence[Term], observation: Observation) -> tuple[Term, ...]:
    """Terms of an absolute session with what every model of it needs; those of a loaded session with what its references show.

    Unknown stations and markers get their terms, and these every station and marker of the session, whichever they named
    before (of a model of another session; a reflector that was found to be seated anew). An effect that is `chosen_by_poses`,
    without values, gets those parameters that the poses determine. Parameters that are a share of another one
    (`Parameter.share_of`) come with that.
    """
    if observation.session.kind != "absolute":
        return tuple(_with_shares(as_read(t, observation), observation) for t in terms)
    present = {t.effect.id for t in terms}
    registering = [find_effect(e) for e in GEOMETRIC]
    out = [Term(e) for e in registering if e.registers and e.id not in present and e.parameters(observation.scene)] + list(terms)
    out = [t.whole(t.effect.parameters(observation.scene)) if t.effect.registers else t for t in out]
    out = [t for t in out if not t.effect.registers or t.effect.parameters(observation.scene)]
    for i, term in enumerate(out):
        if term.effect.chosen_by_poses and not term.estimates:
            own = {p.name: p for p in term.effect.parameters(observation.scene)}
            kept = determined_geometry(tuple(out), i, observation)
            out[i] = replace(term, estimates={n: Estimate(0.0, unit=own[n].unit) for n in own if n in kept})
    return tuple(t for t in out if not t.effect.chosen_by_poses or t.estimates)


def _with_shares(term: Term, observation: Observation) -> Term:
    own = parameters_of(term.effect, observation.scene)
    more = [p for p in own if p.share_of in term.estimates and p.name not in term.estimates]
    if not more:
        return term
    added = {p.name: Estimate(p.start, unit=p.unit, lower=p.lower, upper=p.upper) for p in more}
    return replace(term, estimates={**term.estimates, **added})


def determined_geometry(terms: tuple[Term, ...], index: int, observation: Observation) -> set[str]:
    """Names of the geometric parameters that a session determines beside stations and markers.

    Orthogonal-triangular decomposition of the whitened columns with pivoting: parameters that come `first` (joint zeros), then
    the others, each time the one of which most is left. Chosen are those with a standard error below `ABSOLUTE.determined`.

    Args:
        terms: all terms.
        index: of the effect whose parameters are chosen.
    """
    scene = observation.scene
    placing = [replace(t, estimates={}) for t in terms if t.effect.registers]
    geometry = replace(terms[index], estimates={})
    # where the model has the marker, not where it was measured: else errors of the geometry pass for a difference between a
    # turned station and a turned first axis
    blocks = regressors([*placing, geometry], _as_modelled(scene))
    scale = np.array([p.scale for t in (*placing, geometry) for p in t.effect.parameters(scene)])
    A = observation.whiten(observation.of(np.concatenate(blocks, axis=2)) * scale).reshape(-1, len(scale))
    b = observation.whiten(observation.y).reshape(-1)
    R: Array = np.asarray(np.linalg.qr(np.column_stack([A, b]), mode="r"))
    own = geometry.effect.parameters(scene)
    names = [p.name for p in own]
    first = len(scale) - len(names)
    springs = [observation.whiten(observation.of(c)).reshape(len(b), -1) for c in _never_noise(scene)]
    excess = _excess(np.asarray(np.linalg.qr(np.column_stack([A, *springs, b]), mode="r")), len(b))
    R = R[:, :-1]
    norm = np.linalg.norm(R, axis=0)
    left = R.copy()
    chosen: list[int] = []
    groups = [list(range(first)), [first + i for i, p in enumerate(own) if p.first]]
    groups.append([j for j in range(first, len(scale)) if j not in groups[1]])
    for group in groups:
        open_ = list(group)
        while open_:
            size = np.linalg.norm(left[:, open_], axis=0)
            best = int(np.argmax(size))
            j = open_.pop(best)
            if size[best] <= max(ABSOLUTE.structural * norm[j], excess / ABSOLUTE.determined):
                break
            u = left[:, j] / size[best]
            left = left - np.outer(u, u @ left)
            chosen.append(j)
    return {names[j - first] for j in chosen if j >= first}


def _never_noise(scene: Scene) -> list[Array]:
    """Columns of springs that a robot and what it stands on may have, and of what every known station has, (n, 3, p) each, in
    units of their scale.

    How far they sag, and how far a station is turned, is no noise, whether a model has them yet or not.
    """
    out = []
    for effect in known_effects().values():
        there = (effect.elastic and not effect.completes) or scene.kind in effect.usual_in
        own = effect.parameters(scene) if there and not absent(scene, effect.needs) else ()
        if own and not any(p.grid for p in own):
            (columns,) = regressors([Term(effect)], scene)
            out.append(columns * np.array([p.scale for p in own]))
    return out


def _as_modelled(scene: Scene) -> Scene:
    """With the markers where the model has them instead of where they were measured."""
    return replace(scene, instruments=replace(scene.instruments, measured_from_station=scene.instruments.modelled_from_station))


def _excess(R: Array, equations: int) -> float:
    """How many times larger than stated the noise seems to be beside the best fit of all columns; at least 1."""
    A, b = R[:, :-1], R[:, -1]
    u, s, _ = np.linalg.svd(A)
    known = u[:, : int((s > ABSOLUTE.structural * s[0]).sum())]
    left = float(np.sqrt(max(b @ b - ((known.T @ b) ** 2).sum(), 0.0)))
    return max(1.0, left / np.sqrt(max(equations - A.shape[1], 1)))


def held_geometry(terms: Sequence[Term], observation: Observation) -> tuple[str, ...]:
    """Parameters (`effect.parameter`) that are held at zero because others of the model do the same in these poses."""
    for term in terms:
        if term.effect.chosen_by_poses and observation.session.kind == "absolute":
            own = term.effect.parameters(observation.scene)
            return tuple(f"{term.effect.id}.{p.name}" for p in own if p.name not in term.estimates)
    return ()


def thinned(observation: Observation, most: int = ABSOLUTE.thinned_to, rows: int = ABSOLUTE.thinned_rows) -> Observation:
    """An observation of so many whole poses or fewer, spread evenly over the session; history and time stay as they were.

    Args:
        most: poses. rows: of all of them together, with which the cost of a comparison grows.
    """
    poses = observation.poses
    most = min(most, max(rows * len(poses) // max(len(observation.rows), 1), 1))
    if len(poses) <= most or observation.session.kind != "absolute":
        return observation
    paired = _paired(observation, most // (2 * ABSOLUTE.in_pairs))
    rest = np.setdiff1d(poses, paired)
    kept = np.union1d(paired, rest[np.unique(np.linspace(0, len(rest) - 1, most - len(paired)).astype(int))])
    note = f"{len(kept)} of {len(poses)} poses, spread evenly, are used for comparing models"
    few = observation.only(np.isin(observation.pose, kept))
    index = np.arange(len(few.rows))
    few = replace(few, session=few.session.select(few.rows), scene=few.scene.take(few.rows), rows=index)
    return noted(few, note)


def _paired(observation: Observation, most: int) -> IntArray:
    """Poses of so many pairs or fewer that are close to each other, spread evenly: they tell the noise, which the rest can't."""
    pairs = near_pairs(observation, observation.y)
    if len(pairs.first) < ABSOLUTE.fewest_pairs or most < ABSOLUTE.fewest_pairs:
        return np.zeros(0, dtype=observation.pose.dtype)
    index = np.unique(np.linspace(0, len(pairs.first) - 1, min(most, len(pairs.first))).astype(int))
    paired: IntArray = np.unique(observation.pose[np.concatenate([pairs.first[index], pairs.second[index]])])
    return paired


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
        return len(self.first) >= ABSOLUTE.fewest_pairs and self.difference_m < ABSOLUTE.repeating * self.residual_m


def near_pairs(observation: Observation, residual: Array) -> NearPairs:
    """Residuals of poses that are close to each other but not measured in succession.

    Args:
        residual: (m, 3), m.
    """
    scene, session, rows = observation.scene, observation.session, observation.rows
    spread = np.where(scene.kin.is_prismatic, ABSOLUTE.near_m / ABSOLUTE.near, 1.0)
    found = cKDTree(scene.q[rows] / spread).query_pairs(ABSOLUTE.near, p=np.inf, output_type="ndarray")
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
        "the residual repeats with the pose:"
        f" in {len(pairs.first)} pairs of poses within {ABSOLUTE.near} rad in every joint, not measured in succession, it "
        "differs by"
        f" {1e3 * pairs.difference_m:.3f} mm (median), while it is {1e3 * pairs.residual_m:.3f} mm itself; it is missing "
        "from the model, not noise"
    )


def noted(observation: Observation, note: str) -> Observation:
    """The observation with a note for the user on its session."""
    session: Session = observation.session
    return replace(observation, session=replace(session, notes=(*session.notes, note)))


def with_better_joints(session: Session) -> Session:
    """The session with those joint angles, reported or commanded (`target_*`), that fit the geometric model better.

    A note says which. A session without a complete `target_*` is returned unchanged.
    """
    target = session.q_target
    if target is None or session.kind != "absolute":
        return session
    if not np.isfinite(target).all():
        return replace(session, notes=(*session.notes, "target_* is not complete and therefore not used"))
    if np.abs(target - session.q).max() < 1e-9:
        return session
    commanded = replace(session, q=target)
    if not session.has_tcp:
        commanded = replace(commanded, p_tcp_in_base=session.robot.kinematics(target).p_tcp)
    reported, other = (_geometric_misfit(s) for s in (session, commanded))
    words = f"beside the geometry reported joint angles leave {1e3 * reported:.4g} mm (median), commanded {1e3 * other:.4g} mm"
    if other < ABSOLUTE.better * reported:
        if lag := _read_on_the_way(session, target):
            words = f"{words}; {lag}, as joint_settling"
            return replace(session, notes=(*session.notes, f"{words}: the reported ones (joint_*) are used"))
        return replace(commanded, notes=(*session.notes, f"{words}: the commanded ones (target_*) are used"))
    return replace(session, notes=(*session.notes, f"{words}: the reported ones (joint_*) are used"))


def _read_on_the_way(session: Session, target: Array) -> str:
    """A sentence where reported joint angles differ from the commanded ones by a share of the step just made: then an effect has
    what they lack (`joint_settling`), and is to be found; else empty."""
    from .observe import observe

    if session.clock == "none":
        return ""
    step, off = observe(session).scene.step, target - session.q
    off = off - np.median(off, axis=0)
    near = np.abs(off).max(axis=1) < ABSOLUTE.largest_lag  # others are those of another pose
    step, off = step[near], off[near]
    share = (step * off).sum(axis=0) / np.maximum((step**2).sum(axis=0), 1e-12)
    left = ((off - step * share) ** 2).sum() / max((off**2).sum(), 1e-300)
    if left > ABSOLUTE.left_of_lag:
        return ""
    axes = ", ".join(f"axis {k + 1} {1e3 * abs(a):.2g}" for k, a in enumerate(share) if abs(a) > 0.1 * np.abs(share).max())
    return f"they differ by so many thousandths of the step before: {axes}"


def _geometric_misfit(session: Session) -> float:
    from .gauss_newton import fitted  # which completes terms by this module
    from .observe import observe
    from .outliers import robust_weights

    seen, terms = thinned(observe(session), ABSOLUTE.source_poses), base_terms()
    found = fitted(terms, seen.weighted(robust_weights(seen, terms)))  # one wrong row bends a fit of few poses by centimetres
    residual = seen.y - seen.of(found.moved)
    return float(np.median(np.linalg.norm(residual, axis=1)))
