# SPDX-License-Identifier: Apache-2.0
"""How the arm came to the reference of a pose, and what gears keep on the way from row to row."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .scene import Scene


def travel_to_reference(scene: Scene) -> Array:
    """Joint motion from the pose before to the reference of each pose, in its reference rows, (n, k), rad; 0 elsewhere.

    While several markers are read the robot stands: each of them has the motion before.
    """
    first, stands = scene.rows.stands
    travel = np.diff(scene.q[first], axis=0, prepend=scene.q[first[:1]])
    travel[scene.load_case[first] != 0] = 0.0
    return np.asarray(travel[stands])


def added_in_turn(a: Array, b: Array) -> Array:
    """y_i = a_i y_(i-1) + b_i along the first axis, from y = 0 on; composed as in `clipped_in_turn`."""
    y = b.copy()
    step = 1
    while step < len(y) and a.any():
        y[step:] += a[step:] * y[:-step]
        a = np.concatenate([np.zeros_like(a[:step]), a[step:] * a[:-step]])
        step *= 2
    return y


def clipped_in_turn(a: Array | float, b: Array | float, low: Array, high: Array) -> Array:
    """y_i = clip(a_i y_(i-1) + b_i, low_i, high_i) with a_i >= 0 along the first axis, from y = 0 on.

    Such a function of such a one is of this kind again: all are composed with those before in log2(n) steps.

    Args:
        low, high: of each row, (n, ...); a, b: of the same shape, or one number for all.
    """
    a, b, low, high = (np.array(np.broadcast_to(x, low.shape), dtype=float) for x in (a, b, low, high))
    step = 1
    while step < len(a):
        last_a, last_b = a[step:].copy(), b[step:].copy()
        last_low, last_high = low[step:].copy(), high[step:].copy()
        a[step:] = last_a * a[:-step]
        b[step:] = last_a * b[:-step] + last_b
        low[step:], high[step:] = (np.clip(last_a * end[:-step] + last_b, last_low, last_high) for end in (low, high))
        step *= 2
    return np.clip(b, low, high)
