# SPDX-License-Identifier: Apache-2.0
"""Bounded Gauss-Newton with step control: a step is taken only where the true residual, not the linearised one, gets smaller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..effects import absent, follows_springs, parameters_of
from ..errors import Cancelled, SolveError
from ..model import Estimate, Term, total_displacement
from ..typing import Array
from .absolute import completed
from .observe import Observation
from .system import System, linearise, solve, with_values

MAX_ITERATIONS = 20
CONVERGED = 1e-6  # of the parameter scale
SETTLED = 1e-9  # relative fall of the loss below which nothing is gained any more
HALVINGS = 12


def fitted(
    terms: Sequence[Term],
    observation: Observation,
    *,
    prior_width: Array | None = None,
    settled: float = SETTLED,
    cancelled: Callable[[], bool] | None = None,
) -> tuple[tuple[Term, ...], bool]:
    """Fit all parameters of the terms jointly.

    Args:
        terms: effects with start values.
        observation: what was measured.
        prior_width: see `system.solve`.
        settled: relative fall of the loss below which nothing is gained any more.
        cancelled: called between iterations; returning True stops.

    Returns:
        the terms with values, whose true loss is never above that of the start, and whether the iteration converged.

    Raises:
        SolveError: an effect can't act on this session, or nothing is free.
        Cancelled: as asked for.
    """
    terms = tuple(_with_starts(t, observation) for t in completed(terms, observation))
    loss, moved, iterates = np.inf, None, False
    for _ in range(MAX_ITERATIONS):
        if cancelled is not None and cancelled():
            raise Cancelled("the fit was cancelled")
        moved = total_displacement(terms, observation.scene) if moved is None else moved
        system = linearise(terms, observation, moved)
        now = _values(terms, system)
        if not np.isfinite(loss):
            loss = _loss(moved, observation, now, prior_width)
        step = solve(system, prior_width=prior_width) - now
        if np.isfinite(loss) and _in_bounds(now, system) and _promised(system, now, step, prior_width) <= settled * loss:
            return terms, True
        taken = 1.0
        for _ in range(HALVINGS):
            x = now + taken * step
            tried = with_values(terms, system, x)
            ahead = total_displacement(tried, observation.scene)
            new = _loss(ahead, observation, x, prior_width)
            if new <= loss * (1.0 + SETTLED) or not np.isfinite(loss):
                break
            taken *= 0.5
        else:
            # the step leads nowhere: at the minimum up to rounding, or stuck where the linearisation does not hold
            return terms, bool(_promised(system, now, step, prior_width) < 1e-3 * max(loss, 1.0))
        gained, loss, terms, moved = loss - new, new, tried, ahead
        iterates = iterates or _iterates(terms, observation)
        if taken == 1.0 and not iterates:
            return terms, True
        if np.abs(taken * step).max() < CONVERGED * (1.0 + np.abs(x).max()) or gained <= settled * max(loss, 1e-30):
            return terms, True
    return terms, False


def _iterates(terms: Sequence[Term], observation: Observation) -> bool:
    if observation.scene.view.sags and any(t.effect.elastic for t in terms):
        return True  # the weight bends springs too, which is no part of the derivative
    scene = observation.scene
    return any(t.effect.acts_on == "wrench" or follows_springs(t.effect, scene) or _nonlinear(t, observation) for t in terms)


def _values(terms: Sequence[Term], system: System) -> Array:
    """Present values, scaled, counted from the system's centre."""
    at = [terms[i].estimates[p.name].value for i, p in zip(system.owner, system.parameters, strict=True)]
    return np.array(at) / system.scale - system.centre


def _loss(moved: Array, observation: Observation, x: Array, prior_width: Array | None) -> float:
    residual = observation.y - observation.of(moved)
    penalty = 0.0 if prior_width is None else float(((x / prior_width) ** 2).sum())
    return float((observation.whiten(residual) ** 2).sum()) + penalty


def _in_bounds(now: Array, system: System) -> bool:
    return bool(((now >= system.lower) & (now <= system.upper)).all())


def _promised(system: System, now: Array, step: Array, prior_width: Array | None) -> float:
    """By how much the linearised loss would fall."""
    r = system.b - system.A @ now
    ahead = system.A @ step
    gain = float(2.0 * r @ ahead - ahead @ ahead)
    if prior_width is not None:
        gain += float(((now / prior_width) ** 2).sum() - (((now + step) / prior_width) ** 2).sum())
    return gain


def _nonlinear(term: Term, observation: Observation) -> bool:
    """Whether the displacement of a term is not simply regressor times values."""
    scene = observation.scene
    theta = term.theta(parameters_of(term.effect, scene))
    on_grid = [bool(p.grid) for p in parameters_of(term.effect, scene)]
    by_regressor = term.effect.regressor(scene, theta) @ np.where(on_grid, 0.0, theta)
    return not np.allclose(by_regressor, term.effect.displacement(scene, theta), rtol=1e-9, atol=1e-12)


def _with_starts(term: Term, observation: Observation) -> Term:
    why = absent(observation.scene, term.effect.needs)
    if why:
        raise SolveError(f"effect '{term.effect.id}' can't be identified from {observation.session.name}: {why}")
    own = parameters_of(term.effect, observation.scene)
    named = [p for p in own if p.name in term.estimates] or own
    estimates = {p.name: term.estimates.get(p.name, Estimate(p.start, unit=p.unit, lower=p.lower, upper=p.upper)) for p in named}
    return replace(term, estimates=estimates)
