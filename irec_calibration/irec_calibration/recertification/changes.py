# SPDX-License-Identifier: Apache-2.0
"""The changes of a robot over the years that a quick check must not miss, each as a displacement per row.

Which there are, and the size at which each must be found, say the effects themselves (`Effect.ageing`): an axis 10 % softer,
gear play of 100 urad, a base that has come loose.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..effects import Ageing, Effect, Parameter, known_effects
from ..effects.scene import Scene
from ..errors import EffectError
from ..model import Estimate, Term, prepared, regressors
from ..typing import Array

WELL_KNOWN = 0.3  # standard error of a compliance relative to its value


@dataclass(frozen=True)
class Change:
    """One change of the robot at the size at which it must be found.

    Attributes:
        effect: id of the effect that describes it. part: axis that it is in, e.g. `axis 3`; empty where it is in none.
        ageing: what the effect says about it.
        displacement: of the observed point, relative to what the model in force says, (n, 3), m, in base_link.
    """

    effect: str
    part: str
    ageing: Ageing
    displacement: Array

    @property
    def name(self) -> str:
        """In plain words at its size, e.g. `axis 3: 10 % softer`."""
        return self.text(1.0)

    def text(self, multiple: float) -> str:
        """In plain words at a multiple of its size."""
        return self.ageing.words.format(multiple * self.ageing.amount)


def changes(terms: Sequence[Term], scene: Scene, way: int | None = None) -> tuple[Change, ...]:
    """Every change that the rows of a scene could show; those of single axes first.

    How an effect goes on its grids (over what range of torque play is taken up) nobody knows of a change that has not come yet.

    Args:
        terms: of the model in force.
        scene: rows whose marker is observed; n rows.
        way: which of the values on the grids, see `ways`; None: those with which these rows show least of it.
    """
    in_axes: list[Change] = []
    others: list[Change] = []
    for effect, aged in _ageing(terms, scene):
        columns = _columns(effect, terms, scene, way)
        for parameter, ageing in aged:
            if parameter.name not in columns:
                continue
            size = ageing.size * _value(terms, effect.id, parameter) if ageing.relative else ageing.size
            part = "" if parameter.axis is None else parameter.group
            change = Change(effect.id, part, ageing, size * columns[parameter.name])
            (others if parameter.axis is None else in_axes).append(change)
    return (*in_axes, *others)


def ways(terms: Sequence[Term], scene: Scene) -> int:
    """How many ways there are, at the most, in which a change may go on the grids of its effect."""
    return max([len(list(_on_grids(effect, scene))) for effect, _ in _ageing(terms, scene)], default=1)


def never_shown(found: Sequence[Change], terms: Sequence[Term], scene: Scene) -> list[str]:
    """What the rows that `found` belongs to can't show at all of single axes: softer, play; in plain words."""
    shown = {(c.effect, c.ageing.parameter) for c in found}
    missing: dict[str, list[str]] = {}
    for effect, aged in _ageing(terms, scene):
        for parameter, ageing in aged:
            if parameter.axis is not None and (effect.id, parameter.name) not in shown:
                missing.setdefault(ageing.fault, []).append(str(parameter.axis + 1))
    return [f"{fault} in axis {' and '.join([', '.join(k[:-1]), k[-1]] if k[1:] else k)}" for fault, k in missing.items()]


def _ageing(terms: Sequence[Term], scene: Scene) -> list[tuple[Effect, list[tuple[Parameter, Ageing]]]]:
    """The effects that say how a robot ages, as the model in force has them where it does, with what they say."""
    in_model = {t.effect.id: t.effect for t in terms}
    out = []
    for effect in {**known_effects(), **in_model}.values():
        try:
            aged = {a.parameter: a for a in effect.ageing(scene)}
            if aged:
                out.append((effect, [(p, aged[p.name]) for p in effect.parameters(scene) if p.name in aged]))
        except EffectError:  # it can't act on this robot
            continue
    return out


def _on_grids(effect: Effect, scene: Scene) -> Iterator[dict[str, Estimate]]:
    grids = [p for p in effect.parameters(scene) if p.grid]
    for values in product(*((p.start,) if p.kinds else p.grid for p in grids)):  # of kinds the plain one
        yield {p.name: Estimate(v) for p, v in zip(grids, values, strict=True)}


def _columns(effect: Effect, terms: Sequence[Term], scene: Scene, way: int | None) -> dict[str, Array]:
    """Displacement per unit of each linear parameter of an effect beside the other terms, (n, 3); none where it can't act."""
    others = [t for t in terms if t.effect.id != effect.id]
    try:
        ready = prepared(others, scene)
        parameters, on_grids = effect.parameters(ready), list(_on_grids(effect, ready))
        if way is not None:
            on_grids = [on_grids[way % len(on_grids)]]
        blocks = [regressors([*others, Term(effect, estimates)], scene)[-1] for estimates in on_grids]
    except EffectError:
        return {}
    linear = [i for i, p in enumerate(parameters) if not p.grid]
    block = min(blocks, key=lambda b: float(np.linalg.norm(scene.change(b[:, :, linear]))))
    return {parameters[i].name: block[:, :, i] for i in linear if np.any(block[:, :, i])}


def _value(terms: Sequence[Term], effect_id: str, parameter: Parameter) -> float:
    """The compliance in force where it is known singly; else at least the typical one of such an axis."""
    for term in terms:
        if term.effect.id == effect_id and parameter.name in term.estimates:
            e = term.estimates[parameter.name]
            return e.value if e.se < WELL_KNOWN * e.value else max(e.value, parameter.scale)
    return parameter.scale
