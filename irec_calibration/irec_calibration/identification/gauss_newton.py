# SPDX-License-Identifier: Apache-2.0
"""Bounded Gauss-Newton with step control: a step is taken only where the true residual, not the linearised one, gets smaller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import absent, follows_springs, parameters_of
from ..errors import Cancelled, SolveError
from ..model import Estimate, Term, total_displacement
from ..typing import Array
from .absolute import completed
from .observe import Observation
from .system import System, linearise, moved_to, solve, values_of, with_values

MAX_DERIVATIVES = 20  # of the displacement, each of which costs several times as much as the displacement itself
MAX_STEPS = 60
CONVERGED = 1e-6  # of the parameter scale
SETTLED = 1e-9  # relative fall of the loss below which nothing is gained any more
HALVINGS = 12
TRUSTED = 0.5  # of the fall of the loss that a derivative promised and that must have come for it to be used once more


@dataclass(frozen=True)
class Minimum:
    """Where a fit ended.

    Attributes:
        terms: with values, whose true loss is never above that of the start.
        converged: whether the iteration reached a minimum of the true loss.
        moved: displacement by them in each row of the session, (n, 3), m.
        system: the equations linearised about them; None where they were not needed there.
    """

    terms: tuple[Term, ...]
    converged: bool
    moved: Array
    system: System | None = None

    def linearised(self, observation: Observation) -> System:
        """The equations about the terms, for the observation that was fitted."""
        return linearise(self.terms, observation, self.moved) if self.system is None else self.system


def fitted(
    terms: Sequence[Term],
    observation: Observation,
    *,
    prior_width: Array | None = None,
    settled: float = SETTLED,
    start: Minimum | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Minimum:
    """Fit all parameters of the terms jointly.

    A derivative is used for further steps as long as the loss falls about as it promises; whether a minimum was reached is
    judged by the derivative there.

    Args:
        terms: effects with start values.
        observation: what was measured.
        prior_width: see `system.solve`.
        settled: relative fall of the loss below which nothing is gained any more.
        start: where another fit of these terms to this observation ended, with other priors: used instead of the terms.
        cancelled: called between iterations; returning True stops.

    Raises:
        SolveError: an effect can't act on this session, or nothing is free.
        Cancelled: as asked for.
    """
    if start is None:
        terms = tuple(_with_starts(t, observation) for t in completed(terms, observation))
        moved, system = total_displacement(terms, observation.scene), None
    else:
        terms, moved, system = start.terms, start.moved, start.system
    loss, iterates, derivatives, is_here = np.inf, False, 0, system is not None
    for _ in range(MAX_STEPS):
        if cancelled is not None and cancelled():
            raise Cancelled("the fit was cancelled")
        if system is None:
            if derivatives == MAX_DERIVATIVES:
                break
            system, is_here, derivatives = linearise(terms, observation, moved), True, derivatives + 1
        elif not is_here:
            system = moved_to(system, terms, observation, moved)
        now = values_of(terms, system)
        if not np.isfinite(loss):
            loss = _loss(moved, observation, now, prior_width)
        step = solve(system, prior_width=prior_width) - now
        promised = _promised(system, now, step, prior_width)
        if np.isfinite(loss) and _in_bounds(now, system) and promised <= settled * loss:
            if is_here:
                return Minimum(terms, True, moved, system)
            system = None
            continue
        taken = 1.0
        for _ in range(HALVINGS if is_here else 1):
            x = now + taken * step
            tried = with_values(terms, system, x)
            ahead = total_displacement(tried, observation.scene)
            new = _loss(ahead, observation, x, prior_width)
            if new <= loss * (1.0 + SETTLED) or not np.isfinite(loss):
                break
            taken *= 0.5
        else:
            if is_here:
                # the step leads nowhere: at the minimum up to rounding, or stuck where the linearisation does not hold
                return Minimum(terms, bool(promised < 1e-3 * max(loss, 1.0)), moved, system)
            system = None
            continue
        gained, loss, terms, moved = loss - new, new, tried, ahead
        iterates = iterates or _iterates(terms, observation)
        if taken == 1.0 and not iterates:
            return Minimum(terms, True, moved)
        small = np.abs(taken * step).max() < CONVERGED * (1.0 + np.abs(x).max()) or gained <= settled * max(loss, 1e-30)
        if small and is_here:
            return Minimum(terms, True, moved)
        is_here = False
        if small or taken < 1.0 or not gained >= TRUSTED * promised:
            system = None
    return Minimum(terms, False, moved)


def _iterates(terms: Sequence[Term], observation: Observation) -> bool:
    if observation.scene.view.sags and any(t.effect.elastic for t in terms):
        return True  # the weight bends springs too, which is no part of the derivative
    scene = observation.scene
    return any(t.effect.acts_on == "wrench" or follows_springs(t.effect, scene) or _nonlinear(t, observation) for t in terms)


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
