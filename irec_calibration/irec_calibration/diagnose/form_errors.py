# SPDX-License-Identifier: Apache-2.0
"""Whether a small effect stands where the form of a larger one is known only roughly.

No law of the catalogue is exact. What a large effect leaves because of that goes with its own displacement, times some smooth
function of the variables of the session; a small effect that explains no more than such a function is no cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..model import Term
from ..model.model import displacement_of
from ..typing import Array
from .directions import shapes
from .evidence import Block
from .explanation import Explanation
from .settings import Settings
from .study import Study


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
