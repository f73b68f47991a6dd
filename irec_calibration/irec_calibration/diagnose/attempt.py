# SPDX-License-Identifier: Apache-2.0
"""One effect on top of a model that is prepared already: at once in the linear problem, then exactly."""

from __future__ import annotations

from dataclasses import dataclass

from ..effects import Effect, Evidence
from ..errors import EffectError
from ..identification.validation import HeldOut
from ..model import Estimate, Model, Term
from ..session.data import Session
from ..typing import Array
from .candidates import Trial, try_effect
from .expected_error import with_error
from .held_out import held_out, validated
from .improve import add_effect, versioned
from .parts import prune
from .shape import refit
from .study import Study


@dataclass(frozen=True)
class Attempt:
    """What an effect would do, everything refitted jointly in the linear problem about the model.

    Attributes:
        term: the effect with its values; residual: of the observed rows, (m, 3), m; before, after: held-out error.
    """

    term: Term
    residual: Array
    before: HeldOut
    after: HeldOut
    trial: Trial

    @property
    def effect(self) -> Effect:
        return self.term.effect


def attempt(study: Study, effect: Effect) -> Attempt:
    """Try an effect on top of a prepared model; answers within some milliseconds where the effect is linear.

    Raises:
        EffectError: the effect can't be seen in this session.
    """
    if not effect.completes:
        study = study.to_weigh
    why = study.why_not(effect)
    trial = None if why else try_effect(study, effect)
    if trial is None:
        raise EffectError(f"'{effect.id}' can't be seen in this session: {why or 'it moves nothing in it'}")
    block = study.base + trial.best.block
    posterior = study.bench.posterior(block)
    white = study.bench.b - block.A @ posterior.x
    residual = study.observation.whiten.undo(white.reshape(-1, 3))
    values = posterior.x[-len(trial.best.names) :] * trial.best.scale
    units = {p.name: p.unit for p in effect.parameters(study.ready)}
    named = dict(zip(trial.best.names, values, strict=True)) | trial.best.shape
    term = Term(effect, {n: Estimate(float(v), unit=units.get(n, "")) for n, v in named.items()})
    return Attempt(term, residual, held_out(study), held_out(study, trial.best.block), trial)


def added(session: Session, study: Study, parent: Model, effect: Effect, tried: Attempt | None) -> tuple[Model, Study, Study]:
    """As `add_effect`, on what is prepared and tried already: model, study of the old effects, study of the new ones.

    Raises:
        EffectError: as of `add_effect`.
    """
    if tried is None or effect.evidence is Evidence.REFERENCE_READINGS:
        return add_effect(parent, effect, session)
    found = refit(study.to_weigh, tried.trial)
    if found is None:
        raise EffectError(f"'{effect.id}' could not be fitted together with {', '.join(parent.effects)}")
    pruned = prune(found, (effect.id,))
    made = validated(session, pruned.study.terms)
    new = versioned(made, parent, f"added {effect.id}", pruned.parts)
    return with_error(new, made.expected_error), study, made.study
