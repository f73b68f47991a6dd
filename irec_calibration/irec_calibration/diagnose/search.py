# SPDX-License-Identifier: Apache-2.0
"""Which effects on top of a model explain a session: all singly, the best refitted exactly, then pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import log

import numpy as np
from scipy.optimize import minimize_scalar

from ..effects import Effect, known_effects
from ..errors import EffectError, SolveError
from ..model import Estimate, Term
from .candidates import Trial, block_at, supported, try_effect
from .priors import FACTORS
from .study import Study, study_of

NATS_TO_NAME = 6.5  # log evidence over the simpler model that a name needs: odds of 600 before the number of effects is counted
NATS_TO_SEPARATE = 5.0  # less than this between two explanations: they can't be told apart
NATS_TO_REFIT = 15.0  # rivals this close to the best, or within a tenth of its evidence, are refitted exactly
REFITTED_AT_MOST = 4
PAIRED_AT_MOST = 2
CHI2_SIGMAS_TO_PAIR = 0.5  # a second effect is looked for where chi2 lies further above its expectation
BASE_EFFECTS = ("joint_torsion", "link_bending")


@dataclass(frozen=True)
class Hypothesis:
    """A model with effects added, fitted exactly.

    Attributes:
        added: the terms added to the model, in order of addition.
        log_evidence: relative to the model alone.
    """

    added: tuple[Term, ...]
    study: Study
    log_evidence: float

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(t.effect.id for t in self.added)


@dataclass(frozen=True)
class Search:
    """Outcome of a search.

    Attributes:
        trials: every effect that could be tried, best first.
        skipped: effect id -> why it can't show.
        singles, pairs: exact fits, best first.
    """

    study: Study
    trials: tuple[Trial, ...]
    skipped: dict[str, str]
    singles: tuple[Hypothesis, ...]
    pairs: tuple[Hypothesis, ...]


def try_all(
    study: Study, effects: Sequence[Effect] | None = None, check: Callable[[], None] = lambda: None
) -> tuple[list[Trial], dict[str, str]]:
    """Every effect that the model does not have, on top of it: trials (best first) and why others were skipped."""
    present = {t.effect.id for t in study.terms}
    trials, skipped = [], {}
    for effect in known_effects().values() if effects is None else effects:
        if effect.id in present:
            continue
        why = study.why_not(effect)
        try:
            trial = None if why else try_effect(study, effect, check)
        except (EffectError, SolveError) as error:
            trial, why = None, str(error)
        if trial is None:
            skipped[effect.id] = why or "it moves nothing in this session"
        else:
            trials.append(trial)
    return sorted(trials, key=lambda t: -t.log_evidence), skipped


def refit(study: Study, base: Study, trial: Trial) -> Hypothesis | None:
    """The model of `study` with a tried effect, fitted exactly, with its shape values refined; None where the fit fails."""
    variant = trial.best

    shape = _refined(study, trial)
    known = dict(zip(variant.names, trial.posterior.x[-len(variant.names) :] * variant.scale, strict=True)) | shape
    estimates = {
        p.name: Estimate(float(np.clip(known[p.name], p.lower, p.upper)), unit=p.unit, lower=p.lower, upper=p.upper)
        for p in variant.effect.parameters(study.ready)
        if p.name in known
    }
    try:
        found = study_of(study.observation, (*study.terms, Term(variant.effect, estimates)))
    except SolveError:
        return None
    added = len(found.terms) - len(base.terms)
    saved = base.bench.posterior(base.base).chi2 - found.bench.posterior(found.base).chi2
    evidence = supported(_evidence(found, added) - _evidence(base, 0), saved) + variant.log_prior
    return Hypothesis(found.terms[len(base.terms) :], found, evidence)


def _evidence(study: Study, effects: int) -> float:
    return study.bench.posterior(study.base).log_evidence - effects * log(len(FACTORS))


def _refined(study: Study, trial: Trial) -> dict[str, float]:
    """The shape values of a trial; a continuous one is moved between its grid neighbours to where the evidence is best."""
    shape = dict(trial.best.shape)
    for p in trial.effect.parameters(study.ready):
        grid = sorted(p.grid)
        if p.name not in shape or len(grid) < 3 or len(grid) > 20 or grid[0] <= 0.0:
            continue
        i = grid.index(shape[p.name])
        low = grid[i - 1] if i else grid[0] ** 2 / grid[1]
        high = grid[i + 1] if i + 1 < len(grid) else grid[-1] ** 2 / grid[-2]
        low, high = max(low, p.lower), min(high, p.upper)

        def loss(u: float, name: str = p.name) -> float:
            block = block_at(study, trial.best, shape | {name: float(np.exp(u))})
            return -study.bench.posterior(study.base + block).log_evidence

        bounds = (np.log(low), np.log(high))
        found = minimize_scalar(loss, bounds=bounds, method="bounded", options={"maxiter": 10, "xatol": 0.02})
        shape[p.name] = float(np.exp(found.x))
    return shape


def chi2_and_expectation(study: Study) -> tuple[float, float]:
    """Squared residual of a fitted model, and its expectation under noise alone."""
    posterior = study.bench.posterior(study.base)
    G = study.base.A.T @ study.base.A
    free = (posterior.x > study.base.lower) & (posterior.x < study.base.upper)
    F = G[np.ix_(free, free)]
    shrunk = np.linalg.lstsq(F + np.diag(1.0 / study.base.width[free] ** 2), F, rcond=None)[0]
    return posterior.chi2, max(len(study.bench.b) - float(np.trace(shrunk)), 1.0)


def excess(study: Study) -> float:
    """By how many standard deviations chi2 lies above its expectation."""
    chi2, dof = chi2_and_expectation(study)
    return float((chi2 - dof) / np.sqrt(2.0 * dof))


def search(study: Study, check: Callable[[], None] = lambda: None) -> Search:
    """Try all effects, refit the best ones, and try second effects on top of them."""
    trials, skipped = try_all(study, check=check)
    singles: list[Hypothesis] = []
    if trials:
        least = trials[0].log_evidence - max(NATS_TO_REFIT, 0.1 * trials[0].log_evidence)
        near = [t for t in trials if t.log_evidence > max(1.0, least)][:REFITTED_AT_MOST]
        for trial in near:
            check()
            found = refit(study, study, trial)
            if found is not None:
                singles.append(replace(found, log_evidence=max(found.log_evidence, trial.log_evidence)))
    singles.sort(key=lambda h: -h.log_evidence)
    pairs: list[Hypothesis] = []
    leave_something = bool(singles) and excess(singles[0].study) > CHI2_SIGMAS_TO_PAIR
    for single in [h for h in singles if h.log_evidence > NATS_TO_NAME][: PAIRED_AT_MOST if leave_something else 0]:
        seconds, _ = try_all(single.study, check=check)
        for trial in [t for t in seconds[:2] if t.log_evidence > NATS_TO_NAME]:
            check()
            both = refit(single.study, study, trial)
            if both is not None:
                pairs.append(replace(both, log_evidence=max(both.log_evidence, single.log_evidence + trial.log_evidence)))
    pairs.sort(key=lambda h: -h.log_evidence)
    return Search(study, tuple(trials), skipped, tuple(singles), tuple(pairs))
