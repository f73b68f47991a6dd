# SPDX-License-Identifier: Apache-2.0
"""Identification: the observation system Eq. (14)-(18) of any list of effects, its bounded solution Eq. (19), what is
identifiable, and standard errors.

Rows are weighted by the noise of the instruments, rows of one pose share the noise of their reference. Columns are scaled by
typical magnitudes, since compliances of 1e-7 would stop solvers early.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from . import __version__
from .absolute import base_terms, completed, held_geometry, near_pairs, noted, outlying, repeating
from .bounded import solve_bounded_gram
from .effects import Parameter, absent
from .errors import Cancelled, SolveError
from .model import (
    EIGHTEEN_DOF,
    Combination,
    Envelope,
    Estimate,
    Model,
    Term,
    blank_model,
    elastic_response,
    regressors,
    total_displacement,
)
from .observe import Observation, observe
from .scene import Scene
from .session.data import Session
from .typing import Array, BoolArray, IntArray, Json

STRUCTURAL_TOLERANCE = 1e-7  # singular value relative to the largest below which a direction is not observed at all
INVISIBLE = 1e-3  # standard deviations that all samples together see of a parameter of typical size; below: not visible
RIDGE = 1e-10  # relative to the largest diagonal entry: makes the solution unique along unobserved directions
MAX_ITERATIONS = 8
CONVERGED = 1e-6  # of the parameter scale
FOLDS = 10
GUESSED = (
    "the link masses of the robot description are guesses: of each compliance only its product with the masses that load "
    "it is known; deflection under gravity is what was measured, deflection under a process force is not to be predicted "
    "from it"
)


@dataclass(frozen=True)
class System:
    """The linearised observation system of some terms, whitened and scaled; 3m equations, p parameters.

    Attributes:
        A: (3m, p), standard deviations per scaled parameter.
        b: right side, (3m,), in standard deviations: residual plus A times the values linearised at.
        scale: physical value of one scaled unit, (p,).
        parameters: (p,), in order of the terms; owner: index of the term of each.
        lower, upper: bounds in scaled units, (p,).
        centre: value of each scaled parameter from which x counts, (p,): the present one where nothing but the session says
            anything about it (`Parameter.flat`), else 0.
        pose: pose number of each equation, (3m,).
    """

    A: Array
    b: Array
    scale: Array
    parameters: tuple[Parameter, ...]
    owner: tuple[int, ...]
    lower: Array
    upper: Array
    centre: Array
    pose: IntArray


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        terms: the terms with values.
        residual: measured minus predicted, in base_link, (m, 3), m.
        rms: sqrt(mean |r|^2) over samples, m.
        chi2: sum of whitened squared residuals; dof: equations minus rank.
        rank: numerical rank of the observation matrix.
        combinations: what is known of parameters that can't be told apart.
    """

    terms: tuple[Term, ...]
    observation: Observation
    residual: Array
    rms: float
    chi2: float
    dof: int
    rank: int
    condition: float
    combinations: tuple[Combination, ...]


def linearise(terms: Sequence[Term], observation: Observation) -> System:
    """The observation system of the terms about their values, without parameters that enter by a grid (held fixed).

    A term that names some of its effect's parameters has only those; the others are held where they start.
    """
    scene = observation.scene
    blocks, parameters, owner, values = [], [], [], []
    for i, (term, block) in enumerate(zip(terms, regressors(terms, scene), strict=True)):
        own = term.effect.parameters(scene)
        free = term.free(own)
        blocks.append(block[:, :, free])
        parameters += [own[j] for j in free]
        owner += [i] * len(free)
        values += list(term.theta(own)[free])
    if not parameters:
        raise SolveError("the model has no parameter that this session could determine")
    scale = np.array([p.scale for p in parameters])
    A_rows = observation.of(np.concatenate(blocks, axis=2)) * scale
    A = observation.whiten(A_rows).reshape(-1, len(parameters))
    residual = observation.whiten(observation.y - observation.of(total_displacement(terms, scene))).ravel()
    x = np.array(values) / scale
    centre = np.where([p.flat for p in parameters], x, 0.0)
    return System(
        A=A,
        b=residual + A @ (x - centre),
        scale=scale,
        parameters=tuple(parameters),
        owner=tuple(owner),
        lower=np.array([p.lower for p in parameters]) / scale - centre,
        upper=np.array([p.upper for p in parameters]) / scale - centre,
        centre=centre,
        pose=np.repeat(observation.pose, 3),
    )


