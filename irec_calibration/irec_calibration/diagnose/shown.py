# SPDX-License-Identifier: Apache-2.0
"""The models that a diagnosis speaks of, each fitted to the session by itself: the figures that people see of them.

A diagnosis weighs its alternatives at one level of noise and with what completes the springs' form on all sides. What it says
of a model in the end must be what every other command says of it on the same session, so that is computed as they do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import find_effect
from ..identification.validation import gain
from ..model import Term
from ..session.data import Session
from .assessment import Assessment
from .forms import is_drift
from .held_out import Validated, held_out, validated
from .laws import laws
from .settings import SETTINGS
from .stand_in import StandIn, stand_ins
from .study import form_evidence, study_of


@dataclass(frozen=True)
class Shown:
    """Versions of a model.

    Attributes:
        asked: as it was asked about.
        form: ids of effects that complete the form of its springs; completed: with them, None where it is better without.
        form_evidence: log evidence for them, beside the effects that were added where these hide it.
        after: with every effect that was added, too; the best of the others where none was.
        without_form: `after` without the form, where that is better only beside the added effects; else None.
        stand_ins: effects and short laws that predict other poses but can't be named, each with `after` and those before it.
    """

    asked: Validated
    form: tuple[str, ...]
    form_evidence: float
    completed: Validated | None
    after: Validated
    without_form: Validated | None = None
    stand_ins: tuple[StandIn, ...] = ()

    @property
    def best(self) -> Validated:
        """The model that predicts best."""
        return self.stand_ins[-1].model if self.stand_ins else self.after

    @property
    def form_matters(self) -> bool:
        """Whether the session shows what completes the form; else the model has it because every robot has."""
        plain, whole = (self.asked, self.completed) if self.without_form is None else (self.without_form, self.after)
        return self.form_evidence > 0.0 and whole is not None and whole.held_out.rms_m < plain.held_out.rms_m


def shown_of(
    session: Session, asked: Validated, assessment: Assessment, check: Callable[[], None]
) -> tuple[Assessment, Shown]:
    """Fit what an assessment has found to the session; the assessment with the names that hold then, and the models.

    Args:
        session: as it was read; asked: the model that was asked about; check: raises where the work was cancelled.
    """
    shown = _named(session, asked, assessment, check)
    assessment = assessment.without_names(unproven(session, assessment, shown.after, check))
    if assessment.status == "adequate" and not assessment.usual_m:
        return assessment, shown
    effects = stand_ins(session, assessment.built, shown.after, check)
    found = laws(session, assessment, effects[-1].model if effects else shown.after, check)
    return assessment, replace(shown, stand_ins=(*effects, *found))


def unproven(session: Session, assessment: Assessment, after: Validated, check: Callable[[], None]) -> tuple[str, ...]:
    """Names none of whose parts is proven, and which may only describe some of what has no name.

    Much of what real robots have has none, and an effect with many parts may describe some of it. In a loaded session that is a
    name beside structure that is left, unless it explains far more of other poses than that; in an absolute one, a name without
    which other poses are predicted as well. Where a loaded session wanders by far more than an instrument does, a drift that
    explains less than wanders may be some of that, whatever is proven of it.

    Args:
        after: the model with all that was added.
    """
    out = []
    for name in assessment.names:
        parts, effect = assessment.parts.get(name), find_effect(name)
        if parts is None or effect.compliance_of:
            continue
        wanders = "wandering" in assessment.evidence and is_drift(effect)
        if not wanders and (parts.proven or (session.kind == "loaded" and (parts.one_of or not assessment.evidence))):
            continue
        check()
        without = validated(session, [t for t in after.study.terms if t.effect.id != name]).held_out.rms_m
        if session.kind == "loaded":
            explains = float(np.sqrt(max(without**2 - after.held_out.rms_m**2, 0.0)))
            least = assessment.remaining_m * (1.0 if wanders else SETTINGS.unproven_beside)
            falls = explains <= least or not assessment.remaining_m
        else:
            falls = after.held_out.rms_m > (1.0 - SETTINGS.absolute_gain) * without
        out += [name] if falls else []
    return tuple(out)


def _named(session: Session, asked: Validated, assessment: Assessment, check: Callable[[], None]) -> Shown:
    """The models with what is named."""
    start = assessment.built.start.study
    form = tuple(t.effect.id for t in start.terms[len(assessment.asked.terms) :])
    # what is missing may hide the form: without any effect that was added it has to show itself
    odds, completed = _with_form(session, asked, start.terms, must_show=bool(assessment.added)) if form else (0.0, None)
    check()
    if not assessment.added:
        return Shown(asked, form, odds, completed, completed or asked)
    final = assessment.study
    if completed is not None or not form:
        after = validated(session, final.terms)
        check()
        return Shown(asked, form, odds, completed, after)
    without = validated(session, [t for t in final.terms if t.effect.id not in form])
    check()
    beside, whole = _with_form(session, without, final.terms)
    check()
    if whole is not None:
        return Shown(asked, form, beside, None, whole, without)
    return Shown(asked, form, odds, None, without)


def _with_form(
    session: Session, plain: Validated, terms: Sequence[Term], must_show: bool = False
) -> tuple[float, Validated | None]:
    """Log evidence for what completes the form of a model's springs, and the model with it; None where it is better without.

    At the noise of the model without it, which the rows that stand out there do not spoil.

    Args:
        terms: of the model with it; must_show: it is better without unless evidence and held-out error ask for it.
    """
    beside = study_of(plain.study.observation, terms)
    odds = form_evidence(plain.study, beside)
    if odds <= (0.0 if must_show else -SETTINGS.nats_for_form):
        return odds, None
    whole = validated(session, terms)
    mean, se, _ = gain(plain.held_out, held_out(beside))
    worse = whole.held_out.rms_m >= plain.held_out.rms_m if must_show else mean < -SETTINGS.held_out_sigmas * se
    return odds, None if worse else whole
