# SPDX-License-Identifier: Apache-2.0
"""The changes of a robot over the years that a quick check must not miss, each as a displacement per row.

A change is stated at the size that it must be found at: an axis 10 % softer, gear play of 100 urad, a base that has come loose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..effects import Parameter, find_effect
from ..effects.scene import Scene
from ..errors import EffectError
from ..model import Term, prepared, regressors
from ..typing import Array

WELL_KNOWN = 0.3  # standard error of a compliance relative to its value
SOFTER = 0.10  # share of an axis' compliance
PLAY = 1.0e-4  # rad, of one gear
LOOSE_ROTATION = 3.0e-8  # rad/(N m) of the base: 8 % of the deflection of a 120 kg robot on its rail
LOOSE_TRANSLATION = 3.0e-9  # m/N


@dataclass(frozen=True)
class Change:
    """One change of the robot at the size at which it must be found.

    Attributes:
        effect, part: effect that describes it, and its part (`axis 3`).
        words: in plain words, with a place for the amount, e.g. `axis 3: {:.0f} % softer`. amount: of this change, in that unit.
        displacement: of the observed point, relative to what the model in force says, (n, 3), m, in base_link.
    """

    effect: str
    part: str
    words: str
    amount: float
    displacement: Array

    @property
    def name(self) -> str:
        """In plain words at its size, e.g. `axis 3: 10 % softer`."""
        return self.text(1.0)

    def text(self, multiple: float) -> str:
        """In plain words at a multiple of its size."""
        return self.words.format(multiple * self.amount)


def changes(terms: Sequence[Term], scene: Scene) -> tuple[Change, ...]:
    """Every change that the rows of a scene could show.

    Args:
        terms: of the model in force.
        scene: rows whose marker is observed; n rows.
    """
    out: list[Change] = []
    for parameter, column in _columns("joint_torsion", terms, scene):
        axis = f"axis {parameter.name.rpartition('_')[2]}"
        compliance = _value(terms, "joint_torsion", parameter)
        words = axis + ": {:.0f} % softer"
        out.append(Change("joint_torsion", axis, words, 100 * SOFTER, SOFTER * compliance * column))
    for parameter, column in _columns("joint_backlash", terms, scene):
        axis = f"axis {parameter.name.rpartition('_')[2]}"
        out.append(Change("joint_backlash", axis, axis + ": play of {:.0f} urad", 1e6 * PLAY, PLAY * column))
    for parameter, column in _columns("base_compliance", terms, scene):
        direction = parameter.name.rpartition("_")[2]
        if "rad" in parameter.unit:
            words, size, amount = f"base: tilts {{:.2f}} mrad/(kN m) more about {direction}", LOOSE_ROTATION, 1e6 * LOOSE_ROTATION
        else:
            words, size = f"base: gives way {{:.0f}} um/kN more along {direction}", LOOSE_TRANSLATION
            amount = 1e9 * LOOSE_TRANSLATION
        out.append(Change("base_compliance", parameter.name, words, amount, size * column))
    return tuple(out)


def never_shown(found: Sequence[Change], axes: int) -> list[str]:
    """What the rows that `found` belongs to can't show at all: softer axes, play, base; in plain words."""
    parts = {effect: {c.part for c in found if c.effect == effect} for effect in ("joint_torsion", "joint_backlash")}
    out = []
    for effect, words in (("joint_torsion", "softer"), ("joint_backlash", "play")):
        missing = [str(k + 1) for k in range(axes) if f"axis {k + 1}" not in parts[effect]]
        if missing:
            out.append(f"{words} in axis {' and '.join([', '.join(missing[:-1]), missing[-1]] if missing[1:] else missing)}")
    return out


def _columns(effect_id: str, terms: Sequence[Term], scene: Scene) -> list[tuple[Parameter, Array]]:
    """Displacement per unit of each linear parameter of an effect beside the terms, (n, 3) each; none where it can't act."""
    others = [t for t in terms if t.effect.id != effect_id]
    try:
        term = Term(find_effect(effect_id))
        parameters = term.effect.parameters(prepared(others, scene))
        block = regressors([*others, term], scene)[-1]
    except EffectError:
        return []
    return [(p, block[:, :, i]) for i, p in enumerate(parameters) if not p.grid and np.any(block[:, :, i])]


def _value(terms: Sequence[Term], effect_id: str, parameter: Parameter) -> float:
    """The compliance in force where it is known singly; else at least the typical one of such an axis."""
    for term in terms:
        if term.effect.id == effect_id and parameter.name in term.estimates:
            e = term.estimates[parameter.name]
            return e.value if e.se < WELL_KNOWN * e.value else max(e.value, parameter.scale)
    return parameter.scale
