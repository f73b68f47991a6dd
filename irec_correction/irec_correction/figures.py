# SPDX-License-Identifier: Apache-2.0
"""Numbers in messages, which somebody has to read however wrong a value is."""

from __future__ import annotations

LARGE = 1e6  # from here on a number is written with an exponent: 1e308 N would be 309 digits long


def fixed(value: float, decimals: int) -> str:
    """With so many decimals as a plain number; of a large one three digits and the exponent."""
    return f"{value:.{decimals}f}" if abs(value) < LARGE else f"{value:.3g}"


def signed(value: float, decimals: int) -> str:
    """As `fixed`, with the sign of a positive number too."""
    return f"{'+' if value >= 0.0 else ''}{fixed(value, decimals)}"
