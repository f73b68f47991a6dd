# SPDX-License-Identifier: Apache-2.0
"""The level of priors, which the session itself sets; their widths are traits of the effects' parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..effects import Effect, Family
from ..typing import Array, BoolArray

LEVELS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of the springs' priors, tried on each session
FORM_LEVELS = (0.0625, 0.125, *LEVELS)  # the same of what completes their form
FACTORS = np.array([0.1, 0.5, 2.5, 12.5])  # of an effect's prior width
FACTOR_OF_FORM = 4.0  # within which it is known how large what completes the springs' form is, one standard deviation


@dataclass(frozen=True)
class Choice:
    """Multiples of prior widths to choose from by evidence.

    Attributes:
        of: which parameters, (p,); times: multiples of the width of each, (k, p), 1 for the others; log_odds: of each, (k,).
        completing: what completes the form of springs whose level this is (`level_key`), or an empty string.
    """

    of: BoolArray
    times: Array
    log_odds: Array
    completing: str = ""


def choices(owners: Sequence[Effect], together: Sequence[str]) -> Iterator[Choice]:
    """What is chosen by evidence, one after the other, a later choice in place of an earlier one of the same parameters.

    First the springs of the axes, which every robot has, at all combinations of their levels. Then what else gives way (tool,
    base) together with what completes the form of springs: either may stand for the other, so that one chosen first would leave
    nothing to the second. Then each of these and every further effect by itself. How large what completes the form of springs is,
    is known beforehand but for a factor; of the others nothing is.

    Args:
        owners: the effect of each parameter, (p,); together: its `Parameter.level`.
    """
    owner = np.array([e.id for e in owners])
    springs = list(dict.fromkeys(e.id for e in owners if e.compliance_of))
    levels = np.ones((1, len(owner)))
    for name in springs:
        levels = np.array([np.where(owner == name, level, row) for row in levels for level in LEVELS])
    yield Choice(np.isin(owner, springs), levels, np.zeros(len(levels)))
    key = np.array([level_key(i, level) for i, level in zip(owner, together, strict=True)])
    others = {str(k): e for k, e in zip(key, owners, strict=True) if not e.compliance_of}
    form = np.isin(key, [k for k, e in others.items() if e.completes])
    gives_way = np.isin(key, [k for k, e in others.items() if e.family is Family.SPRING and not e.completes])
    if form.any() and gives_way.any():
        pairs = [(level, times) for level in FORM_LEVELS for times in FACTORS]
        rows = np.array([np.where(form, level, np.where(gives_way, times, 1.0)) for level, times in pairs])
        odds = log_odds_of_form(np.array([level for level, _ in pairs])) * len(np.unique(key[form]))
        yield Choice(form | gives_way, rows, odds)
    for name, effect in others.items():
        tried = np.array(FORM_LEVELS) if effect.completes else FACTORS
        odds = log_odds_of_form(tried) if effect.completes else np.zeros(len(tried))
        yield Choice(key == name, np.where(key == name, tried[:, None], 1.0), odds, name if effect.completes else "")


def level_key(effect_id: str, level: str) -> str:
    """Of parameters that are large or small together."""
    return f"{effect_id}/{level}" if level else effect_id


def log_odds_of_form(level: Array) -> Array:
    """Log odds of levels of what completes the form of springs, against its usual size, (k,)."""
    return np.asarray(-0.5 * (np.log(level) / np.log(FACTOR_OF_FORM)) ** 2)


def level_of_form(log_evidence: Array) -> float:
    """The level of what completes the form of springs: the mean of log(level) over FORM_LEVELS, each as likely as it is.

    Few sessions tell it, and the likeliest alone would be believed as if they did.

    Args:
        log_evidence: of each level, with its log odds beforehand, (k,).
    """
    weight = np.exp(log_evidence - log_evidence.max())
    return float(np.exp(weight @ np.log(FORM_LEVELS) / weight.sum()))
