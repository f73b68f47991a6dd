# SPDX-License-Identifier: Apache-2.0
"""The columns of one effect on top of a model, at given values of its shape."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..effects import Effect, Parameter
from ..typing import Array
from .evidence import Block
from .study import Study


def block_columns(study: Study, effect: Effect, shape: dict[str, float]) -> tuple[Block, list[Parameter]]:
    """All columns of an effect at given values of its shape, and the parameter of each."""
    parameters = effect.parameters(study.ready)
    free = [i for i, p in enumerate(parameters) if not p.grid]
    theta = np.array([shape.get(p.name, 0.0) for p in parameters])
    chosen = [parameters[i] for i in free]
    scale = np.array([p.scale for p in chosen])
    A = beside_springs(study, study.columns(study.regressor(effect, theta)[:, :, free] * scale), chosen)
    reached = effect.reached(study.ready, theta)
    if reached is not None:
        A[:, ~reached[free]] = 0.0
    width = np.array([p.prior_width for p in chosen])
    lower = np.array([p.lower for p in chosen]) / scale
    upper = np.array([p.upper for p in chosen]) / scale
    return Block(A, lower, upper, width), chosen


def beside_springs(study: Study, A: Array, parameters: Sequence[Parameter]) -> Array:
    """Columns of an effect where compliances from which it takes something away (`Parameter.takes_from`) grow by as much.

    The prior of such a compliance is meant for the loaded axis, which is then as soft with the effect as without.
    """
    springs = {p.name: j for j, p in enumerate(study.parameters)}
    out = A
    for i, p in enumerate(parameters):
        j = springs.get(p.takes_from)
        if j is not None:
            out = A.copy() if out is A else out
            out[:, i] -= study.base.A[:, j] * (p.scale / study.scale[j])
    return out
