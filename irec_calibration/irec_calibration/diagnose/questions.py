# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis leaves open, as pairs of fitted models of which one is right: what more measurements are to tell."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.special import expit

from ..effects.traits import Evidence
from .assessment import Assessment
from .explanation import Explanation
from .settings import SETTINGS
from .study import Study, study_of

FIRST = 3  # effects that might be there and have no evidence to be named yet, likeliest first


@dataclass(frozen=True)
class Question:
    """Two models of a session of which one is right.

    Attributes:
        names: effects (or sets of axes) that the first and the second has in place of each other; empty second: nothing.
        one, other: fitted models.
        lacks: evidence that is still needed to answer, nats: where the first is right, and where the second is.
        first: probability that the first is right.
    """

    names: tuple[str, str]
    one: Study
    other: Study
    lacks: tuple[float, float]
    first: float = 0.5

    @property
    def is_presence(self) -> bool:
        """Whether an effect is there at all."""
        return not self.names[1]


def questions(assessment: Assessment) -> tuple[Question, ...]:
    """The questions that a diagnosis leaves open: effects (then axes) that are not told apart; where there are none, effects that
    may be there and lack evidence. Empty where nothing is in question."""
    return (*_rivals(assessment), *_axes(assessment)) or _presence(assessment)


def _rivals(assessment: Assessment) -> tuple[Question, ...]:
    built = assessment.built
    out = []
    for name, rivals in built.rivals.items():
        for rival, odds in rivals if name not in assessment.usual else ():
            found = built.rival_models.get((name, rival))
            if found is not None:
                # of either, where it is the right one
                asked = max(SETTINGS.nats_to_name, SETTINGS.nats_over_rival + found.share * found.own)
                lacks = (max(asked - found.odds, 0.0), max(asked + found.odds, 0.0))
                out.append(Question((name, rival), built.final.study, found.model.study, lacks, float(expit(odds))))
    return tuple(out)


def _axes(assessment: Assessment) -> tuple[Question, ...]:
    if assessment.other is None:
        return ()
    terms, names = assessment.other
    study = assessment.study
    needed = SETTINGS.nats_to_separate
    return (Question(names, study, study_of(study.observation, terms), (needed, needed)),)


def _presence(assessment: Assessment) -> tuple[Question, ...]:
    built = assessment.built
    final = built.final
    tried = [*(built.singles if not final.added else ()), *built.tried.get(final.ids, ())]
    if built.closest is not None:
        tried.append(built.closest)
    best: dict[str, Explanation] = {}
    for one in tried:
        new = set(one.ids) - set(final.ids)
        if len(new) != 1 or not set(final.ids) < set(one.ids) or one.named <= final.named:
            continue
        effect_id = new.pop()
        if one.term(effect_id).effect.evidence is Evidence.ONE_POSE and one.study.ready.kind == "loaded":
            continue  # no other pose has it
        if effect_id not in best or one.named > best[effect_id].named:
            best[effect_id] = one
    likeliest = sorted(best.items(), key=lambda item: -item[1].named)[:FIRST]
    needed = SETTINGS.nats_to_name
    return tuple(
        Question((i, ""), one.study, final.study, (max(needed - (one.named - final.named), 0.0), needed)) for i, one in likeliest
    )
