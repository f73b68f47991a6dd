# SPDX-License-Identifier: Apache-2.0
"""Joint states that name a joint more than once: where both say the same nothing is unclear, otherwise none is believed."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

SAME = 1e-6  # rad or m within which two positions of one joint are one


def named_twice(names: Sequence[str], wanted: Collection[str]) -> list[tuple[str, list[int]]]:
    """Joints of `wanted` that are named more than once, and at which places."""
    places: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        places.setdefault(name, []).append(k)
    return [(name, places[name]) for name in wanted if len(places.get(name, ())) > 1]


def contradiction(twice: Sequence[tuple[str, list[int]]], position: Sequence[float]) -> str:
    """What is wrong with the positions (rad, m) of joints that `named_twice` found, for people; empty where nothing is."""
    for name, places in twice:
        first, *others = (float(position[k]) for k in places if k < len(position))
        for other in others:
            if not abs(other - first) <= SAME and not (math.isnan(first) and math.isnan(other)):
                return (
                    f"'{name}' is named {len(places)} times, at {first:.6g} and at {other:.6g} (limit {SAME:g} apart): which of"
                    " them is it? End or mend what merges the joint states of two senders"
                )
    return ""
