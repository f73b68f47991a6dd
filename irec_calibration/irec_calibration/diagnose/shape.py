# SPDX-License-Identifier: Apache-2.0
"""Shape values of effects, which enter nonlinearly: moved to where the evidence is best, alone and beside other causes."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from ..effects import Axes, Parameter
from ..errors import SolveError
from ..model import Estimate, Term
from .candidates import Trial, block_at
from .columns import block_columns
from .ground import Ground
from .places import place_beside
from .study import Study, study_of

ROUNDS = 4  # of searches for all shape values of an effect, one after the other
STEPS = 10  # of a search for one shape value
PRECISION = 0.02  # of the range searched
WORTH_MOVING = 0.5  # nats; what a shape found at another place must gain
WIDER = 2.5  # times the value before, either way, in which a shape value is looked for again beside other causes


def refit(study: Study, trial: Trial) -> Study | None:
    """A model with a tried effect, fitted exactly, with its shape values refined; None where the fit fails.

    A force on the arm of an absolute session is looked for from typical springs too, where the model has nearly none: the better
    fit is taken.
    """
    variant = trial.best
    shape = _refined(study, trial)
    known = dict(zip(variant.names, trial.posterior.x * variant.scale, strict=True)) | shape
    estimates = {
        p.name: estimate_at(p, known[p.name])
        for p in variant.effect.parameters(study.ready)
        if p.name in known
    }
    starts = [(study.terms, estimates)]
    if variant.effect.loads_arm and study.ready.kind == "absolute":  # it shows springs that the weight doesn't
        free = tuple(t.whole(t.effect.parameters(study.ready)) if t.effect.elastic else t for t in study.terms)
        starts = [(free, estimates)]
        if any(_nearly_none(t, study) for t in free):  # from there a fit may miss a force that bends them by more than the weight
            by_none = {n: replace(e, value=0.0) if n not in shape else e for n, e in estimates.items()}
            starts.append((tuple(_typical(t, study) for t in free), by_none))
    fitted = []
    for terms, values in starts:
        try:
            fitted.append(study_of(study.observation, (*terms, Term(variant.effect, values))))
        except SolveError:
            continue
    best = max(fitted, key=lambda s: s.bench.posterior(s.base).log_evidence, default=None)
    # where something is tied was found beside springs that it was missing in
    placed = best is not None and any(p.shapes and p.name in shape for p in variant.effect.parameters(study.ready))
    return reshaped(best, (variant.effect.id,)) if best is not None and placed else best


def estimate_at(p: Parameter, value: float) -> Estimate:
    """A parameter at a value, or at the bound before it."""
    return Estimate(float(np.clip(value, p.lower, p.upper)), unit=p.unit, lower=p.lower, upper=p.upper)


def _nearly_none(term: Term, study: Study) -> bool:
    """Whether most springs of the axes are far stiffer than drives like them are."""
    if term.effect.compliance_of is not Axes.ACTUATED:
        return False
    scale = {p.name: p.scale for p in term.effect.parameters(study.ready)}
    stiff = [e.value < 0.01 * scale[n] for n, e in term.estimates.items()]
    return 2 * sum(stiff) > len(stiff)


def _typical(term: Term, study: Study) -> Term:
    """A term whose springs of the axes are as soft as drives like them are, where they were found stiffer."""
    if term.effect.compliance_of is not Axes.ACTUATED:
        return term
    scale = {p.name: p.scale for p in term.effect.parameters(study.ready)}
    return Term(term.effect, {n: replace(e, value=max(e.value, scale[n])) for n, e in term.estimates.items()})


def _refined(study: Study, trial: Trial) -> dict[str, float]:
    """The shape values of a trial; a continuous one is moved between its grid neighbours to where the evidence is best."""
    shape = trial.effect.same_shape(study.ready, trial.best.shape)
    ground = Ground(study.bench, study.base)

    def loss(values: dict[str, float]) -> float:
        return -ground.posterior(block_at(study, trial.best, values), np.ones(1)).log_evidence

    moved = [p for p in trial.effect.parameters(study.ready) if p.name in shape and _is_continuous(p)]
    moved = [p for p in moved if shape[p.name] > 0.0 or min(p.grid) <= 0.0]  # the least length of a hose has no logarithm
    between = {p.name: _neighbours(p, shape[p.name]) for p in moved}
    before = np.inf
    for _ in range(ROUNDS if len(moved) > 1 else 1):  # where they depend on each other, one is right only beside the other
        for p in moved:
            _, back = _scale_of(p)
            shape[p.name] = _least(lambda v, n=p.name: loss(shape | {n: v}), p, *between[p.name], back)  # type: ignore[misc]
        now = loss(shape)
        if now > before - WORTH_MOVING:
            break
        before = now
    return shape


def _neighbours(p: Parameter, value: float) -> tuple[float, float]:
    """How far a value may be moved, on the scale that it is moved on: as far as the grid's neighbours of the nearest one are."""
    there, _ = _scale_of(p)
    grid, at = [float(there(v)) for v in sorted(p.grid)], float(there(value))
    i = int(np.argmin(np.abs(np.array(grid) - at)))
    low = grid[i - 1] if i else 2.0 * grid[0] - grid[1]
    high = grid[i + 1] if i + 1 < len(grid) else 2.0 * grid[-1] - grid[-2]
    return at + low - grid[i], at + high - grid[i]


