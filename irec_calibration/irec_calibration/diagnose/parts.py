# SPDX-License-Identifier: Apache-2.0
"""Which parts of an effect (axes, directions) a session proves, and which it can't tell apart.

Somebody opens a gearbox on the strength of an axis' name. So an axis is named only where every explanation within reach has
it: the best set of axes without it, with any other in its place and everything refitted, must explain the session clearly
worse. Parts that earn nothing of their own are taken out of the model.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import comb, log

import numpy as np

from ..effects import Effect, known_effects
from ..effects import Family as Alike
from ..errors import SolveError
from ..model import Estimate, Term
from ..typing import Json
from .candidates import SMALLEST_COLUMN, block_columns, supported
from .evidence import Block, Ground, Posterior
from .family import Family
from .priors import FACTORS
from .remainder import grow
from .settings import SETTINGS
from .study import Study, study_of

REFINED = np.geomspace(1 / 1.6, 1.6, 5)  # around a fitted shape value, in which fits with other parts look for theirs
ROUNDS = 3  # of moving to a better set of parts

Names = tuple[str, ...]


@dataclass(frozen=True)
class Parts:
    """Which parts of an effect are there.

    Attributes:
        proven: every explanation within reach has them.
        one_of: what there is besides, where that is not told apart: sets of parts of which each would do, likeliest first.
        perhaps: in the model, but with too little evidence or too small a share to be named.
        log_evidence: of each part in the model, over the best explanation without it.
    """

    proven: Names = ()
    one_of: tuple[Names, ...] = ()
    perhaps: Names = ()
    log_evidence: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Pruned:
    """A fitted model after its added effects were cut down to the parts that they need.

    Attributes:
        parts: effect id -> what is known of its parts; effects without parts are not in it.
        other: terms of a model with the likeliest other set of parts, and the two sets in words; None where all is told apart.
    """

    study: Study
    parts: dict[str, Parts]
    other: tuple[tuple[Term, ...], tuple[str, str]] | None = None


class _Sets:
    """Scores sets of parts of one effect on top of a model; higher is better, natural log."""

    def __init__(self, rest: Study, effect: Effect, fitted: dict[str, float], beside: Block | None) -> None:
        self.rest, self.effect = rest, effect
        self.ground = Ground(rest.bench, rest.base if beside is None else rest.base + beside)
        self.alone = Posterior(np.zeros(0), self.ground.chi2, self.ground.log_evidence)
        self.tables = [(s, *block_columns(rest, effect, s)) for s in _shapes(rest, effect, fitted)]
        shown = [
            p.group
            for _, block, parameters in self.tables
            for p, length in zip(parameters, np.linalg.norm(block.A, axis=0), strict=True)
            if p.group and length > SMALLEST_COLUMN
        ]
        self.names: Names = tuple(dict.fromkeys(shown))
        self._known: dict[Names, tuple[float, Posterior, int]] = {}

    def ordered(self, names: Iterable[str]) -> Names:
        wanted = set(names)
        return tuple(n for n in self.names if n in wanted)

    def columns(self, names: Names, table: int) -> list[int]:
        _, block, parameters = self.tables[table]
        shows = np.linalg.norm(block.A, axis=0) > SMALLEST_COLUMN
        return [i for i, p in enumerate(parameters) if shows[i] and p.group in (*names, "")]

    def fit(self, names: Names) -> tuple[float, Posterior, int]:
        """Score, posterior and number of the shape of a set, at the shape that suits it best."""
        if names not in self._known:
            best: tuple[float, Posterior, int] = (self.alone.log_evidence, self.alone, 0)
            tried = False
            for i, (_, block, _) in enumerate(self.tables):
                chosen = self.columns(names, i)
                if not names or not chosen:
                    continue
                found = self.ground.posterior(block.take(chosen), FACTORS)
                saved = self.rest.bench.saved(self.alone.chi2, found.chi2)
                gained = supported(found.log_evidence - self.alone.log_evidence, saved)
                score = self.alone.log_evidence + gained - log(comb(len(self.names), len(names)))
                if not tried or score > best[0]:
                    best, tried = (score, found, i), True
            self._known[names] = best
        return self._known[names]

    def score(self, names: Names) -> float:
        return self.fit(names)[0]

    def cost(self, names: Names, part: str) -> float:
        """What a set loses without one of its parts; only as far as the residual rises."""
        less = tuple(n for n in names if n != part)
        risen = self.rest.bench.saved(self.fit(less)[1].chi2, self.fit(names)[1].chi2)
        return min(self.score(names) - self.score(less), max(risen, 0.0))

    def cut_down(self, names: Names) -> Names:
        """Parts taken out one by one, the least needed first, as long as neither one nor all of them are missed."""
        top = self.score(self.names)
        while len(names) > 1:
            least = min(names, key=lambda n: self.cost(names, n))
            less = tuple(n for n in names if n != least)
            top = max(top, self.score(names))
            if self.cost(names, least) >= SETTINGS.nats_to_prove_part or top - self.score(less) >= SETTINGS.nats_to_prove_part:
                break
            names = less
        return names

    def in_use(self, names: Names) -> Names:
        """The parts that a model is used with: those that can be named, or all of them where that is the likelier explanation.

        A cause sits in some axes, where something is worn or loose, or in all of them, where the build has it. What lies between
        are sets that a search finds.
        """
        return self.names if self.score(self.names) > self.score(names) else names

    def others(self, names: Names) -> list[Names]:
        """Sets that could stand for one: each part left out, or replaced by another, or by all others cut down."""
        out: list[Names] = []
        for part in names:
            less = tuple(n for n in names if n != part)
            out += [less] if less else []
            out += [self.ordered((*less, n)) for n in self.names if n not in names]
            rest = tuple(n for n in self.names if n != part)
            out += [self.cut_down(rest)] if len(rest) > 1 else []
        return [n for n in dict.fromkeys(out) if n != names]

    def best(self, start: Names) -> tuple[Names, list[Names]]:
        """The best set that can be reached from one, and those beside it that can't be told from it, likeliest first."""
        names = self.cut_down(start)
        others = self.others(names)
        for _ in range(ROUNDS):
            top = max(others, key=self.score, default=names)
            # a part left out is no better explanation, but the same one cut down too far
            if set(top) < set(names) or self.score(top) <= self.score(names):
                break
            names = self.cut_down(top)
            others = self.others(names)
        near = [n for n in others if self.score(n) > self.score(names) - SETTINGS.nats_within_reach]
        return names, sorted(near, key=lambda n: -self.score(n))

    def parts(self, names: Names, near: Sequence[Names]) -> Parts:
        """What is known of the parts of the best set."""
        everything = max(self.alone.chi2 - self.fit(names)[1].chi2, 1e-9)
        own, proven = {}, []
        for n in names:
            less = tuple(m for m in names if m != n)
            without = [less, *(s for s in self.others(names) if n not in s)]
            own[n] = min(self.cost(names, n), self.score(names) - max(self.score(s) for s in without))
            share = (self.fit(less)[1].chi2 - self.fit(names)[1].chi2) / everything
            is_proven = self.cost(names, n) >= SETTINGS.nats_to_prove_part and share >= SETTINGS.share_to_prove_part
            if is_proven and all(n in s for s in near):
                proven.append(n)
        one_of = _alternatives([names, *near], proven)
        spoken = {*proven, *(n for s in one_of for n in s)}
        return Parts(tuple(proven), one_of, tuple(n for n in names if n not in spoken), own)

    def term(self, names: Names) -> Term:
        """The effect with these parts, with the values of the linearised fit."""
        _, posterior, i = self.fit(names)
        shape, block, parameters = self.tables[i]
        chosen = self.columns(names, i)
        value = dict(zip((parameters[c].name for c in chosen), posterior.x, strict=True))
        estimates = {}
        for p in self.effect.parameters(self.rest.ready):
            if p.name in value or p.name in shape:
                v = shape[p.name] if p.name in shape else float(value[p.name]) * p.scale
                estimates[p.name] = Estimate(float(np.clip(v, p.lower, p.upper)), unit=p.unit, lower=p.lower, upper=p.upper)
        return Term(self.effect, estimates)


