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
from ..effects.traits import Family
from ..errors import EffectError, SolveError
from ..typing import Array, BoolArray
from .columns import beside_springs, block_columns
from .evidence import Block, Posterior
from .ground import Ground
from .places import Places, places_of
from .priors import FACTORS
from .study import Study

SMALLEST_COLUMN = 1e-3  # whitened length of a column at its parameter's scale below which it can't show
FORWARD_STEPS = 3
CARRIED_OTHERWISE = 0.02  # of what a gear carries, RMS; chosen: what less does to a law is as small as what linear problems leave


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
        place: group that is at its place (`Parameter.shapes`) here, and without which nothing is asked of this table; in a table
            without one, empty, no such group shows. log_prior: of that place.
    """

    shape: dict[str, float]
    block: Block
    parameters: tuple[Parameter, ...]
    place: str = ""
    log_prior: float = 0.0

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
        places: of groups that have one.
        carried: what gears carry by the model that the tables of a law of torque are of, (n, k), N m; None for other effects.
    """

    effect: Effect
    tables: tuple[Table, ...]
    by_springs: bool = False
    places: tuple[Places, ...] = ()
    carried: Array | None = None

    def placed(self, ground: Ground) -> tuple[Table, ...]:
        """The tables, with those of groups that have a place where it is best on a ground."""
        more = []
        for of in self.places:
            place, log_prior = of.best(ground)
            for table in self.tables:
                block, parameters = block_columns(of.study, self.effect, table.shape | place)
                _leave(block, parameters, _at_no_place(self.effect.parameters(of.study.ready)) - {of.group})
                more.append(Table(table.shape | place, block, tuple(parameters), of.group, log_prior))
        return *self.tables, *more

    def on(self, study: Study) -> Option:
        """The same on top of a model; without tables where it moves nothing there.

        Laws of torque are asked anew of a model by which gears carry something else: beside a hose play is crossed elsewhere.
        """
        if not self.by_springs and (self.carried is None or not _differs(_carried(study), self.carried)):
            return self
        if self.effect.id not in study.tables:
            found, _ = options(study, [self.effect])
            study.tables[self.effect.id] = found[0] if found else replace(self, tables=(), places=())
        return study.tables[self.effect.id]


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
        why = study.why_not(effect) or effect.not_told(study.ready)
        try:
            tables = () if why else tuple(_tables(study, effect))
            places = () if why else places_of(study, effect)
        except (EffectError, SolveError) as error:
            tables, places, why = (), (), str(error)
        tables = tuple(t for t in tables if t.groups)
        by_springs = study.ready.kind == "absolute" and effect.loads_arm and not why
        if tables or by_springs:
            carried = _carried(study) if effect.family is Family.TORQUE_LAW else None
            found.append(Option(effect, tables, by_springs, places, carried))
        else:
            skipped[effect.id] = why or "it moves nothing in this session"
    return found, skipped


def _tables(study: Study, effect: Effect) -> Iterator[Table]:
    """All columns of an effect for each choice of its shape values, none of groups that have a place of their own or refine."""
    own = effect.parameters(study.ready)
    shaped, left = [p for p in own if p.grid and not p.shapes], _at_no_place(own)
    for values in product(*(p.grid for p in shaped)):
        shape = {p.name: v for p, v in zip(shaped, values, strict=True)}
        block, parameters = block_columns(study, effect, shape)
        _leave(block, parameters, left)
        yield Table(shape, block, tuple(parameters))


def _carried(study: Study) -> Array:
    """What gears carry by a model, weight included, (n, k), N m."""
    return study.ready.tau_acting + study.ready.tau_gravity


def _differs(carried: Array, before: Array) -> bool:
    """Whether any gear carries something else than before, by enough for a law of its torque to look otherwise."""
    change, size = np.sqrt(np.mean((carried - before) ** 2, axis=0)), np.sqrt(np.mean(carried**2, axis=0))
    return bool(np.any(change > CARRIED_OTHERWISE * size))


def _at_no_place(own: Sequence[Parameter]) -> set[str]:
    """Groups of an effect that have a place of their own, or refine others."""
    return {p.shapes or p.group for p in own if p.shapes or p.refines}


def _leave(block: Block, parameters: Sequence[Parameter], groups: set[str]) -> None:
    """Groups that have a place, at none, and those that refine others show in no table."""
    if groups:
        block.A[:, [p.group in groups for p in parameters]] = 0.0


def block_at(study: Study, variant: Variant, shape: dict[str, float]) -> Block:
    """The columns of a variant at other shape values."""
    parameters = variant.effect.parameters(study.ready)
    theta = np.array([shape.get(p.name, 0.0) for p in parameters])
    chosen = [i for i, p in enumerate(parameters) if p.name in variant.names]
    A = study.columns(study.regressor(variant.effect, theta)[:, :, chosen] * variant.scale)
    return replace(variant.block, A=beside_springs(study, A, [parameters[i] for i in chosen]))


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
    effect, alone, tables = option.effect, ground.log_evidence, option.placed(ground)
    log_odds, shapes = effect.log_odds(scene), len(option.tables)
    reduced = ground.reduced_tables([t.block for t in tables], [t.gram for t in tables])

    def variants(sets: Sequence[_Set]) -> list[_Tried]:
        chosen = [(i, tables[i].columns(groups)) for i, groups in sets]
        out = []
        for (i, groups), (_, columns), posterior in zip(sets, chosen, ground.posteriors(reduced, chosen, FACTORS), strict=True):
            of = len(tables[i].groups)
            prior = log_odds + effect.log_odds_of(groups) - log(of * comb(of, len(groups)) * shapes) + tables[i].log_prior
            out.append(_Tried(i, groups, columns, prior, posterior))
        return out

    names = [t.groups for t in tables]
    tried = variants([(i, (n,)) for i, of in enumerate(names) for n in of if tables[i].place in ("", n)])
    tried += _forward(variants, names, tried) + variants([(i, of) for i, of in enumerate(names) if len(of) > 1])
    posteriors = [t.posterior for t in tried]
    saved = ground.bench.saved_each(ground.chi2, np.array([p.chi2 for p in posteriors]))
    gained = [supported(p.log_evidence - alone, s) for p, s in zip(posteriors, saved, strict=True)]
    score = np.array([alone + g + t.log_prior for g, t in zip(gained, tried, strict=True)])
    best = int(np.argmax(score))
    total = float(score[best] + np.log(np.exp(score - score[best]).sum()))
    return Trial(effect, _variant(tables[tried[best].table], effect, tried[best]), tried[best].posterior, total - alone)


def _variant(table: Table, effect: Effect, tried: _Tried) -> Variant:
    chosen = [table.parameters[j] for j in tried.columns]
    return Variant(
        effect, tried.groups, table.shape, tuple(p.name for p in chosen), np.array([p.scale for p in chosen]),
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
    going = [i for i in best if len(names[i]) > 2]
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
