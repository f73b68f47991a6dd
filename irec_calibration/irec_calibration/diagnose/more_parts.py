# SPDX-License-Identifier: Apache-2.0
"""Further parts (axes, directions) of effects that a model has already.

Which parts an effect has is chosen when it comes in, while other causes are still missing. What a part does that shows only
beside these would ask for another effect: a further joint that stands elsewhere, for an encoder that errs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import comb, log

from ..errors import SolveError
from ..model import Estimate, Term
from .candidates import Table
from .columns import block_columns
from .explanation import Explanation, borne_out, in_one_pose, remainder_of
from .family import Family
from .ground import Ground
from .priors import FACTORS
from .rivals import Check
from .settings import Settings
from .shape import estimate_at
from .study import study_of


@dataclass(frozen=True)
class _Part:
    """A part that an effect of a model does not have.

    Attributes:
        term: the effect; values: of the part's parameters, about; log_prior: of that set of parts over the one without it.
        gained: log evidence about the model, with that.
    """

    term: Term
    values: dict[str, Estimate]
    log_prior: float
    gained: float


def with_more_parts(one: Explanation, family: Family, check: Check, settings: Settings) -> Explanation:
    """A model whose effects have the further parts that it needs as plainly as it would need a name.

    A part has to explain more than structure that has no name does in its place.
    """
    while True:
        check()
        best = max(_parts(one), key=lambda p: p.gained, default=None)
        if best is None or best.gained < settings.nats_to_name:
            return one
        wider = _with(one, best, family)
        if wider is None or wider.named - one.named < settings.nats_to_name:
            return one
        if wider.log_evidence - one.log_evidence < settings.nats_over_structure:
            return one
        one = wider


def _parts(one: Explanation) -> Iterator[_Part]:
    study = one.study
    ground = Ground(study.bench, study.base)
    for term in one.added:
        if in_one_pose(one, term.effect.id):
            continue
        own = term.effect.parameters(study.ready)
        by_themselves = {p.group for p in own} - {p.shapes or p.group for p in own if p.shapes or p.refines}
        shape = {p.name: term.estimates[p.name].value for p in own if p.grid and p.name in term.estimates}
        there = {p.group for p in own if not p.grid and p.name in term.estimates}
        if by_themselves <= there or any(p.grid and p.name not in shape for p in own if not p.shapes):
            continue
        block, parameters = block_columns(study, term.effect, shape)
        table = Table(shape, block, tuple(parameters))
        absent = [g for g in table.groups if g in by_themselves - there]
        sets = [(0, table.columns([g])) for g in absent]
        found = ground.posteriors(ground.reduced_tables([block], [table.gram]), sets, FACTORS) if sets else []
        of, k = len(table.groups), len(there & {*table.groups})
        log_prior = log(comb(of, k)) - log(comb(of, k + 1)) if absent else 0.0
        for (_, columns), posterior in zip(sets, found, strict=True):
            names = [parameters[j] for j in columns]
            values = {p.name: estimate_at(p, float(x) * p.scale) for p, x in zip(names, posterior.x, strict=True)}
            yield _Part(term, values, log_prior, posterior.log_evidence - ground.log_evidence + log_prior)


def _with(one: Explanation, part: _Part, family: Family) -> Explanation | None:
    """The model with a part, fitted exactly; None where the fit fails."""
    study = one.study
    wider = replace(part.term, estimates=part.term.estimates | part.values)
    try:
        fitted = study_of(study.observation, tuple(wider if t is part.term else t for t in study.terms))
    except SolveError:
        return None
    added = fitted.terms[len(study.terms) - len(one.added) :]
    rest = remainder_of(fitted, family, one.remainder.parts)
    return Explanation(added, fitted, one.named + borne_out(study, fitted) + part.log_prior, rest)
