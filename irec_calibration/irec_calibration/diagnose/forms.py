# SPDX-License-Identifier: Apache-2.0
"""Structures that an effect is a special form of: they are no rivals of its name, whatever form they give the same cause."""

from __future__ import annotations

from dataclasses import dataclass

from ..effects import Cause, Effect
from ..effects import Family as Alike
from ..effects.joint_ripple import FEWEST
from ..effects.scene import Scene
from ..effects.thermal_drift import LEANING, OF_ARM
from ..model import Term
from .family import Structure


@dataclass(frozen=True)
class Forms:
    """Which structures.

    Attributes:
        axes: general laws of the torque of these axes; turns: of axes whose compliance goes with their own angle; tilts: links
            that tilt across their axis; drifts: what follows time or a temperature whatever the force; steps: general laws of the
            step just made by these axes; angles: general laws by which these axes turn with their own angle; histories: with the
            torque that they bore before.
    """

    axes: frozenset[int] = frozenset()
    drifts: bool = False
    tilts: bool = False
    turns: frozenset[int] = frozenset()
    steps: frozenset[int] = frozenset()
    angles: frozenset[int] = frozenset()
    histories: frozenset[int] = frozenset()

    def __bool__(self) -> bool:
        return bool(self.axes or self.turns or self.steps or self.angles or self.histories) or self.drifts or self.tilts

    def has(self, structure: Structure) -> bool:
        law = structure.law_of is not None and structure.law_of in self.axes
        law = law or (structure.softer_by_angle is not None and structure.softer_by_angle in self.turns)
        law = law or (structure.by_step and structure.axis in self.steps)
        law = law or _by_own_angle(structure) in self.angles or structure.history_of in self.histories
        return law or (self.drifts and structure.is_drift) or (self.tilts and structure.is_tilt)


NO_FORMS = Forms()


def forms_of(term: Term, scene: Scene) -> Forms:
    """Structures that an effect is a special form of."""
    if is_drift(term.effect):
        return Forms(drifts=True)
    axes, none = _axes(term, scene), frozenset[int]()
    law = term.effect.family is Alike.TORQUE_LAW
    angles = axes if term.effect.turns_by_angle and scene.kind == "absolute" else none
    turns = axes if law and term.effect.by_angle else none
    histories = axes if law and "order" in term.effect.needs and scene.kind == "loaded" else none
    of_torque = axes if law and not term.effect.by_angle else none
    return Forms(of_torque, turns=turns, steps=steps(term, scene), angles=angles, histories=histories)


def is_drift(effect: Effect) -> bool:
    """Whether an effect passes with time or a temperature, whatever the force."""
    return effect.cause is Cause.TIME and effect.family is Alike.TIME


def _by_own_angle(structure: Structure) -> int | None:
    """The axis, counted from 0, that a structure turns by a smooth law of its own angle, whatever the load; None: it does not."""
    if structure.ripple is not None:  # one that hardly repeats is smooth
        joint, often = structure.ripple
        return joint if often < FEWEST else None
    plain = structure.law_of is None and structure.softer_by_angle is None and not structure.by_step
    own = plain and structure.axis is not None and structure.variables == (f"joint_{structure.axis + 1}",)
    return structure.axis if own else None


def follows_step(effect: Effect, scene: Scene) -> bool:
    """Whether an effect turns an axis by a law of the step just made: where no load acts, all that history leaves."""
    return scene.kind == "absolute" and ("step" in effect.needs or "order" in effect.needs)


def steps(term: Term, scene: Scene) -> frozenset[int]:
    """Axes that an effect turns by a law of the step just made."""
    return _axes(term, scene) if follows_step(term.effect, scene) else frozenset()


def has_form_of(structure: Structure, term: Term, scene: Scene) -> bool:
    """Whether a structure turns or moves what an effect does by what the effect follows: it may only mend its form."""
    by_step = structure.by_step and ("step" in term.effect.needs or "order" in term.effect.needs)
    return forms_of(term, scene).has(structure) or (by_step and structure.axis in _axes(term, scene))


def bends(term: Term, scene: Scene) -> frozenset[int]:
    """Axes of which an effect bends the curve of angle over torque, whatever was before."""
    return frozenset() if "order" in term.effect.needs else forms_of(term, scene).axes


def courses(term: Term, scene: Scene) -> frozenset[str]:
    """Variables, time or temperatures, that a drift follows."""
    if not forms_of(term, scene).drifts:
        return frozenset()
    groups = {p.group for p in term.effect.parameters(scene) if p.name in term.estimates}
    found = {g.removesuffix(OF_ARM).removesuffix(LEANING) for g in groups}
    return frozenset("stamp" if g == "time" else g for g in found if g == "time" or g.startswith("temp_"))


def _axes(term: Term, scene: Scene) -> frozenset[int]:
    own = term.effect.parameters(scene)
    return frozenset(p.axis for p in own if p.axis is not None and p.name in term.estimates)
