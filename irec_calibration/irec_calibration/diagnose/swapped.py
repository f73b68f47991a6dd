# SPDX-License-Identifier: Apache-2.0
"""Effects of a model on the way whose fitted values, or a part of them, are rather another effect, which takes their place.

An effect comes in while other causes are missing, and takes up a part of theirs. Once these are in the model what is left of it
may be a special form, which has a name of its own: crosstalk of a force sensor that does nothing but turn the force is a sensor
that is mounted turned. Refused as what it is not, it would take all that stands beside it along.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..errors import SolveError
from ..model import Estimate, Term
from .candidates import Option, try_option
from .explanation import (
    Explanation,
    borne_out,
    explain,
    implausible,
    rather,
    remainder_of,
    reshaped_again,
    without,
)
from .family import Family
from .ground import Ground
from .settings import Settings
from .study import study_of


def as_rather(
    start: Explanation, one: Explanation, evidence: Mapping[str, float], found: Sequence[Option], family: Family,
    settings: Settings,
) -> tuple[Explanation, dict[str, float]]:  # fmt: skip
    """A model with what its effects are rather (`Effect.rather`) in their place, where that explains as much.

    Args:
        evidence: of the names, nats.

    Returns:
        the model and the evidence, under the names that it has now.
    """
    known = dict(evidence)
    by_id = {o.effect.id: o for o in found}
    for effect_id in one.ids:
        other = rather(one, effect_id)
        if other not in by_id or other in one.ids:
            continue
        bare = without(start, one, effect_id, family)
        option = by_id[other].on(bare.study)
        if not option.tables:
            continue
        trial = try_option(Ground(bare.study.bench, bare.study.base), option, bare.study.ready)
        instead = explain(start, bare, trial, family)
        if instead is None or implausible(instead, other):
            continue
        instead = reshaped_again(start, instead, family)
        if instead.log_evidence > one.log_evidence - settings.nats_to_separate:
            one = instead
            known = {other if i == effect_id else i: odds for i, odds in known.items()}
    return one, known


def told_apart(
    start: Explanation, one: Explanation, evidence: Mapping[str, float], found: Sequence[Option], family: Family,
    settings: Settings,
) -> tuple[Explanation, dict[str, float]]:  # fmt: skip
    """A model with an effect of its own for what a part of another one is (`Effect.holds`), where that explains as much.

    Args:
        evidence: of the names, nats.

    Returns:
        the model, and the evidence of the names that it has now.
    """
    known = dict(evidence)
    by_id = {o.effect.id: o.effect for o in found}
    for term in one.added:
        held = term.effect.holds({n: e.value for n, e in term.estimates.items()})
        if held is None or held[0] not in by_id or held[0] in one.ids:
            continue
        other, values, part = held
        rest = Term(term.effect, {n: e for n, e in term.estimates.items() if n not in part})
        apart = Term(by_id[other], {n: Estimate(v) for n, v in values.items()})
        kept = tuple(rest if t is term else t for t in one.study.terms)
        try:
            study = study_of(one.study.observation, (*kept, apart))
        except SolveError:
            continue
        gained = borne_out(one.study, study)
        if gained < -settings.nats_to_prefer:
            continue
        rest_of = remainder_of(study, family, one.remainder.parts)
        one = Explanation(study.terms[len(start.study.terms) :], study, one.named + gained, rest_of)
        known[other] = known.get(term.effect.id, 0.0)
    return one, known