def reshaped(study: Study, effects: Collection[str]) -> Study:
    """A fitted model with the continuous shape values of some of its effects moved to where the evidence is best now.

    A shape that was found while other causes were missing may have taken up what is theirs.
    """
    for effect_id in effects:
        term = next((t for t in study.terms if t.effect.id == effect_id), None)
        values = {} if term is None else _moved_shape(study, term)
        if term is None or not values:
            continue
        moved = Term(term.effect, {n: replace(e, value=values.get(n, e.value)) for n, e in term.estimates.items()})
        try:
            other = study_of(study.observation, tuple(moved if t is term else t for t in study.terms))
        except SolveError:
            continue
        if other.bench.posterior(other.base).log_evidence > study.bench.posterior(study.base).log_evidence:
            study = other
    return study


def _moved_shape(study: Study, term: Term) -> dict[str, float]:
    """Shape values of a term of a fitted model that are better than its own; empty where there are none."""
    own = [p for p in term.effect.parameters(study.ready) if p.name in term.estimates and p.grid]
    mine = [i for i, owner in enumerate(study.owners) if owner == term.effect.id]
    ground = Ground(study.bench, study.base.take([i for i, owner in enumerate(study.owners) if owner != term.effect.id]))
    block, names = study.base.take(mine), {study.parameters[i].name for i in mine}
    values = {p.name: term.estimates[p.name].value for p in own}
    better = place_beside(study, term.effect, values)
    for p in own:
        if not _is_continuous(p) or p.shapes:
            continue

        def loss(v: float, name: str = p.name) -> float:
            table, parameters = block_columns(study, term.effect, values | better | {name: v})
            chosen = [i for i, q in enumerate(parameters) if q.name in names]
            return -ground.posterior(replace(block, A=table.A[:, chosen]), np.ones(1)).log_evidence

        there, back = _scale_of(p)
        at = there(values[p.name])
        reach = float(np.log(WIDER)) if min(p.grid) > 0.0 else 0.5 * float(np.diff(sorted(p.grid)).mean())
        found = _least(loss, p, at - reach, at + reach, back)
        if loss(found) < loss(values[p.name]) - WORTH_MOVING:
            better[p.name] = found
    return better


def _is_continuous(p: Parameter) -> bool:
    return 3 <= len(p.grid) <= 20 and not p.kinds


def _scale_of(p: Parameter) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """To and from the scale that a shape value is moved on."""
    return (lambda v: float(np.log(v)), lambda u: float(np.exp(u))) if min(p.grid) > 0.0 else (float, float)


def _least(loss: Callable[[float], float], p: Parameter, low: float, high: float, back: Callable[[float], float]) -> float:
    """The value of a shape parameter with the least loss between two places on its scale."""

    def value(u: float) -> float:
        return float(np.clip(back(u), p.lower, p.upper))

    found = minimize_scalar(
        lambda u: loss(value(u)), bounds=(low, high), method="bounded",
        options={"maxiter": STEPS, "xatol": PRECISION * (high - low)},
    )  # fmt: skip
    return value(float(found.x))