def _alternatives(sets: Sequence[Names], proven: Sequence[str]) -> tuple[Names, ...]:
    """What sets that are not told apart have besides what is proven and besides what all of them share."""
    shared = set(sets[0]).intersection(*sets[1:])
    left = list(dict.fromkeys(tuple(n for n in s if n not in proven and n not in shared) for s in sets))
    if () in left:  # one of them does without: nothing more is needed
        return ()
    least = [s for s in left if not any(set(o) < set(s) for o in left)]
    return tuple(least) if len(least) > 1 else ()


def _shapes(rest: Study, effect: Effect, fitted: dict[str, float]) -> list[dict[str, float]]:
    """Shape values to score sets of parts at: the effect's grid, the fitted ones and some around these."""
    shaped = [p for p in effect.parameters(rest.ready) if p.grid]
    values = []
    for p in shaped:
        found = {*p.grid, fitted[p.name]} if p.name in fitted else set(p.grid)
        if min(found) > 0.0 and p.name in fitted:
            found |= {float(v) for v in np.clip(fitted[p.name] * REFINED, p.lower, p.upper)}
        values.append(sorted(found))
    return [{p.name: float(v) for p, v in zip(shaped, row, strict=True)} for row in product(*values)]


def parts_in(term: Term, study: Study) -> Names:
    """The parts of an effect that a term of a fitted model has."""
    groups = (p.group for p in term.effect.parameters(study.ready) if p.name in term.estimates and p.group)
    return tuple(dict.fromkeys(groups))


