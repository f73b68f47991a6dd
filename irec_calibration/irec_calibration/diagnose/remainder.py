# SPDX-License-Identifier: Apache-2.0
"""The nonparametric remainder: what a session has beside the named effects, in few structures of the generic family."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..typing import Array
from .evidence import Bench, Block, Products
from .family import Family, Structure
from .ground import Ground
from .settings import SETTINGS


@dataclass(frozen=True)
class Part:
    """One structure of a remainder with its amplitude, and what it added when it was taken in (number tried taken off)."""

    structure: Structure
    amplitude: float
    log_evidence: float


@dataclass(frozen=True)
class Remainder:
    """Structures beside a model.

    Attributes:
        parts: the strongest first as they were found.
        log_evidence: of model and remainder together, the number of structures tried taken off.
        block: columns of model and remainder.
    """

    parts: tuple[Part, ...]
    log_evidence: float
    block: Block
    own: slice

    @property
    def structures(self) -> tuple[Part, ...]:
        """Parts that are a cause: not the bad rows."""
        return tuple(p for p in self.parts if not p.structure.is_bad_row)

    @property
    def without_a_name(self) -> float:
        """Log evidence of what has no name and is a cause."""
        return sum(p.log_evidence for p in self.structures)

    @property
    def bad_rows(self) -> tuple[Part, ...]:
        """Rows and references that stand out."""
        return tuple(p for p in self.parts if p.structure.is_bad_row)

    @property
    def gained(self) -> float:
        return sum(p.log_evidence for p in self.parts)

    @property
    def columns(self) -> Iterator[tuple[Part, slice]]:
        """Each part, and which columns of the block are its own."""
        at = self.own.start
        for part in self.parts:
            here = slice(at, at + part.structure.columns.stop - part.structure.columns.start)
            yield part, here
            at = here.stop


def grow(
    bench: Bench,
    family: Family,
    base: Block,
    start: Sequence[Part] = (),
    most: int = SETTINGS.most_structures,
    beside_axis: int | None = None,
    without: Callable[[Structure], bool] | None = None,
) -> Remainder:
    """Add structures to a model one by one, each time the one with most evidence, as long as they have enough of it.

    Poses that stand out as a whole, or by their references, are accidents as long as they are few. Where they are many and
    structures do nearly as well, something systematic is behind them.

    Args:
        start: structures that are tried first, in this order, and kept where they still have evidence.
        beside_axis: structures that turn only this axis are left out.
        without: further structures that are left out.
    """

    def left_out(s: Structure) -> bool:
        return (beside_axis is not None and s.axis == beside_axis) or (without is not None and without(s))

    found = _grow(bench, family, base, start, most, left_out)
    poses = sum(len(p.structure.rows) > 1 for p in found.bad_rows)
    if poses < SETTINGS.several or poses <= SETTINGS.most_poses_aside * len(bench.poses):
        return found
    start = [p for p in start if len(p.structure.rows) <= 1]
    systematic = _grow(bench, family, base, start, most, lambda s: len(s.rows) > 1 or left_out(s))
    return systematic if systematic.gained > found.gained - SETTINGS.nats_to_separate * poses else found


def _grow(
    bench: Bench, family: Family, base: Block, start: Sequence[Part], most: int, left_out: Callable[[Structure], bool]
) -> Remainder:
    block, parts = base, list[Part]()
    at = _At(base.A.T @ base.A, base.A.T @ bench.b, _crossed(base, family), family.A.T @ bench.b)
    ground = Ground(bench, block, at.products)
    log_evidence = ground.log_evidence
    tried = np.log([s.tried for s in family.structures])
    taken = {i for i, s in enumerate(family.structures) if left_out(s)}
    place = {id(s): i for i, s in enumerate(family.structures)}

    def take(i: int, gain: float, amplitude: float, least: float) -> None:
        """Take a structure in, if it has the least evidence at values of the model that can be: its gain was asked with all
        springs free that were not at a bound before, and none may become less than rigid beside it."""
        nonlocal block, ground, log_evidence, at
        structure = family.structures[i]
        taken.add(i)
        more = block + family.block(structure, amplitude)
        there = at.with_columns(structure.columns, family.crossed(structure))
        above = Ground(bench, more, there.products)
        gain -= above.lost_to_bounds(ground)
        if gain < least:
            return
        block, at, ground = more, there, above
        parts.append(Part(structure, amplitude, gain))
        log_evidence += gain

    for part in start:
        i = place[id(part.structure)]
        if i in taken:
            continue
        alone, size = family.gain_of(i, ground, (at.crossed, at.by_b))
        if alone > tried[i]:
            take(i, float(alone - tried[i]), size, 0.0)
    while sum(not p.structure.is_bad_row for p in parts) < most and len(parts) < 3 * most and len(family.structures):
        gain, amplitude = family.gains(ground, (at.crossed, at.by_b))
        score = gain - tried
        score[list(taken)] = -np.inf
        i = int(np.argmax(score))
        if score[i] < SETTINGS.nats_to_take_in:
            break
        take(i, float(score[i]), float(amplitude[i]), SETTINGS.nats_to_take_in)
    return Remainder(tuple(parts), log_evidence, block, slice(base.A.shape[1], None))


@dataclass(frozen=True)
class _At:
    """Products of all that a remainder is made of: G = A'A and h = A'b of model and structures so far, A'X and X'b of the
    family's columns X. A structure that is taken in adds rows that are known."""

    G: Array
    h: Array
    crossed: Array
    by_b: Array

    @property
    def products(self) -> Products:
        return self.G, self.h

    def with_columns(self, columns: slice, rows: Array) -> _At:
        corner = self.crossed[:, columns]
        G = np.block([[self.G, corner], [corner.T, rows[:, columns]]])
        return _At(G, np.concatenate([self.h, self.by_b[columns]]), np.concatenate([self.crossed, rows]), self.by_b)


def _crossed(base: Block, family: Family) -> Array:
    """Products of a model's columns with all columns of a family, (p, columns)."""
    return np.asarray(base.A.T.astype(family.A.dtype, copy=False) @ family.A, dtype=float)