def solve(system: System, rows: BoolArray | None = None, prior_width: Array | None = None) -> Array:
    """Bounded least squares, Eq. (19), in scaled units, (p,).

    Args:
        system: from `linearise`.
        rows: mask of equations to use, (3m,); all where None.
        prior_width: standard deviation of a normal prior about 0 for each scaled parameter, (p,); none where None.
    """
    A, b = (system.A, system.b) if rows is None else (system.A[rows], system.b[rows])
    G, h = A.T @ A, A.T @ b
    ridge = RIDGE * max(float(G.diagonal().max()), 1e-30)
    extra = np.full(len(h), ridge) if prior_width is None else np.maximum(1.0 / prior_width**2, ridge)
    return solve_bounded_gram(G + np.diag(extra), h, system.lower, system.upper)


def with_values(terms: Sequence[Term], system: System, x: Array) -> tuple[Term, ...]:
    """The terms with the scaled values x (counted from the system's centre); parameters that are not part of the system keep
    theirs."""
    out = []
    for i, term in enumerate(terms):
        estimates = dict(term.estimates)
        for j, (owner, p) in enumerate(zip(system.owner, system.parameters, strict=True)):
            if owner == i:
                value = float((x[j] + system.centre[j]) * system.scale[j])
                estimates[p.name] = Estimate(value, unit=p.unit, lower=p.lower, upper=p.upper)
        out.append(replace(term, estimates=estimates))
    return tuple(out)


def fit(
    terms: Sequence[Term],
    observation: Observation,
    *,
    prior_width: Array | None = None,
    cancelled: object = None,
) -> Fit:
    """Fit all parameters of the terms jointly (Gauss-Newton with bounds; one step where all is linear).

    Args:
        terms: effects with start values.
        observation: what was measured.
        prior_width: see `solve`.
        cancelled: called between iterations; returning True stops.

    Raises:
        SolveError: fewer equations than needed, or an effect of the model can't act on this session.
        Cancelled: as asked for.
    """
    terms = tuple(_with_starts(t, observation) for t in completed(terms, observation))
    x_last: Array | None = None
    for _ in range(MAX_ITERATIONS):
        if callable(cancelled) and cancelled():
            raise Cancelled("the fit was cancelled")
        system = linearise(terms, observation)
        x = solve(system, prior_width=prior_width)
        terms = with_values(terms, system, x)
        at = x + system.centre
        if x_last is not None and np.abs(at - x_last).max() < CONVERGED * (1.0 + np.abs(x).max()):
            break
        x_last = at
        if not any(t.effect.acts_on == "wrench" or t.effect.needs_elastic or _nonlinear(t, observation) for t in terms):
            break
    return _describe(terms, observation)


def _nonlinear(term: Term, observation: Observation) -> bool:
    """Whether the displacement of a term is not simply regressor times values."""
    scene = observation.scene
    theta = term.theta(term.effect.parameters(scene))
    on_grid = [bool(p.grid) for p in term.effect.parameters(scene)]
    by_regressor = term.effect.regressor(scene, theta) @ np.where(on_grid, 0.0, theta)
    return not np.allclose(by_regressor, term.effect.displacement(scene, theta), rtol=1e-9, atol=1e-12)


def _with_starts(term: Term, observation: Observation) -> Term:
    why = absent(observation.scene, term.effect.needs)
    if why:
        raise SolveError(f"effect '{term.effect.id}' can't be identified from {observation.session.name}: {why}")
    own = term.effect.parameters(observation.scene)
    named = [p for p in own if p.name in term.estimates] or own
    estimates = {
        p.name: term.estimates.get(p.name, Estimate(p.start, unit=p.unit, lower=p.lower, upper=p.upper)) for p in named
    }
    return replace(term, estimates=estimates)


