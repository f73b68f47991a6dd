# SPDX-License-Identifier: Apache-2.0
"""How the arm came to the reference of a pose."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .scene import Scene


def travel_to_reference(scene: Scene) -> Array:
    """Joint motion from the pose before to the reference of each pose, in its reference row, (n, k), rad; 0 elsewhere."""
    out = np.zeros_like(scene.q)
    order = np.lexsort((scene.load_case, scene.stamp))
    before, now = order[:-1], order[1:]
    arrives = scene.load_case[now] == 0
    out[now[arrives]] = scene.q[now[arrives]] - scene.q[before[arrives]]
    return out
