# SPDX-License-Identifier: Apache-2.0
"""Every way in which an effect may be present: which of its parts (axes, directions), at which shape values."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import comb, log

import numpy as np

from ..effects import Effect, Parameter
from ..typing import Array
from .evidence import Block, Posterior
from .priors import FACTORS, log_odds, prior_width
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
        best: its best variant with the posterior of model and effect together (effect's columns last).
        log_evidence: averaged over the effect's variants, relative to the model alone.
    """

    effect: Effect
    best: Variant
    posterior: Posterior
    log_evidence: float


def parts(study: Study, effect: Effect) -> Iterator[tuple[dict[str, float], Block, list[str], list[Parameter]]]:
    """All columns of an effect for each choice of its shape values: shape, block, group of each column, parameters."""
    shaped = [p for p in effect.parameters(study.ready) if p.grid]
    for values in product(*(shape_values(study, effect, p) for p in shaped)):
        shape = {p.name: v for p, v in zip(shaped, values, strict=True)}
        block, chosen = block_columns(study, effect, shape)
        yield shape, block, [p.group for p in chosen], chosen


def block_columns(study: Study, effect: Effect, shape: dict[str, float]) -> tuple[Block, list[Parameter]]:
    """All columns of an effect at given values of its shape, and the parameter of each."""
    parameters = effect.parameters(study.ready)
    free = [i for i, p in enumerate(parameters) if not p.grid]
    theta = np.array([shape.get(p.name, 0.0) for p in parameters])
    chosen = [parameters[i] for i in free]
    scale = np.array([p.scale for p in chosen])
    A = study.columns(study.regressor(effect, theta)[:, :, free] * scale)
    width = np.array([prior_width(effect.id, p, study.ready.n_joints) for p in chosen])
    lower = np.array([p.lower for p in chosen]) / scale
    upper = np.array([p.upper for p in chosen]) / scale
    return Block(A, lower, upper, width), chosen


def shape_values(study: Study, effect: Effect, parameter: Parameter) -> tuple[float, ...]:
    """Values to try for a nonlinear parameter; of moments in time only those that part a reference from its loaded rows."""
    if effect.id != "station_shift" or study.ready.kind != "loaded":
        return parameter.grid
    grid = np.array(parameter.grid)
    rows = study.observation.rows
    start = study.ready.stamp[study.ready.reference[rows]]
    end = study.ready.stamp[rows]
    parted = ((grid[:, None] > np.minimum(start, end)) & (grid[:, None] < np.maximum(start, end))).any(axis=1)
    return tuple(grid[parted])


def block_at(study: Study, variant: Variant, shape: dict[str, float]) -> Block:
    """The columns of a variant at other shape values."""
    parameters = variant.effect.parameters(study.ready)
    theta = np.array([shape.get(p.name, 0.0) for p in parameters])
    chosen = [i for i, p in enumerate(parameters) if p.name in variant.names]
    return replace(variant.block, A=study.columns(study.regressor(variant.effect, theta)[:, :, chosen] * variant.scale))


def try_effect(study: Study, effect: Effect, check: Callable[[], None] = lambda: None) -> Trial | None:
    """Try an effect in all its variants on top of a model; None where none of its columns shows in this session."""
    without = study.bench.posterior(study.base)
    alone = without.log_evidence
    tried: list[tuple[Variant, Posterior]] = []
    shapes = list(parts(study, effect))
    for shape, block, group, parameters in shapes:
        check()
        shows = np.linalg.norm(block.A, axis=0) > SMALLEST_COLUMN
        names = list(dict.fromkeys(g for g, s in zip(group, shows, strict=True) if s))
        if not names:
            continue

        def variant(
            chosen: tuple[str, ...],
            shape: dict[str, float] = shape,
            block: Block = block,
            group: list[str] = group,
            parameters: list[Parameter] = parameters,
            shows: Array = shows,
            names: list[str] = names,
        ) -> tuple[Variant, Posterior]:
            columns = [i for i in range(len(group)) if group[i] in chosen and shows[i]]
            prior = (
                log_odds(effect.id, study.ready.kind) - log(len(names)) - log(comb(len(names), len(chosen))) - log(len(shapes))
            )
            v = Variant(
                effect, chosen, shape, tuple(parameters[i].name for i in columns),
                np.array([parameters[i].scale for i in columns]), block.take(columns), prior,
            )  # fmt: skip
            found = study.bench.posterior(study.base + v.block, FACTORS, slice(study.base.A.shape[1], None))
            return replace(v, block=v.block.widened(found.factor)), found

        singles = [variant((n,)) for n in names]
        tried += singles
        if len(names) > 2:
            tried += _forward(variant, names, singles)
        if len(names) > 1:
            tried.append(variant(tuple(names)))
    if not tried:
        return None
    score = np.array([alone + supported(p.log_evidence - alone, without.chi2 - p.chi2) + v.log_prior for v, p in tried])
    best = int(np.argmax(score))
    total = float(score[best] + np.log(np.exp(score - score[best]).sum()))
    return Trial(effect, *tried[best], total - alone)


def supported(log_evidence: float, chi2_saved: float) -> float:
    """Evidence that the data bear out: without a fall of the residual, evidence only means that a prior was relieved."""
    return min(log_evidence, max(chi2_saved, 0.0))


def _forward(
    variant: Callable[[tuple[str, ...]], tuple[Variant, Posterior]], names: list[str], singles: list[tuple[Variant, Posterior]]
) -> list[tuple[Variant, Posterior]]:
    """Sets of groups built up one by one, as long as the evidence rises."""
    out: list[tuple[Variant, Posterior]] = []
    chosen, best = max(((v.groups, p.log_evidence + v.log_prior) for v, p in singles), key=lambda t: t[1])
    for _ in range(min(FORWARD_STEPS, len(names) - 2)):
        more = [variant(tuple(n for n in names if n in chosen or n == extra)) for extra in names if extra not in chosen]
        out += more
        top, value = max(((v.groups, p.log_evidence + v.log_prior) for v, p in more), key=lambda t: t[1])
        if value <= best:
            break
        chosen, best = top, value
    return out
