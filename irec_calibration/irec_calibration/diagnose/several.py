# SPDX-License-Identifier: Apache-2.0
"""Several effects that stand together where no one of them stands by itself.

What several causes leave is often described better by structures without a name than by any one of the causes with a remainder.
So where structure is left, effects are taken in by evidence of their own, as far as it goes; then each has to stand beside the
others like any name. What is no effect of the catalogue does not end in a model of which nothing is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .candidates import Option
from .explanation import Explanation, in_one_pose
from .family import Family
from .naming import needed, why_not_by_itself
from .rivals import Check
from .settings import Settings
from .standing import standing
from .tries import step

Tried = dict[tuple[str, ...], tuple[Explanation, ...]]


@dataclass(frozen=True)
class Several:
    """Outcome.

    Attributes:
        model: with all names, none of those before lost; None where no more stand.
        evidence: of each name in it.
        near: effect taken in -> those that were about as good, each with its explanation then.
        tried: added effects of each model on the way -> what was fitted exactly on top of it.
    """

    model: Explanation | None
    evidence: dict[str, float]
    near: dict[str, dict[str, Explanation | None]]
    tried: Tried


def several_together(
    start: Explanation, current: Explanation, found: Sequence[Option], tried: Sequence[Explanation], family: Family,
    check: Check, settings: Settings,
) -> Several:  # fmt: skip
    """Take effects in by evidence of their own and keep those that stand together.

    Args:
        current: a model beside which no further effect stands; tried: what was fitted exactly on top of it.
    """
    way: Tried = {current.ids: tuple(tried)} if tried else {}
    near: dict[str, dict[str, Explanation | None]] = {}
    whole = current
    while whole.remainder.structures and len(whole.added) < settings.most_names:
        check()
        if whole.ids not in way:
            way[whole.ids] = tuple(step(start, whole, found, family, None, check, settings))
        following = _best(whole, way[whole.ids], settings)
        if following is None:
            break
        least = following.log_evidence - 2.0 * settings.nats_to_separate
        others = (t for t in way[whole.ids] if t is not following and t.log_evidence > least)
        near[following.ids[-1]] = {t.ids[-1]: t for t in others}
        whole = following
    if len(whole.added) < len(current.added) + 2:  # one by itself was refused
        return Several(None, {}, near, way)
    kept, evidence = standing(start, whole, family, settings)
    more = set(kept.ids) > set(current.ids) and kept.log_evidence - current.log_evidence > settings.nats_to_separate
    return Several(kept if more else None, evidence, near, way)


def _best(whole: Explanation, tried: Sequence[Explanation], settings: Settings) -> Explanation | None:
    """The effect with the most evidence over its absence, at values that can be, that helps on held-out poses."""
    for one in sorted(tried, key=lambda e: -e.named):
        own = one.named - whole.named
        if in_one_pose(one, one.ids[-1]) or own < needed(one, one.ids[-1], settings):
            continue
        if not why_not_by_itself(whole, one, own, settings):
            return one
    return None