def _describe(terms: tuple[Term, ...], observation: Observation) -> Fit:
    system = linearise(terms, observation)
    residual = observation.y - observation.of(total_displacement(terms, observation.scene))
    chi2 = float((observation.whiten(residual) ** 2).sum())
    names = [f"{terms[i].effect.id}.{p.name}" for i, p in zip(system.owner, system.parameters, strict=True)]
    norm = np.linalg.norm(system.A, axis=0)
    seen = norm > INVISIBLE
    _, s, Vt = np.linalg.svd(system.A[:, seen] / norm[seen], full_matrices=False)
    rank = int((s > STRUCTURAL_TOLERANCE * s[0]).sum()) if len(s) else 0
    known, hidden = Vt[:rank], Vt[rank:]
    variance = np.full(len(names), np.nan)
    loss = np.zeros(len(names))
    variance[seen] = ((known.T / s[:rank]) ** 2).sum(axis=1) / norm[seen] ** 2
    loss[seen] = np.sqrt((hidden**2).sum(axis=0)) if len(hidden) else 0.0
    single = seen & (loss < 1e-3)
    # an absolute session's residual holds what the robot does besides: errors that only the data sheet backs would be too small
    excess = max(1.0, np.sqrt(chi2 / max(residual.size - rank, 1))) if observation.session.kind == "absolute" else 1.0
    se = np.where(single, excess * np.sqrt(variance) * system.scale, np.nan)
    terms = _with_errors(terms, system, se, single)
    values = np.array([terms[i].estimates[p.name].value for i, p in zip(system.owner, system.parameters, strict=True)])
    to_physical = system.scale[seen] / norm[seen]
    covariance = excess**2 * (known.T / s[:rank] ** 2) @ known * np.outer(to_physical, to_physical)
    combinations = _combinations(hidden * to_physical, loss[seen], np.array(names)[seen], values[seen], covariance)
    rms = float(np.sqrt((residual**2).sum(axis=1).mean()))
    condition = float(s[0] / s[rank - 1]) if rank else np.inf
    return Fit(terms, observation, residual, rms, chi2, residual.size - rank, rank, condition, combinations)


def _with_errors(terms: tuple[Term, ...], system: System, se: Array, single: BoolArray) -> tuple[Term, ...]:
    out = []
    for i, term in enumerate(terms):
        estimates = dict(term.estimates)
        for j, (owner, p) in enumerate(zip(system.owner, system.parameters, strict=True)):
            if owner == i:
                value = estimates[p.name].value
                well_known = bool(single[j] and se[j] < 0.5 * max(abs(value), p.scale))
                estimates[p.name] = replace(estimates[p.name], se=float(se[j]), identified=well_known)
        out.append(replace(term, estimates=estimates))
    return tuple(out)


def _combinations(hidden: Array, loss: Array, names: Array, values: Array, covariance: Array) -> tuple[Combination, ...]:
    """Sums that stay the same along every direction that is not observed.

    Args:
        hidden: unobserved directions in physical units, (d, p).
        loss: share of each parameter that lies along them, (p,).
        covariance: of the observed part, in physical units, (p, p).
    """
    members = np.flatnonzero(loss >= 1e-3)
    if not len(members):
        return ()
    # reduced row echelon form: each parameter that is no pivot, corrected by the pivots, is a sum that is observed
    size = np.abs(hidden[:, members]).max(axis=0)
    rows = hidden[:, members] / size
    pivots: list[int] = []
    for r in range(len(rows)):
        column = int(np.argmax(np.abs(rows[r])))
        pivots.append(column)
        rows[r] /= rows[r, column]
        others = np.arange(len(rows)) != r
        rows[others] -= np.outer(rows[others, column], rows[r])
    out = []
    for j in range(len(members)):
        if j in pivots:
            continue
        w = np.zeros(len(names))
        w[members[j]] = 1.0
        w[members[pivots]] = -rows[:, j] * size[j] / size[pivots]
        w[np.abs(w) < 1e-6] = 0.0
        if np.count_nonzero(w) > 1:
            weights = {str(names[i]): float(w[i]) for i in np.flatnonzero(w)}
            out.append(Combination(weights, float(w @ values), float(np.sqrt(w @ covariance @ w))))
    return tuple(out)


