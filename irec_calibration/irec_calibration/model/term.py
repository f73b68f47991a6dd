# SPDX-License-Identifier: Apache-2.0
"""One effect of a model with its parameters by name and what is known of them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects import Axes, Effect, Parameter, find_effect, parameters_of
from ..effects.scene import Scene
from ..errors import ModelError
from ..typing import Array

NO_UNIT = ("1", "0 or 1", "0, 1/2 or 1")


@dataclass(frozen=True)
class Estimate:
    """One parameter's value.

    Attributes:
        se: standard error, in the parameter's unit; NaN where only a combination with others is known or none was computed.
        identified: the single value is known, not only a combination.
        held: known from elsewhere, displacements being blind to it; a fit leaves it as it is.
    """

    value: float
    se: float = math.nan
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    identified: bool = True
    held: bool = False

    def __str__(self) -> str:
        error = f" +- {self.se:.2g}" if math.isfinite(self.se) else ""
        unit = self.unit if self.unit not in NO_UNIT else ""
        return f"{as_known(self.value, self.se)}{error} {unit}".rstrip()


@dataclass(frozen=True)
class Term:
    """One effect of a model with its parameters by name.

    Raises:
        ModelError: a parameter is of an earlier form of the effect, whose values mean something else now.
    """

    effect: Effect
    estimates: dict[str, Estimate] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.estimates:
            if any(re.fullmatch(pattern, name) for pattern in self.effect.obsolete):
                raise ModelError(
                    f"effect '{self.effect.id}': parameter '{name}' is of an earlier form of this effect;"
                    " identify the model again"
                )

    def theta(self, parameters: Iterable[Parameter]) -> Array:
        """Values in the order of `parameters`; the start value where the model does not name one, (p,)."""
        return np.array([self.estimates[p.name].value if p.name in self.estimates else p.start for p in parameters])

    def whole(self, parameters: Iterable[Parameter]) -> Term:
        """The same with all parameters, those that it does not name at their start; as it is where it names none (all then)."""
        if not self.estimates:
            return self
        named = {p.name: self.estimates.get(p.name, Estimate(p.start, unit=p.unit)) for p in parameters}
        return replace(self, estimates=named)

    def free(self, parameters: Sequence[Parameter]) -> list[int]:
        """Indices of the parameters that a fit may change: those that the term names (all where it names none), without a
        grid, and not held."""
        named = {p.name for p in parameters} & set(self.estimates)
        held = {n for n, e in self.estimates.items() if e.held}
        return [i for i, p in enumerate(parameters) if not p.grid and p.name not in held and (not named or p.name in named)]


def as_known(value: float, se: float) -> str:
    """A value to the second digit of its standard error; four digits where there is none."""
    if not (math.isfinite(se) and se > 0.0 and math.isfinite(value)):
        return f"{value:.4g}"
    place = math.floor(math.log10(se)) - 1
    whole = round(value / 10.0**place)
    return f"{whole * 10.0**place:.{min(max(len(str(abs(whole))), 1), 7)}g}" if whole else "0"


def blank_model(effects: Sequence[str]) -> tuple[Term, ...]:
    """Terms without values, for a first fit. Raises EffectError for an unknown id."""
    return tuple(Term(find_effect(e)) for e in effects)


def axis_compliances(terms: Sequence[Term], scene: Scene) -> dict[int, Estimate]:
    """Compliances of actuated axes that are known singly, with their standard errors: joint (from 0) -> estimate."""
    return {
        p.axis: term.estimates[p.name]
        for term in terms
        if term.effect.compliance_of is Axes.ACTUATED
        for p in parameters_of(term.effect, scene)
        if p.axis is not None and p.name in term.estimates
        if term.estimates[p.name].identified and math.isfinite(term.estimates[p.name].se)
    }
