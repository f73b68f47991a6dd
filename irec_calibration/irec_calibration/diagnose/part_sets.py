# SPDX-License-Identifier: Apache-2.0
"""Sets of parts of one effect, each scored with everything refitted: the best, those within reach, what each part earns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import comb, log

import numpy as np

from ..effects import Effect
from ..model import Estimate, Term
from .candidates import SMALLEST_COLUMN, supported
from .columns import block_columns
from .evidence import Block, Posterior
from .ground import Ground
from .places import places_of
from .priors import FACTORS
from .settings import SETTINGS
from .study import Study

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


class PartSets:
    """Scores sets of parts of one effect on top of a model; higher is better, natural log."""

    def __init__(self, rest: Study, effect: Effect, fitted: dict[str, float], beside: Block | None) -> None:
        self.rest, self.effect = rest, effect
        self.ground = Ground(rest.bench, rest.base if beside is None else rest.base + beside)
        self.alone = Posterior(np.zeros(0), self.ground.chi2, self.ground.log_evidence)
        places = {of.group: of.best(self.ground) for of in places_of(rest, effect)}
        self._of_place = {group: log_prior for group, (_, log_prior) in places.items()}
        found = {name: v for place, _ in places.values() for name, v in place.items()}
        shapes = [s for values in (found | fitted, fitted | found) for s in _shapes(rest, effect, values)]
        self.tables = [(s, *block_columns(rest, effect, s)) for s in ({tuple(s.items()): s for s in shapes}).values()]
        self._reduced = self.ground.reduced_tables([block for _, block, _ in self.tables])
        self._shows = [np.linalg.norm(block.A, axis=0) > SMALLEST_COLUMN for _, block, _ in self.tables]
        shown = [
            p.group
            for (_, _, parameters), of in zip(self.tables, self._shows, strict=True)
            for p, shows in zip(parameters, of, strict=True)
            if p.group and shows
        ]
        self.names: Names = tuple(dict.fromkeys(shown))
        self._known: dict[Names, tuple[float, Posterior, int]] = {}

    def ordered(self, names: Iterable[str]) -> Names:
        wanted = set(names)
        return tuple(n for n in self.names if n in wanted)

    def columns(self, names: Names, table: int) -> list[int]:
        shows, wanted = self._shows[table], {*names, ""}
        return [i for i, p in enumerate(self.tables[table][2]) if p.group in wanted and shows[i]]

    def fit(self, names: Names) -> tuple[float, Posterior, int]:
        """Score, posterior and number of the shape of a set, at the shape that suits it best."""
        if names not in self._known:
            best: tuple[float, Posterior, int] = (self.alone.log_evidence, self.alone, 0)
            tried, prior = False, sum(self._of_place.get(n, 0.0) for n in names)
            columns = {i: self.columns(names, i) for i in range(len(self.tables)) if names}
            columns = {i: chosen for i, chosen in columns.items() if chosen}
            posteriors = self.ground.posteriors(self._reduced, list(columns.items()), FACTORS)
            for i, found in zip(columns, posteriors, strict=True):
                saved = self.rest.bench.saved(self.alone.chi2, found.chi2)
                gained = supported(found.log_evidence - self.alone.log_evidence, saved)
                score = self.alone.log_evidence + gained - log(comb(len(self.names), len(names))) + prior
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
        own, proven = {}, list[str]()
        for n in names:
            less = tuple(m for m in names if m != n)
            without = [less, *(s for s in self.others(names) if n not in s)]
            own[n] = min(self.cost(names, n), self.score(names) - max(self.score(s) for s in without))
            share = self._brought(names, less) / everything
            is_proven = self.cost(names, n) >= SETTINGS.nats_to_prove_part and share >= SETTINGS.share_to_prove_part
            if is_proven and all(n in s for s in near):
                proven.append(n)
        one_of = _alternatives([names, *near], proven)
        least = tuple(n for n in names if not any(n in s for s in one_of))
        if one_of and self._brought(names, least) < SETTINGS.share_to_prove_part * everything:
            one_of = ()
        spoken = {*proven, *(n for s in one_of for n in s)}
        return Parts(tuple(proven), one_of, tuple(n for n in names if n not in spoken), own)

    def _brought(self, names: Names, less: Names) -> float:
        """By how much a set lowers the squared residual that fewer parts leave."""
        return self.fit(less)[1].chi2 - self.fit(names)[1].chi2

    def term(self, names: Names) -> Term:
        """The effect with these parts, with the values of the linearised fit."""
        _, posterior, i = self.fit(names)
        shape, block, parameters = self.tables[i]
        own = self.effect.parameters(self.rest.ready)
        shape = {p.name: shape[p.name] for p in own if p.name in shape and p.shapes in ("", *names)}
        chosen = self.columns(names, i)
        value = dict(zip((parameters[c].name for c in chosen), posterior.x, strict=True))
        estimates = {}
        for p in own:
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
    """Shape values to score sets of parts at: the effect's grid, the fitted ones and some around these; of those that shape one
    part only the fitted ones."""
    shaped = [p for p in effect.parameters(rest.ready) if p.grid]
    values = []
    for p in shaped:
        if p.shapes:  # known for this ground
            values.append([fitted[p.name]])
            continue
        found = {*p.grid, fitted[p.name]} if p.name in fitted else set(p.grid)
        if min(found) > 0.0 and p.name in fitted:
            found |= {float(v) for v in np.clip(fitted[p.name] * REFINED, p.lower, p.upper)}
        values.append(sorted(found))
    return [{p.name: float(v) for p, v in zip(shaped, row, strict=True)} for row in product(*values)]
