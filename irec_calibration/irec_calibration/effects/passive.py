# SPDX-License-Identifier: Apache-2.0
"""What a spring of several degrees of freedom can't be: a source of energy."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, sqrt

from .scales import SURELY


def why_no_spring(values: Mapping[str, tuple[float, float]], coupled: Mapping[str, tuple[str, str]]) -> str:
    """Why fitted compliances are of no spring, with the limit; empty where they may be.

    A compliance matrix has no negative eigenvalue, or a load that goes round in a circle would gain energy each time. So what
    couples two directions is at most the geometric mean of their own compliances. Said where it is certain, by two standard
    errors of each; nothing is said of values of which no error is known.

    Args:
        values: parameter -> value and standard error; coupled: parameter that couples two directions -> those of these by
            themselves.
    """
    for name, pair in coupled.items():
        known = [values[n] for n in (name, *pair) if n in values and isfinite(values[n][1])]
        if len(known) < 3:
            continue
        (between, error), *own = known
        most = sqrt(max(own[0][0] + SURELY * own[0][1], 0.0) * max(own[1][0] + SURELY * own[1][1], 0.0))
        if abs(between) - SURELY * error > most:
            return (
                f"{name} = {between:.3g} couples more than {pair[0]} = {own[0][0]:.3g} and {pair[1]} = {own[1][0]:.3g} allow"
                f" ({most:.3g} at most, their square roots multiplied): no spring does that"
            )
    return ""