def prune(study: Study, added: Iterable[str], beside: Block | None = None, family: Family | None = None) -> Pruned:
    """Cut the added effects of a fitted model down to the parts that the session asks for, and say which of them it proves.

    Args:
        study: the model with the added effects.
        added: their ids; effects that have no parts are left alone.
        beside: columns of a nonparametric remainder; family: structures that may stand in for a part.
    """
    known: dict[str, Parts] = {}
    other = None
    for effect_id in added:
        term = next((t for t in study.terms if t.effect.id == effect_id), None)
        present = parts_in(term, study) if term else ()
        if term is None or not present:
            continue
        try:
            rest = without_columns(study, effect_id)
            sets = _Sets(rest, term.effect, {n: e.value for n, e in term.estimates.items()}, beside)
            if len(sets.names) < 2:
                known[effect_id] = Parts(proven=present)
                continue
            starts = dict.fromkeys((sets.ordered(present) or sets.names, sets.names))
            names, near = sets.best(max((sets.cut_down(s) for s in starts), key=sets.score))
            known[effect_id] = sets.parts(names, near)
            if family is not None:
                known[effect_id] = _beyond_structures(known[effect_id], sets, names, beside, family)
            if term.effect.everywhere:  # every axis gives way: none is taken out for want of evidence
                said = known[effect_id]
                known[effect_id] = replace(said, perhaps=tuple(n for n in present if n not in said.proven), one_of=())
                continue
            used = sets.in_use(names)
            known[effect_id] = _with_more(known[effect_id], sets, used)
            if used != present:
                study = _with(study, sets.term(used))
            rival = next((n for n in near if not set(n) < set(names)), None)
            if known[effect_id].one_of and rival is not None and other is None:
                other = (_with(study, sets.term(rival)).terms, (_label(effect_id, names), _label(effect_id, rival)))
        except SolveError:
            known[effect_id] = Parts(perhaps=present)
    return Pruned(study, known, other)


