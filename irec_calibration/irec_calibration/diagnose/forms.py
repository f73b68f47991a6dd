# SPDX-License-Identifier: Apache-2.0
"""Structures that an effect is a special form of: they are no rivals of its name, whatever form they give the same cause."""

from __future__ import annotations

from dataclasses import dataclass

from ..effects import Cause
from ..effects import Family as Alike
from ..effects.scene import Scene
from ..model import Term
from .family import Structure


@dataclass(frozen=True)
class Forms:
    """Which structures.

    Attributes:
        axes: general laws of the torque of these axes; turns: of axes whose compliance goes with their own angle; tilts: links
            that tilt across their axis; drifts: what follows time or a temperature whatever the force.
    """

    axes: frozenset[int] = frozenset()
    drifts: bool = False
    tilts: bool = False
    turns: frozenset[int] = frozenset()

    def __bool__(self) -> bool:
        return bool(self.axes) or bool(self.turns) or self.drifts or self.tilts

    def has(self, structure: Structure) -> bool:
        law = structure.law_of is not None and structure.law_of in self.axes
        law = law or (structure.softer_by_angle is not None and structure.softer_by_angle in self.turns)
        return law or (self.drifts and structure.is_drift) or (self.tilts and structure.is_tilt)


NO_FORMS = Forms()


def forms_of(term: Term, scene: Scene) -> Forms:
    """Structures that an effect is a special form of."""
    if term.effect.cause is Cause.TIME and term.effect.family is Alike.TIME:
        return Forms(drifts=True)
    if term.effect.family is not Alike.TORQUE_LAW:
        return NO_FORMS
    own = term.effect.parameters(scene)
    axes = frozenset(p.axis for p in own if p.axis is not None and p.name in term.estimates)
    return Forms(axes, turns=axes if term.effect.by_angle else frozenset())


def bends(term: Term, scene: Scene) -> frozenset[int]:
    """Axes of which an effect bends the curve of angle over torque, whatever was before."""
    return frozenset() if "order" in term.effect.needs else forms_of(term, scene).axes
