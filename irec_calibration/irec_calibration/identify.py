# SPDX-License-Identifier: Apache-2.0
"""Identification of any list of effects from a session: Eq. (1)-(19).

The observation system is in `system`, what it tells about each parameter in `identifiability`, the model made of a fit in
`provenance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .absolute import base_terms, completed, near_pairs, noted, outlying, repeating
from .cross_validation import rms
from .effects import absent
from .errors import Cancelled, SolveError
from .identifiability import identifiability
from .model import EIGHTEEN_DOF, Combination, Estimate, Term, blank_model, elastic_response, total_displacement
from .observe import Observation, observe
from .session.data import Session
from .system import System, linearise, solve, with_values
from .typing import Array, BoolArray

MAX_ITERATIONS = 8
CONVERGED = 1e-6  # of the parameter scale


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


def identify(session: Session, terms: Sequence[Term]) -> Fit:
    """Identify a model from a session: Eq. (1)-(19).

    Raises:
        SolveError: the session can't determine it; says what is missing.
    """
    observation = observe_with_force_noise(session, terms)
    return fit(terms, observation)


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
    estimates = {p.name: term.estimates.get(p.name, Estimate(p.start, unit=p.unit, lower=p.lower, upper=p.upper)) for p in named}
    return replace(term, estimates=estimates)


def _describe(terms: tuple[Term, ...], observation: Observation) -> Fit:
    system = linearise(terms, observation)
    residual = observation.y - observation.of(total_displacement(terms, observation.scene))
    chi2 = float((observation.whiten(residual) ** 2).sum())
    named = list(zip(system.owner, system.parameters, strict=True))
    values = np.array([terms[i].estimates[p.name].value for i, p in named])
    told = identifiability(system, [f"{terms[i].effect.id}.{p.name}" for i, p in named], values)
    dof = residual.size - told.rank
    # an absolute session's residual holds what the robot does besides: errors that only the data sheet backs would be too small
    excess = max(1.0, float(np.sqrt(chi2 / max(dof, 1)))) if observation.session.kind == "absolute" else 1.0
    return Fit(
        terms=_with_errors(terms, system, excess * told.se, told.alone),
        observation=observation,
        residual=residual,
        rms=rms(residual),
        chi2=chi2,
        dof=dof,
        rank=told.rank,
        condition=told.condition,
        combinations=tuple(replace(c, se=excess * c.se) for c in told.combinations),
    )


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
