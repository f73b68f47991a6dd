# SPDX-License-Identifier: Apache-2.0
"""Whether the data support an effect that was added, in one sentence: for the terminal, the page and the workbench alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..effects import Parameter
from ..identification.validation import HeldOut, gain
from ..lengths import length
from ..model import Term

CLEAR, WEAK = 1e-3, 0.05  # of the paired test over held-out poses


@dataclass(frozen=True)
class Addition:
    """An effect that was added.

    Attributes:
        support: supported, undecided or not supported, by the data.
        p_value: one-sided, paired over held-out poses; NaN where there are too few.
        gone: parameters within two standard errors of zero; at_bound: that ended at a bound; implausible: outside their range.
    """

    support: str
    sentence: str
    p_value: float
    before_m: float
    after_m: float
    gone: tuple[str, ...] = ()
    at_bound: tuple[str, ...] = ()
    implausible: tuple[str, ...] = ()

    @property
    def supported(self) -> bool:
        return self.support == "supported"


def addition_of(before: HeldOut, after: HeldOut, term: Term, parameters: Sequence[Parameter]) -> Addition:
    """What an addition brings, by the error on held-out poses, and what else speaks for or against it.

    Args:
        term: the effect that was added, with its values; parameters: of its effect, for bounds and plausible ranges.
    """
    _, _, p = gain(before, after)
    own = {q.name: q for q in parameters}
    gone = tuple(n for n, e in term.estimates.items() if math.isfinite(e.se) and abs(e.value) < 2.0 * e.se)
    at_bound = tuple(n for n, e in term.estimates.items() if n in own and _at_bound(e.value, own[n]))
    implausible = tuple(
        n for n, e in term.estimates.items()
        if n in own and not own[n].plausible_range[0] <= e.value <= own[n].plausible_range[1]
    )  # fmt: skip
    old, new = before.rms_m, after.rms_m
    if not (math.isfinite(old) and math.isfinite(new) and math.isfinite(p)) or len(before.loss) < 3:
        few = "There are too few poses to hold some out: nothing speaks for or against it."
        return Addition("undecided", few, math.nan, old, new,
                      gone, at_bound, implausible)  # fmt: skip
    change = f"the error on held-out poses {_went(old, new)} ({probability(p)})"
    if p < CLEAR and new < old:
        support, sentence = "supported", f"The data support it: {change}."
    elif p < WEAK and new < old:
        support, sentence = "undecided", f"The data do not decide: {change}. More poses or repeats would."
    else:
        support, sentence = "not supported", f"The data do not support it: {change}. Throw it away unless you know better."
    if gone and len(gone) == len(term.estimates):
        sentence += " Its values can't be told from zero."
    if at_bound:
        sentence += f" At its bound: {', '.join(at_bound)}."
    if implausible:
        sentence += f" Outside what is physically likely: {', '.join(implausible)}."
    return Addition(support, sentence, p, old, new, gone, at_bound, implausible)


def _at_bound(value: float, p: Parameter) -> bool:
    slack = 1e-6 * p.scale
    absent = abs(value) <= slack  # a part that is not there
    return not absent and (abs(value - p.lower) <= slack or abs(value - p.upper) <= slack)


def _went(old: float, new: float) -> str:
    if abs(new - old) < 0.005 * old:
        return f"stays at {length(new)}"
    return f"{'falls' if new < old else 'rises'} from {length(old)} to {length(new)}"


def probability(p: float) -> str:
    """A p-value as far as it means anything."""
    if not math.isfinite(p):
        return "p unknown"
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.4f}" if p < 0.01 else f"p = {p:.2f}"
