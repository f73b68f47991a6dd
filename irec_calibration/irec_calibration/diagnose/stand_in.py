# SPDX-License-Identifier: Apache-2.0
"""An effect that predicts other poses although it can't be named: structure that has no name explains the session as well, or
its evidence is too small for a name.

Somebody looks for a cause by its name, and a wrong one costs; a correction only needs to predict. So such an effect is part of
an improved model, said to stand in for what has no name. What predictions leave out can't stand in: it would only take from the
springs what they explain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from ..effects import Effect, find_effect, is_predicted
from ..effects.joint_ripple import MOST, JointRipple
from ..identification.validation import gain
from ..model import Estimate, Term
from ..session.data import Session
from .build import Built
from .explanation import Explanation, implausible, in_one_pose
from .held_out import Validated, held_out_beside, validated
from .naming import needed
from .parts import prune
from .priors import FACTORS
from .settings import SETTINGS, Settings
from .study import study_of
from .tries import step


@dataclass(frozen=True)
class StandIn:
    """An effect that predicts what has no name.

    Attributes:
        effect: what it is; evidence: log evidence of its own, over its absence; model: with it and all before it.
    """

    effect: Effect
    evidence: float
    model: Validated


def stand_ins(
    session: Session, built: Built, after: Validated, check: Callable[[], None], settings: Settings = SETTINGS
) -> tuple[StandIn, ...]:
    """The effects that stand in for what has no name, one on top of the other, each with the model that has it.

    Where structure is left, each needs of its own what a name does: evidence over its absence, values that can be, and an error
    that falls on held-out poses. Only that nothing without a name explains as much is not asked. Where none is left, evidence is
    what it says, and an effect is taken in that is likelier there than not: of all sets of effects that one predicts best
    (median probability model, Barbieri and Berger 2004).

    Args:
        after: the model without them, as people are shown it; check: raises where the work was cancelled.

    Raises:
        SolveError: the session can't be used with this model.
    """
    out: list[StandIn] = []
    if len(built.start.study.bench.poses) < settings.fewest_poses:
        return ()
    current = built.final
    check()
    ripple = _ripple(session, built, after, check, settings)
    if ripple is not None:
        out.append(ripple)
    while len(current.added) < settings.most_names:
        tried = built.tried.get(current.ids) or step(built.start, current, built.possible, built.family, None, check, settings)
        found = _best(tried, current, out[-1].model if out else after, session, check, settings)
        if found is None:
            break
        current, one = found
        out.append(one)
    return tuple(out)


def _ripple(
    session: Session, built: Built, before: Validated, check: Callable[[], None], settings: Settings
) -> StandIn | None:  # fmt: skip
    """What repeats many times per turn of joints, where what is left shows it and it helps.

    Its lower orders pass for wrong links where a joint was measured at few angles; a joint that it would turn too far has none.
    """
    found = [p.structure.ripple for p in built.final.remainder.structures if p.structure.ripple is not None]
    axes = {k for k, often in found if often <= MOST}
    effect, scene = JointRipple(), built.start.study.ready
    while axes:
        check()
        own = {p.name: Estimate(0.0, unit=p.unit) for p in effect.parameters(scene) if p.axis in axes}
        terms = (*before.study.terms, Term(effect, own))
        beside = study_of(before.study.observation, terms)
        with_it, without_it = (s.bench.posterior(s.base).log_evidence for s in (beside, before.study))
        odds = float(with_it - without_it) - log(len(FACTORS))
        if odds < settings.nats_to_name:
            return None
        check()
        made = validated(session, terms)
        there = made.study.ready
        theta = next(t for t in made.study.terms if t.effect is effect).theta(effect.parameters(there))
        too_far = effect.too_far(there, theta)
        if not too_far:
            return StandIn(effect, odds, made) if _helps(before, made, settings.held_out_sigmas) else None
        axes -= too_far
    return None


def _best(
    tried: Sequence[Explanation], current: Explanation, before: Validated, session: Session, check: Callable[[], None],
    settings: Settings,
) -> tuple[Explanation, StandIn] | None:  # fmt: skip
    """The effect with the most evidence of its own of which only the name is in doubt, if it helps on held-out poses."""
    sigmas = settings.held_out_sigmas if current.remainder.structures else 0.0
    could = [e for e in tried if _may(e) and e.named - current.named >= _least(current, e, settings)]
    for one in sorted(could, key=lambda e: -e.named):
        check()
        effect_id = one.ids[-1]
        term = next(t for t in prune(one.study, (effect_id,)).study.terms if t.effect.id == effect_id)
        made = validated(session, (*before.study.terms, Term(term.effect, term.estimates)))
        if _helps(before, made, sigmas):
            return one, StandIn(term.effect, one.named - current.named, made)
    return None


def _helps(before: Validated, made: Validated, sigmas: float) -> bool:
    """Whether a model is better than the one before, on held-out poses by some standard errors: a fit need not reach what the
    linear problem promises."""
    mean, se, _ = gain(before.held_out, held_out_beside(before.study, made.study))
    confirmed = made.study.fit.rms < before.study.fit.rms and made.held_out.rms_m < before.held_out.rms_m
    return bool(confirmed and np.isfinite(mean) and mean > sigmas * se)


def _least(current: Explanation, one: Explanation, settings: Settings) -> float:
    """Evidence that an effect needs of its own on top of a model."""
    return needed(one, one.ids[-1], settings) if current.remainder.structures else settings.nats_to_stand_in


def _may(one: Explanation) -> bool:
    """Whether predictions have an effect, at values that can be, and more than one pose shows it."""
    effect_id = one.ids[-1]
    if not is_predicted(find_effect(effect_id).cause, one.study.session.kind):
        return False
    return not in_one_pose(one, effect_id) and not implausible(one, effect_id)
