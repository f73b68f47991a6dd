# SPDX-License-Identifier: Apache-2.0
"""Lengths for people: micrometres below a millimetre, millimetres below a metre, with as many digits as mean anything."""

from __future__ import annotations

import math

MM, METRE = 1e-3, 1.0


def length(metres: float) -> str:
    """A length for a sentence or a table."""
    if not math.isfinite(metres):
        return "unknown"
    if abs(metres) >= METRE:
        return f"{metres:.3g} m"
    um = 1e6 * metres
    if abs(metres) >= MM:
        return f"{um / 1e3:.2f} mm"
    return f"{um:.0f} um" if abs(um) >= 100.0 else f"{um:.1f} um"


def unit_of(largest: float) -> tuple[float, str]:
    """Factor and name of the unit in which an axis of a figure shows lengths up to the largest, m."""
    return (1e3, "mm") if math.isfinite(largest) and abs(largest) >= MM else (1e6, "um")
