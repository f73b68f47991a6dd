# SPDX-License-Identifier: Apache-2.0
"""The models that a diagnosis speaks of, each fitted to the session by itself: the figures that people see of them.

A diagnosis weighs its alternatives at one level of noise and with what completes the springs' form on all sides. What it says
of a model in the end must be what every other command says of it on the same session, so that is computed as they do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..session.data import Session
from .assessment import Assessment
from .held_out import Validated, validated
from .study import form_evidence, study_of


@dataclass(frozen=True)
class Shown:
    """Three versions of a model.

    Attributes:
        asked: as it was asked about.
        form: ids of effects that complete the form of its springs; completed: with them, None where they earn nothing here.
        form_evidence: log evidence for them, beside the effects that were added where these hide it.
        after: with every effect that was added, too; the best of the others where none was.
        without_form: `after` without the form, where that earns something only beside the added effects; else None.
    """

    asked: Validated
    form: tuple[str, ...]
    form_evidence: float
    completed: Validated | None
    after: Validated
    without_form: Validated | None = None


def shown_of(session: Session, asked: Validated, assessment: Assessment, check: Callable[[], None]) -> Shown:
    """Fit what an assessment has found to the session.

    Args:
        session: as it was read; asked: the model that was asked about; check: raises where the work was cancelled.
    """
    start = assessment.built.start.study
    form = tuple(t.effect.id for t in start.terms[len(assessment.asked.terms) :])
    odds = form_evidence(assessment.asked, start)
    completed = None
    if form and odds > 0.0:
        whole = validated(session, start.terms)
        completed = whole if whole.held_out.rms_m < asked.held_out.rms_m else None
        check()
    if not assessment.added:
        return Shown(asked, form, odds, completed, completed or asked)
    final = assessment.study
    if completed is not None or not form:
        after = validated(session, final.terms)
        check()
        return Shown(asked, form, odds, completed, after)
    # what is missing in the model that was asked about may have hidden the form
    bare = [t for t in final.terms if t.effect.id not in form]
    without = validated(session, bare)
    check()
    beside = form_evidence(study_of(final.observation, bare), final)
    if beside > 0.0:
        whole = validated(session, final.terms)
        check()
        if whole.held_out.rms_m < without.held_out.rms_m:
            return Shown(asked, form, beside, None, whole, without)
    return Shown(asked, form, odds, None, without)
