# SPDX-License-Identifier: Apache-2.0
"""Every way in which an effect may be present: which of its parts (axes, directions), at which shape values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import comb, log

import numpy as np

from ..effects import Effect, Parameter, known_effects
from ..effects.scene import Scene
from ..errors import EffectError, SolveError
from ..typing import Array, BoolArray
from .evidence import Block, Posterior
from .ground import Ground
from .priors import FACTORS
from .study import Study

SMALLEST_COLUMN = 1e-3  # whitened length of a column at its parameter's scale below which it can't show
FORWARD_STEPS = 3


@dataclass(frozen=True)
class Variant:
    """An effect with some of its groups at one choice of shape values.

    Attributes:
        effect, groups: which parts are present.
        shape: values of the parameters that enter nonlinearly, by name.
        names: parameters that are fitted; scale: physical value of a scaled unit, (p,).
        block: columns; log_prior: of this variant within its effect.
    """

    effect: Effect
    groups: tuple[str, ...]
    shape: dict[str, float]
    names: tuple[str, ...]
    scale: Array
    block: Block
    log_prior: float


@dataclass(frozen=True)
class Trial:
    """An effect tried on top of a model.

    Attributes:
        best: its best variant; posterior: x of its own columns, evidence of ground and effect together.
        log_evidence: averaged over the effect's variants, relative to the ground.
    """

    effect: Effect
    best: Variant
    posterior: Posterior
    log_evidence: float


@dataclass(frozen=True)
class Table:
    """All columns of an effect at one choice of its shape values.

    Attributes:
        parameters: of each column; groups: names of the parts that show.
    """

    shape: dict[str, float]
    block: Block
    parameters: tuple[Parameter, ...]

    @cached_property
    def gram(self) -> Array:
        out: Array = self.block.A.T @ self.block.A
        return out

    @cached_property
    def shows(self) -> BoolArray:
        out: BoolArray = np.sqrt(self.gram.diagonal()) > SMALLEST_COLUMN
        return out

    @cached_property
    def groups(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(p.group for p, s in zip(self.parameters, self.shows, strict=True) if s))

    @cached_property
    def _columns_of(self) -> dict[str, list[int]]:
        return {n: [i for i, p in enumerate(self.parameters) if p.group == n and self.shows[i]] for n in self.groups}

    def columns(self, chosen: Sequence[str]) -> list[int]:
        return sorted(i for n in chosen for i in self._columns_of.get(n, ()))


@dataclass(frozen=True)
class Option:
    """An effect with all its tables on one session.

    Attributes:
        by_springs: what it does goes with springs, which the start of an absolute session has none of: asked anew of each model.
    """

    effect: Effect
    tables: tuple[Table, ...]
    by_springs: bool = False

    def on(self, study: Study) -> Option:
        """The same on top of a model; without tables where it moves nothing there."""
        if not self.by_springs:
            return self
        found, _ = options(study, [self.effect])
        return replace(self, tables=found[0].tables if found else ())


def options(
    study: Study, effects: Sequence[Effect] | None = None, check: Callable[[], None] = lambda: None
) -> tuple[list[Option], dict[str, str]]:
    """Every effect that the model does not have with its columns, and why others can't show."""
    present = {t.effect.id for t in study.terms}
    found: list[Option] = []
    skipped: dict[str, str] = {}
    for effect in known_effects().values() if effects is None else effects:
        check()
        if effect.id in present or (effects is None and (effect.completes or effect.stands_in)):
            continue
        why = study.why_not(effect)
        try:
            tables = () if why else tuple(Table(s, b, tuple(p)) for s, b, p in _parts(study, effect))
        except (EffectError, SolveError) as error:
            tables, why = (), str(error)
        tables = tuple(t for t in tables if t.groups)
        by_springs = study.ready.kind == "absolute" and effect.loads_arm and not why
        if tables or by_springs:
            found.append(Option(effect, tables, by_springs))
        else:
            skipped[effect.id] = why or "it moves nothing in this session"
    return found, skipped


def _parts(study: Study, effect: Effect) -> Iterator[tuple[dict[str, float], Block, list[Parameter]]]:
    """All columns of an effect for each choice of its shape values: shape, block, parameters."""
    shaped = [p for p in effect.parameters(study.ready) if p.grid]
    for values in product(*(p.grid for p in shaped)):
        shape = {p.name: v for p, v in zip(shaped, values, strict=True)}
        yield shape, *block_columns(study, effect, shape)


def block_columns(study: Study, effect: Effect, shape: dict[str, float]) -> tuple[Block, list[Parameter]]:
    """All columns of an effect at given values of its shape, and the parameter of each."""
    parameters = effect.parameters(study.ready)
    free = [i for i, p in enumerate(parameters) if not p.grid]
    theta = np.array([shape.get(p.name, 0.0) for p in parameters])
    chosen = [parameters[i] for i in free]
    scale = np.array([p.scale for p in chosen])
    A = _beside_springs(study, study.columns(study.regressor(effect, theta)[:, :, free] * scale), chosen)
    reached = effect.reached(study.ready, theta)
    if reached is not None:
        A[:, ~reached[free]] = 0.0
    width = np.array([p.prior_width for p in chosen])
    lower = np.array([p.lower for p in chosen]) / scale
    upper = np.array([p.upper for p in chosen]) / scale
    return Block(A, lower, upper, width), chosen


