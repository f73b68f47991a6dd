# SPDX-License-Identifier: Apache-2.0
"""Two laws of the torque of the same gears: a curve of which neither has the form."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from ..effects import Family as Alike
from ..effects import find_effect, known_effects
from .part_sets import Parts


def mends_the_other(curve: Sequence[str], bounds: Mapping[str, str]) -> str:
    """Of two laws of one curve that which came to the bound at which the other begins, inside which that one is: it only mends
    that one's form; empty where there is none.

    Args:
        bounds: law -> `Effect.ends_at`.
    """
    drawn = [i for i in curve if bounds.get(i) in curve]
    return drawn[0] if len(drawn) == 1 else ""


def of_one_curve(names: Sequence[str], parts: Mapping[str, Parts], added: Collection[str]) -> tuple[str, ...]:
    """Of the names of a loaded session two laws of the torque (play, stiffening) of just the same axes, and laws that go with its
    history too (friction) where the model has none; empty where there are none.

    Play ends where stiffening begins. A gear that asks for both has a curve of its own, as friction with many thresholds makes
    one.
    """
    curves = [i for i in names if _is_law(i) and "order" not in find_effect(i).needs]
    for at, one in enumerate(curves):
        for other in curves[at + 1 :]:
            mine, theirs = (parts.get(i, Parts()).proven for i in (one, other))
            if mine and set(mine) == set(theirs):
                with_history = (i for i, e in known_effects().items() if _is_law(i) and "order" in e.needs and i not in added)
                return one, other, *with_history
    return ()


def of_one_step(names: Sequence[str], parts: Mapping[str, Parts]) -> tuple[str, ...]:
    """Of the names of an absolute session two that turn the same axes by the step just made; empty where there are none."""
    by_step = [i for i in names if {"step", "order"} & {*find_effect(i).needs}]
    for at, one in enumerate(by_step):
        for other in by_step[at + 1 :]:
            mine, theirs = (set(parts.get(i, Parts()).proven) for i in (one, other))
            if mine and theirs and (mine <= theirs or theirs <= mine):
                return one, other
    return ()


def _is_law(effect_id: str) -> bool:
    effect = find_effect(effect_id)
    return effect.family is Alike.TORQUE_LAW and not effect.by_angle
