# SPDX-License-Identifier: Apache-2.0
"""Shape values that one group of an effect alone depends on, such as the place that a hose pulls towards: moved to where the
evidence is best, from the best place of their grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import log
from typing import NamedTuple

import numpy as np

from ..effects import Effect, Parameter
from ..typing import Array
from .columns import block_columns
from .evidence import Block
from .ground import Ground
from .priors import FACTORS
from .study import Study

STEPS = 6  # of Gauss-Newton
HALVINGS = 3  # of a step after which the evidence is no better
WIDTH = 0.5  # of the spacing of the grid: prior of a place about the nearest one of the grid
WORTH_A_STEP = 0.1  # nats


class _Found(NamedTuple):
    """A place, the evidence and the scaled values of the group there, and what not knowing the place better costs, nats."""

    shape: dict[str, float]
    evidence: float
    x: Array
    known: float = 0.0


@dataclass(frozen=True)
class Places:
    """A group with its columns at each place of a grid: of one effect on one study."""

    study: Study
    effect: Effect
    group: str
    grid: tuple[dict[str, float], ...]
    blocks: tuple[Block, ...]

    def best(self, ground: Ground) -> tuple[dict[str, float], float]:
        """The place with the best evidence on a ground, moved from the best of the grid at which the effect may have its values,
        and the log prior of the group there: how likely a place is, and what not knowing it better costs.

        What the grid has one value of, such as where on the tool a hose is tied, is moved where that is worth what it costs.
        """
        reduced = ground.reduced_tables(self.blocks)
        columns = range(self.blocks[0].A.shape[1])
        found = ground.posteriors(reduced, [(i, columns) for i in range(len(self.blocks))], FACTORS)
        likeliest = sorted(range(len(found)), key=lambda j: -found[j].log_evidence)
        i = next((j for j in likeliest if self._can_be(self.grid[j], found[j].x)), likeliest[0])
        start = _Found(dict(self.grid[i]), found[i].log_evidence, found[i].x)
        several = [p for p in self._shaped if len(p.grid) > 1]
        near = self._moved_to_best(ground, start, several) if several else start
        there = near if len(several) == len(self._shaped) else self._moved_to_best(ground, near, self._shaped)
        possible = [f for f in (near, there) if self._can_be(f.shape, f.x)] or [start]
        best = max(possible, key=lambda f: f.evidence + min(f.known, 0.0))
        return best.shape, min(best.known, 0.0) - log(len(self.grid))

    def _moved_to_best(self, ground: Ground, found: _Found, shaped: Sequence[Parameter]) -> _Found:
        """Some of the shape values moved to where the evidence is best, and what not knowing these costs there."""
        shape, evidence, x, known = found.shape, found.evidence, found.x, 0.0
        for _ in range(STEPS):
            block, by_place = self._about(shape, x, shaped)
            both = ground.posterior(block + by_place, FACTORS)
            known = both.log_evidence - evidence
            better = self._moved(ground, shape, shaped, both.x[len(x) :], evidence)
            if better is None:
                break
            shape, gained, x = better
            evidence += gained
            known -= gained
            if gained < WORTH_A_STEP:
                break
        return _Found(shape, evidence, x, known)

    def _moved(
        self, ground: Ground, shape: dict[str, float], shaped: Sequence[Parameter], step: Array, evidence: float
    ) -> tuple[dict[str, float], float, Array] | None:
        """The place after a step, what the evidence gains and the values there; None where no share of the step is better."""
        for share in 0.5 ** np.arange(HALVINGS):
            there = shape | {
                p.name: float(np.clip(shape[p.name] + share * s * _spacing(p), p.lower, p.upper))
                for p, s in zip(shaped, step, strict=True)
            }
            found = ground.posterior(self._columns(there), FACTORS)
            if found.log_evidence > evidence:
                return there, found.log_evidence - evidence, found.x
        return None

    def _can_be(self, shape: dict[str, float], x: Array) -> bool:
        """Whether the effect may have values of the group, (p,), at a place: what pushes from it may pull towards another one."""
        mine = [p for p in self.effect.parameters(self.study.ready) if p.group == self.group and not p.grid]
        values = shape | {p.name: float(v) * p.scale for p, v in zip(mine, x, strict=True)}
        return not self.effect.why_impossible({n: (v, 0.0) for n, v in values.items()}, {}, self.study.ready)

    @property
    def _shaped(self) -> list[Parameter]:
        return [p for p in self.effect.parameters(self.study.ready) if p.shapes == self.group]

    def _columns(self, shape: dict[str, float]) -> Block:
        return _of_group(self.study, self.effect, self.group, shape)

    def _about(self, shape: dict[str, float], x: Array, shaped: Sequence[Parameter]) -> tuple[Block, Block]:
        """Columns of the group at a place, and by how some of its shape values move, at values x."""
        own = self.effect.parameters(self.study.ready)
        mine = [i for i, p in enumerate(own) if p.group == self.group and not p.grid]
        theta = np.array([shape.get(p.name, 0.0) for p in own])
        theta[mine] = x * [own[i].scale for i in mine]
        names = {p.name for p in shaped}
        moved = [i for i, p in enumerate(own) if p.name in names]
        A = self.study.columns(self.study.regressor(self.effect, theta)[:, :, moved] * [_spacing(own[i]) for i in moved])
        n = len(moved)
        return self._columns(shape), Block(A, np.full(n, -1.0), np.full(n, 1.0), np.full(n, WIDTH))


def place_beside(study: Study, effect: Effect, values: dict[str, float]) -> dict[str, float]:
    """Shape values of groups with a place that are better than those of a fitted model, moved from these; empty where none are.

    Args:
        study: the fitted model; values: estimates of the effect in it.
    """
    better: dict[str, float] = {}
    own = {p.name: p for p in effect.parameters(study.ready)}
    for group in dict.fromkeys(p.shapes for p in own.values() if p.shapes and p.name in values):
        at = {n: v for n, v in values.items() if own[n].shapes == group}
        mine = {p.name for p in own.values() if p.group == group}
        rest = [
            i for i, (o, p) in enumerate(zip(study.owners, study.parameters, strict=True)) if o != effect.id or p.name not in mine
        ]
        if len(rest) == len(study.owners):
            continue
        place = Places(study, effect, group, (at,), (_of_group(study, effect, group, at),))
        better |= place.best(Ground(study.bench, study.base.take(rest)))[0]
    return {n: v for n, v in better.items() if v != values[n]}


def places_of(study: Study, effect: Effect) -> tuple[Places, ...]:
    """Each group of an effect that has a place of its own."""
    own = effect.parameters(study.ready)
    out = []
    for group in dict.fromkeys(p.shapes for p in own if p.shapes):
        shaped = [p for p in own if p.shapes == group]
        grid = [dict(zip((p.name for p in shaped), v, strict=True)) for v in product(*(p.grid for p in shaped))]
        out.append(Places(study, effect, group, tuple(grid), tuple(_of_group(study, effect, group, g) for g in grid)))
    return tuple(out)


def _of_group(study: Study, effect: Effect, group: str, shape: dict[str, float]) -> Block:
    block, parameters = block_columns(study, effect, shape)
    return block.take([i for i, p in enumerate(parameters) if p.group == group])


def _spacing(p: Parameter) -> float:
    """Between places of the grid; the scale of a parameter that is tried at one place first."""
    return float(np.diff(sorted(p.grid)).mean()) if len(p.grid) > 1 else p.scale
