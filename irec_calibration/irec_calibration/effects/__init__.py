# SPDX-License-Identifier: Apache-2.0
"""The catalogue of physical effects, and how effects of users are found.

An effect is named by its id: of the catalogue, of an installed package (entry point group `irec.effects`), of a file named in the
environment variable `IREC_EFFECTS`, or registered in this process.
"""

from __future__ import annotations

from .base import Effect, Parameter, absent, follows_springs, parameters_of
from .catalogue import CATALOGUE
from .registry import broken_effects, find_effect, known_effects, register
from .traits import Ageing, Axes, Cause, Evidence, Family, is_predicted

__all__ = [
    "CATALOGUE",
    "Ageing",
    "Axes",
    "Cause",
    "Effect",
    "Evidence",
    "Family",
    "Parameter",
    "absent",
    "broken_effects",
    "find_effect",
    "follows_springs",
    "is_predicted",
    "known_effects",
    "parameters_of",
    "register",
]
