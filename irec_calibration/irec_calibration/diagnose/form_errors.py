# SPDX-License-Identifier: Apache-2.0
"""Whether a small effect stands where the form of a larger one, with a name or without, is known only roughly.

No law of the catalogue is exact. What a large effect leaves because of that goes with its own displacement, times some smooth
function of the variables of the session; a small effect that explains no more than such a function is no cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..effects import Family
from ..model import Term, displacement_of
from ..typing import Array
from .directions import shapes
from .evidence import Block
from .explanation import Explanation
from .forms import forms_of
from .ground import Ground
from .settings import Settings
from .study import Study

TIMES_LARGER = 4.0  # than structures together, from which they feign less of a name; chosen


def evidence_beside(one: Explanation, effect_id: str, larger: Sequence[str], settings: Settings) -> float:
    """Log evidence of an effect of a model in which each larger one may deviate from its form by any smooth function, nats."""
    study = one.study
    rest = [i for i, owner in enumerate(study.owners) if owner != effect_id]
    deviations = _deviations(study, [one.term(i) for i in larger], settings.form_error)
    bare, whole = study.base.take(rest) + deviations, study.base + deviations
    return study.bench.posterior(whole).log_evidence - study.bench.posterior(bare).log_evidence


def _deviations(study: Study, terms: Sequence[Term], share: float) -> Block:
    """Displacement of each part of some effects times each shape over the rows; a prior width of 1 is that share of it."""
    over = np.concatenate(list(shapes(study).values()), axis=1)
    columns = [
        share * study.columns(moved[:, :, None] * over[:, None, :]) for term in terms for moved in _by_part(study, term)
    ]
    A = np.concatenate(columns, axis=1)
    free = np.full(A.shape[1], np.inf)
    return Block(A, -free, free, np.ones(A.shape[1]))


def _by_part(study: Study, term: Term) -> Iterator[Array]:
    """Displacement by each group of an effect's parameters alone, (n, 3), m."""
    own = term.effect.parameters(study.ready)
    groups = dict.fromkeys(p.group for p in own if p.group) or {"": None}
    for group in groups:
        names = [p.name for p in own if p.name in term.estimates and p.group in ("", group)]
        part = Term(term.effect, {n: term.estimates[n] for n in names})
        theta = part.theta(own)
        if term.effect.acts_on == "wrench":
            moved: Array = study.regressor(term.effect, np.zeros_like(theta)) @ theta
        else:
            moved = displacement_of(part, study.ready)
        yield moved


def feigned(one: Explanation, settings: Settings) -> dict[str, float]:
    """How much of each name's evidence the structures that remain could feign: what their displacement is worth along that of
    the name, beside everything else in the model.

    That is their own evidence, which goes with squares, times the square of the correlation of the two displacements; at least
    what the form of a structure, which is not quite that of its cause, leaves to any other (`share_feigned`). What repeats many
    times per turn of an axis leaves nothing of that kind to what passes with time. Of a name that explains many times more than
    all of them they feign less (`TIMES_LARGER`).
    """
    block, study = one.remainder.block, one.study
    x = study.bench.posterior(block).x
    rest = [i for i, owner in enumerate(study.owners) if owner not in one.ids]
    ground = Ground(study.bench, study.base.take(rest))
    moved = []
    for part, own in one.remainder.columns:
        if not part.structure.is_bad_row:
            moved.append((part, ground.beside(block.A[:, own] @ x[own])))
    out = {}
    for effect_id in one.ids:
        columns = [i for i, owner in enumerate(study.owners) if owner == effect_id]
        mine = ground.beside(block.A[:, columns] @ x[columns])
        forms = forms_of(one.term(effect_id), one.study.ready)
        passes = one.term(effect_id).effect.family is Family.TIME
        others = [(p, v) for p, v in moved if not forms.has(p.structure)]
        together, explained = sum(p.log_evidence for p, _ in others), 0.5 * float(mine @ mine)
        out[effect_id] = min(TIMES_LARGER * together / max(explained, 1e-300), 1.0) * sum(
            p.log_evidence * max(_cosine(mine, v) ** 2, 0.0 if passes and p.structure.ripple else settings.share_feigned)
            for p, v in others
        )
    return out


def _cosine(a: Array, b: Array) -> float:
    return float(a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300))