def observe_with_force_noise(session: Session, terms: Sequence[Term]) -> Observation:
    """The observation of a session with the force sensor's noise carried through a first fit of the terms' springs.

    Of an absolute session rows that no model of this robot comes near are left out, with a note on the session.
    """
    first = observe(session)
    if session.kind == "absolute":
        return without_outliers(first, terms)
    if session.noise.force_n <= 0.0 or not any(t.effect.elastic for t in terms):
        return first
    springs = fit([t for t in terms if t.effect.elastic], first).terms
    return observe(session, elastic_response(springs, first.scene).compliance[:, :, :3])


def without_outliers(observation: Observation, terms: Sequence[Term]) -> Observation:
    """An observation without rows that stand out from a fit of the terms; its session's notes say what was found.

    Notes name the poses left out, and say whether the residual of the fit repeats where poses do.
    """
    kept = np.ones(len(observation.rows), dtype=bool)
    for _ in range(3):
        fitted = fit(terms, observation.only(kept))
        residual = observation.y - observation.of(total_displacement(fitted.terms, observation.scene))
        out = outlying(residual)
        if (out == ~kept).all():
            break
        kept = ~out
    again = repeating(near_pairs(observation.only(kept), residual[kept]))
    if again:
        observation = noted(observation, again)
    if kept.all():
        return observation
    named = ", ".join(map(str, observation.pose[~kept][:10].tolist())) + (", .." if (~kept).sum() > 10 else "")
    note = (
        f"{(~kept).sum()} of {len(kept)} rows are outliers "
        f"(residual {1e3 * np.linalg.norm(residual[~kept], axis=1).min():.2f} mm or more,"
        f" median {1e3 * np.median(np.linalg.norm(residual, axis=1)):.2f} mm) and left out: pose {named}"
    )
    return noted(observation.only(kept), note)


def default_terms(session: Session) -> tuple[Term, ...]:
    """What a fit starts from where no model is named: 18 DOF, or the geometric model for an absolute session."""
    return base_terms() if session.kind == "absolute" else blank_model(EIGHTEEN_DOF)


def registered(terms: Sequence[Term], observation: Observation) -> tuple[Term, ...]:
    """A model's terms with stations and markers placed for this very session and everything else as it is.

    Where the instruments stand belongs to a session, not to the robot: it is fitted anew before a model is compared with one.
    """
    if observation.session.kind != "absolute":
        return tuple(terms)
    rest = [t for t in terms if not t.effect.registers]
    placed = observation.y - observation.of(total_displacement(rest, observation.scene))
    placing = [t for t in completed((), observation)]
    if not placing:
        return tuple(rest)
    return (*fit(placing, replace(observation, y=placed)).terms, *rest)


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
    A = observation.of(np.concatenate([b for b in free_regressors(terms, scene)], axis=2)) * system.scale
    theta_0 = np.array([terms[i].estimates[p.name].value for i, p in zip(system.owner, system.parameters, strict=True)])
    x_0 = theta_0 / system.scale - system.centre
    base = observation.y - observation.of(total_displacement(terms, scene))
    residual = np.empty_like(base).reshape(-1)
    for held in pose_folds(observation, folds):
        x = solve(system, ~held)
        residual[held] = (base - A @ (x - x_0)).reshape(-1)[held]
    return residual.reshape(-1, 3)


def cross_validated_rms(terms: Sequence[Term], observation: Observation, folds: int = FOLDS) -> float:
    """sqrt(mean |r|^2) per sample over held-out poses, m; see `held_out_residual`."""
    return _rms(held_out_residual(terms, observation, folds))


