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
from .study import form_evidence


@dataclass(frozen=True)
class Shown:
    """Three versions of a model.

    Attributes:
        asked: as it was asked about.
        form: ids of effects that complete the form of its springs; completed: with them, None where they earn nothing here.
        form_evidence: log evidence for them. after: with every effect that was added, too; the best of the others where none was.
    """

    asked: Validated
    form: tuple[str, ...]
    form_evidence: float
    completed: Validated | None
    after: Validated


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
    after = completed or asked
    if assessment.added:
        kept = [t for t in assessment.study.terms if completed is not None or t.effect.id not in form]
        after = validated(session, kept)
        check()
    return Shown(asked, form, odds, completed, after)
