# SPDX-License-Identifier: Apache-2.0
"""Figures of the workbench as plain plotly dictionaries."""

from .cell import cell, nice_scale
from .look import BY_RESIDUAL, CONFIG, Figure, Look
from .samples import against, norms
from .versions import course, growth, ladder

__all__ = ["BY_RESIDUAL", "CONFIG", "Figure", "Look", "against", "cell", "course", "growth", "ladder", "nice_scale", "norms"]