def _with_more(parts: Parts, sets: _Sets, used: Names) -> Parts:
    """What is known of parts, and that the model has others too, of which none is sure."""
    spoken = {*parts.proven, *parts.perhaps, *(n for s in parts.one_of for n in s)}
    own = {n: sets.cost(used, n) for n in used if n not in parts.log_evidence}
    return replace(parts, perhaps=(*parts.perhaps, *(n for n in used if n not in spoken)), log_evidence=parts.log_evidence | own)


def _beyond_structures(parts: Parts, sets: _Sets, names: Names, beside: Block | None, family: Family) -> Parts:
    """Parts of which some are no longer proven, because a nonparametric structure explains the session as well in their place;
    or, of several axes with one law of torque, another law in one of them."""
    doubtful = []
    axes = {p.group: p.axis for p in sets.effect.parameters(sets.rest.ready)}
    for n in parts.proven:
        less = tuple(m for m in names if m != n)
        base = sets.rest.base if beside is None else sets.rest.base + beside
        if less:
            _, found, i = sets.fit(less)
            base = base + sets.tables[i][1].take(sets.columns(less, i)).widened(found.factor)
        instead = grow(sets.rest.bench, family, base, most=2, beside_axis=axes.get(n)).gained
        if less and sets.effect.family is Alike.TORQUE_LAW:
            instead = max(instead, _by_another_law(sets, base, axes.get(n)))
        if sets.cost(names, n) - instead < SETTINGS.nats_to_prove_part:
            doubtful.append(n)
    if not doubtful:
        return parts
    return replace(parts, proven=tuple(n for n in parts.proven if n not in doubtful), perhaps=(*parts.perhaps, *doubtful))


def _by_another_law(sets: _Sets, base: Block, axis: int | None) -> float:
    """Log evidence that another effect which is a law of torque gains in one axis only, on top of a model."""
    rest = sets.rest
    ground = Ground(rest.bench, base)
    best = 0.0
    for effect in known_effects().values():
        if effect.family is not Alike.TORQUE_LAW or effect.id == sets.effect.id or rest.why_not(effect):
            continue
        shaped = [p for p in effect.parameters(rest.ready) if p.grid]
        for values in product(*(p.grid for p in shaped)):
            shape = {p.name: v for p, v in zip(shaped, values, strict=True)}
            block, parameters = block_columns(rest, effect, shape)
            length = np.linalg.norm(block.A, axis=0)
            mine = [i for i, p in enumerate(parameters) if p.axis == axis and length[i] > SMALLEST_COLUMN]
            if mine:
                found = ground.posterior(block.take(mine), FACTORS)
                best = max(best, found.log_evidence - ground.log_evidence)
    return best


def parts_json(parts: dict[str, Parts]) -> Json:
    """What is known of the parts of effects, for a result file."""
    return {
        effect: {
            "proven": list(p.proven),
            "one_of": [list(s) for s in p.one_of],
            "perhaps": list(p.perhaps),
            "log_evidence": p.log_evidence,
        }
        for effect, p in parts.items()
    }


def without_columns(study: Study, effect_id: str) -> Study:
    """The linear problem about a fitted model without the columns of one effect.

    Not that about the model fitted without it: other effects would be bent to make up for what is missing, and linearised there
    they lend evidence to parts that are not there.
    """
    rest = [i for i, owner in enumerate(study.owners) if owner != effect_id]
    return replace(study, base=study.base.take(rest), owners=tuple(study.owners[i] for i in rest),
                   parameters=tuple(study.parameters[i] for i in rest), scale=study.scale[rest])  # fmt: skip


def _with(study: Study, term: Term) -> Study:
    """A model with the term of the same effect replaced, refitted."""
    return study_of(study.observation, tuple(term if t.effect.id == term.effect.id else t for t in study.terms))


def _label(effect_id: str, names: Names) -> str:
    return f"{effect_id}:{'+'.join(names)}"
