# SPDX-License-Identifier: Apache-2.0
"""The level of priors, which the session itself sets; their widths are traits of the effects' parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..effects import Effect
from ..typing import Array

LEVELS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of the springs' priors, tried on each session
FACTORS = np.array([0.1, 0.5, 2.5, 12.5])  # of an effect's prior width
FACTOR_OF_FORM = 2.0  # within which it is known how large what completes the springs' form is, one standard deviation


def choices(owners: Sequence[Effect], together: Sequence[str]) -> Iterator[tuple[Array, Array, str]]:
    """Multiples of the prior widths to choose from by evidence, one set after the other, each (k, p), log odds of each, (k,), and
    what completes the form of springs whose levels they are (`level_key`), or an empty string.

    First the springs of the axes, which every robot has, at all combinations of their levels, then every further effect by
    itself. How large what completes the form of springs is, is known beforehand but for a factor; of the others nothing is.

    Args:
        owners: the effect of each parameter, (p,); together: its `Parameter.level`.
    """
    owner = np.array([e.id for e in owners])
    springs = list(dict.fromkeys(e.id for e in owners if e.compliance_of))
    levels = np.ones((1, len(owner)))
    for name in springs:
        levels = np.array([np.where(owner == name, level, row) for row in levels for level in LEVELS])
    yield levels, np.zeros(len(levels)), ""
    key = np.array([level_key(i, level) for i, level in zip(owner, together, strict=True)])
    for name, effect in {str(k): e for k, e in zip(key, owners, strict=True) if not e.compliance_of}.items():
        tried = np.array(LEVELS) if effect.completes else FACTORS
        odds = log_odds_of_form(tried) if effect.completes else np.zeros(len(tried))
        yield np.where(key == name, tried[:, None], 1.0), odds, name if effect.completes else ""


def level_key(effect_id: str, level: str) -> str:
    """Of parameters that are large or small together."""
    return f"{effect_id}/{level}" if level else effect_id


def log_odds_of_form(level: Array) -> Array:
    """Log odds of levels of what completes the form of springs, against its usual size, (k,)."""
    return np.asarray(-0.5 * (np.log(level) / np.log(FACTOR_OF_FORM)) ** 2)
