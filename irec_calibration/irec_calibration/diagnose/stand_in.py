# SPDX-License-Identifier: Apache-2.0
"""An effect that predicts other poses although it can't be named: structure that has no name explains the session as well.

Somebody looks for a cause by its name, and a wrong one costs; a correction only needs to predict. So such an effect is part of
an improved model, said to stand in for what has no name. What predictions leave out can't stand in: it would only take from the
springs what they explain.
"""

from __future__ import annotations

import numpy as np

from ..effects import Cause, find_effect
from ..identification.validation import gain
from ..model import Term
from ..session.data import Session
from .build import Built
from .explanation import implausible, in_one_pose
from .held_out import Validated, validated
from .naming import needed
from .parts import prune
from .settings import SETTINGS, Settings


def stand_in(session: Session, built: Built, after: Validated, settings: Settings = SETTINGS) -> tuple[str, Validated | None]:
    """The effect that comes closest to what has no name, and the model with it; None where it does not help.

    It needs of its own what a name does: evidence over its absence, values that can be, and an error that falls on held-out
    poses. Only that nothing without a name explains as much is not asked. In loaded sessions; absolute ones have more that is
    neither named nor known to move the tool.

    Args:
        after: the model without it, as people are shown it.

    Raises:
        SolveError: the session can't be used with this model.
    """
    effect_id = _closest(built, settings)
    if not effect_id or built.closest is None:
        return "", None
    pruned = prune(built.closest.study, (effect_id,)).study
    term = next(t for t in pruned.terms if t.effect.id == effect_id)
    one = validated(session, (*after.study.terms, Term(term.effect, term.estimates)))
    mean, se, _ = gain(after.held_out, one.held_out)
    helps = np.isfinite(mean) and mean > settings.held_out_sigmas * se
    return (effect_id, one) if helps else ("", None)


def _closest(built: Built, settings: Settings) -> str:
    """The one effect by which the best name that was refused goes beyond what is named, where only its name is in doubt."""
    one, final = built.closest, built.final
    more = [i for i in one.ids if i not in final.ids] if one is not None else []
    if one is None or len(more) != 1 or len(one.ids) != len(final.ids) + 1:
        return ""
    if find_effect(more[0]).cause not in (Cause.LOAD, Cause.STATE) or built.start.study.ready.kind != "loaded":
        return ""
    if len(built.start.study.bench.poses) < settings.fewest_poses or in_one_pose(one, more[0]) or implausible(one, more[0]):
        return ""
    return more[0] if one.named - final.named >= needed(one, more[0], settings) else ""