def _rms(residual: Array) -> float:
    return float(np.sqrt((residual**2).sum(axis=1).mean()))


def free_regressors(terms: Sequence[Term], scene: Scene) -> list[Array]:
    """Regressors of the parameters that `linearise` keeps (those without a grid), list of (n, 3, p)."""
    out = []
    for term, block in zip(terms, regressors(terms, scene), strict=True):
        out.append(block[:, :, term.free(term.effect.parameters(scene))])
    return out


def instruments(result: Fit) -> Json:
    """Where a fit has the stations and markers that were unknowns of the session, for the model's provenance."""
    session = result.observation.session
    value = {t.effect.id: {n: e.value for n, e in t.estimates.items()} for t in result.terms if t.effect.registers}
    out: Json = {}
    for s in session.stations if "station_pose" in value else ():
        if not s.known:
            d, w = (np.array([value["station_pose"][f"{p}{a}_{s.name}"] for a in "xyz"]) for p in ("", "w_"))
            turned = Rotation.from_rotvec(w) * Rotation.from_quat(s.quat_xyzw)
            pose = {"xyz": (np.array(s.xyz) + d).tolist(), "quat_xyzw": turned.as_quat().tolist()}
            out.setdefault("stations_in_base_link", {})[s.name] = pose
    for m in session.markers if "marker_position" in value else ():
        if not m.known:
            d = np.array([value["marker_position"][f"{a}_{m.name}"] for a in "xyz"])
            out.setdefault(f"markers_in_{m.link}", {})[m.name] = (np.array(m.xyz) + d).tolist()
    return out


def _rests_on_guesses(result: Fit) -> bool:
    session = result.observation.session
    return session.kind == "absolute" and session.inertials == "guess" and any(t.effect.elastic for t in result.terms)


def model_of(result: Fit, *, cv_rms: float | None = None, parent: str = "") -> Model:
    """A model with its provenance and figures, ready to be saved."""
    session = result.observation.session
    force = np.linalg.norm(session.force_in_tool, axis=1)
    torque = np.linalg.norm(session.torque_in_tool, axis=1)
    held = held_geometry(result.terms, result.observation)
    held_out = held_out_residual(result.terms, result.observation) if cv_rms is None else None
    return Model(
        terms=result.terms,
        serial=session.serial,
        urdf=str(session.meta.get("robot", {}).get("urdf", "")),
        urdf_sha256=session.robot.sha256,
        tool=str(session.meta.get("tool", "")),
        envelope=Envelope(
            tuple(session.q.min(axis=0).tolist()), tuple(session.q.max(axis=0).tolist()), float(force.max()), float(torque.max())
        ),
        made={
            "session": session.name,
            "tool_version": __version__,
            "solver": "bounded weighted least squares, Gauss-Newton",
            "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            **({"parent": parent} if parent else {}),
            **instruments(result),
            **({"held_at_zero": [f"geometry_error.{n}" for n in held]} if held else {}),
            **({"caution": GUESSED} if _rests_on_guesses(result) else {}),
        },
        figures={
            "fit_rms_m": result.rms,
            "fit_mean_m": float(np.linalg.norm(result.residual, axis=1).mean()),
            "cv_rms_m": float(cv_rms) if held_out is None else _rms(held_out),  # type: ignore[arg-type]
            **({} if held_out is None else {"cv_mean_m": float(np.linalg.norm(held_out, axis=1).mean())}),
            "noise_floor_m": result.observation.whiten.floor,
            "rank": result.rank,
            "condition": result.condition,
            "chi2_per_dof": result.chi2 / max(result.dof, 1),
            "poses": len(result.observation.poses),
            "samples": len(result.observation.rows),
        },
        combinations=result.combinations,
    )


def identify(session: Session, terms: Sequence[Term]) -> Fit:
    """Identify a model from a session: Eq. (1)-(19).

    Raises:
        SolveError: the session can't determine it; says what is missing.
    """
    observation = observe_with_force_noise(session, terms)
    return fit(terms, observation)