def block_at(study: Study, variant: Variant, shape: dict[str, float]) -> Block:
    """The columns of a variant at other shape values."""
    parameters = variant.effect.parameters(study.ready)
    theta = np.array([shape.get(p.name, 0.0) for p in parameters])
    chosen = [i for i, p in enumerate(parameters) if p.name in variant.names]
    A = study.columns(study.regressor(variant.effect, theta)[:, :, chosen] * variant.scale)
    return replace(variant.block, A=_beside_springs(study, A, [parameters[i] for i in chosen]))


def _beside_springs(study: Study, A: Array, parameters: Sequence[Parameter]) -> Array:
    """Columns of an effect where compliances from which it takes something away (`Parameter.takes_from`) grow by as much.

    The prior of such a compliance is meant for the loaded axis, which is then as soft with the effect as without.
    """
    springs = {p.name: j for j, p in enumerate(study.parameters)}
    out = A
    for i, p in enumerate(parameters):
        j = springs.get(p.takes_from)
        if j is not None:
            out = A.copy() if out is A else out
            out[:, i] -= study.base.A[:, j] * (p.scale / study.scale[j])
    return out


@dataclass(frozen=True)
class _Tried:
    """Some groups of one table of an option: the table's number, its columns, how likely it is beforehand, and the posterior."""

    table: int
    groups: tuple[str, ...]
    columns: list[int]
    log_prior: float
    posterior: Posterior

    @property
    def score(self) -> float:
        return self.posterior.log_evidence + self.log_prior


_Set = tuple[int, tuple[str, ...]]  # place of a table, groups of it


def try_option(ground: Ground, option: Option, scene: Scene) -> Trial:
    """Try an effect in all its variants on a ground."""
    effect, alone = option.effect, ground.log_evidence
    log_odds = effect.log_odds(scene)
    reduced = ground.reduced_tables([t.block for t in option.tables], [t.gram for t in option.tables])

    def variants(sets: Sequence[_Set]) -> list[_Tried]:
        chosen = [(i, option.tables[i].columns(groups)) for i, groups in sets]
        out = []
        for (i, groups), (_, columns), posterior in zip(sets, chosen, ground.posteriors(reduced, chosen, FACTORS), strict=True):
            of = len(option.tables[i].groups)
            prior = log_odds + effect.log_odds_of(groups) - log(of * comb(of, len(groups)) * len(option.tables))
            out.append(_Tried(i, groups, columns, prior, posterior))
        return out

    names = [t.groups for t in option.tables]
    tried = variants([(i, (n,)) for i, of in enumerate(names) for n in of])
    tried += _forward(variants, names, tried) + variants([(i, of) for i, of in enumerate(names) if len(of) > 1])
    posteriors = [t.posterior for t in tried]
    saved = ground.bench.saved_each(ground.chi2, np.array([p.chi2 for p in posteriors]))
    gained = [supported(p.log_evidence - alone, s) for p, s in zip(posteriors, saved, strict=True)]
    score = np.array([alone + g + t.log_prior for g, t in zip(gained, tried, strict=True)])
    best = int(np.argmax(score))
    total = float(score[best] + np.log(np.exp(score - score[best]).sum()))
    return Trial(effect, _variant(option, tried[best]), tried[best].posterior, total - alone)


def _variant(option: Option, tried: _Tried) -> Variant:
    table, chosen = option.tables[tried.table], [option.tables[tried.table].parameters[j] for j in tried.columns]
    return Variant(
        option.effect, tried.groups, table.shape, tuple(p.name for p in chosen), np.array([p.scale for p in chosen]),
        table.block.take(tried.columns).widened(tried.posterior.factor), tried.log_prior,
    )  # fmt: skip


def try_effect(study: Study, effect: Effect, check: Callable[[], None] = lambda: None) -> Trial | None:
    """Try one effect on top of a model; None where none of its columns shows in this session."""
    found, _ = options(study, [effect], check)
    shows = found and found[0].tables
    return try_option(Ground(study.bench, study.base), found[0], study.ready) if shows else None


def supported(log_evidence: float, saved: float) -> float:
    """Evidence that the data bear out: without a fall of the residual, evidence only means that a prior was relieved.

    Args:
        saved: by the fall of the residual (`Bench.saved`).
    """
    return min(log_evidence, max(saved, 0.0))


def _forward(
    variants: Callable[[Sequence[_Set]], list[_Tried]], names: Sequence[tuple[str, ...]], singles: Sequence[_Tried]
) -> list[_Tried]:
    """Sets of groups of each table built up one by one, as long as the evidence rises."""
    out: list[_Tried] = []
    best: dict[int, _Tried] = {}
    for one in singles:
        if one.table not in best or one.score > best[one.table].score:
            best[one.table] = one
    going = [i for i, of in enumerate(names) if len(of) > 2]
    for step in range(FORWARD_STEPS):
        sets: list[_Set] = [
            (i, tuple(n for n in names[i] if n in best[i].groups or n == extra))
            for i in going
            if step < len(names[i]) - 2
            for extra in names[i]
            if extra not in best[i].groups
        ]
        more = variants(sets)
        out += more
        top: dict[int, _Tried] = {}
        for one in more:
            if one.table not in top or one.score > top[one.table].score:
                top[one.table] = one
        going = [i for i, one in top.items() if one.score > best[i].score]
        best |= {i: top[i] for i in going}
        if not going:
            break
    return out
