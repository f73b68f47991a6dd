# SPDX-License-Identifier: Apache-2.0
"""The level of priors, which the session itself sets; their widths are traits of the effects' parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..effects import Effect
from ..typing import Array

LEVELS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of the springs' priors, tried on each session
FACTORS = np.array([0.1, 0.5, 2.5, 12.5])  # of an effect's prior width


def choices(owners: Sequence[Effect]) -> Iterator[Array]:
    """Multiples of the prior widths to choose from by evidence, one set after the other, each (k, p).

    First the effects that every robot has, at all combinations of their levels, then every further effect by itself.

    Args:
        owners: the effect of each parameter, (p,).
    """
    owner = np.array([e.id for e in owners])
    everywhere = list(dict.fromkeys(e.id for e in owners if e.everywhere))
    levels = np.ones((1, len(owner)))
    for name in everywhere:
        levels = np.array([np.where(owner == name, level, row) for row in levels for level in LEVELS])
    yield levels
    for name in dict.fromkeys(e.id for e in owners if not e.everywhere):
        yield np.where(owner == name, FACTORS[:, None], 1.0)
