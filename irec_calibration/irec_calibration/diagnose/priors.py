# SPDX-License-Identifier: Apache-2.0
"""What is known about parameters before a session is seen.

Links and bearings of heavy robots are 3 to 30 times stiffer across the axes 1-3 than about them, and 1 to 5 times across
the wrist's axes. These weak priors keep 18 free compliances from standing in for another cause; their overall level is set
by the session itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from ..effects import Parameter
from ..typing import Array

TORSION_WIDTH = 3.0  # multiples of the parameter's scale
BENDING_WIDTH_ARM = 0.5
BENDING_WIDTH_WRIST = 1.2
WRIST_AXES = 3
EFFECT_WIDTH = 1.0
LEVELS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of the springs' priors, tried on each session
FACTORS = np.array([0.1, 0.5, 2.5, 12.5])  # of an effect's prior width


def prior_width(effect_id: str, parameter: Parameter, n_joints: int) -> float:
    """Standard deviation of the prior of one parameter about 0, in units of its scale."""
    if parameter.flat:
        return np.inf
    if effect_id == "joint_torsion":
        return TORSION_WIDTH
    if effect_id == "link_bending":
        axis = int(re.sub(r"\D", "", parameter.group) or 1)
        return BENDING_WIDTH_WRIST if axis > n_joints - WRIST_AXES else BENDING_WIDTH_ARM
    return EFFECT_WIDTH


def log_odds(effect_id: str, kind: str) -> float:
    """How much less likely an effect is than others before a session is seen, natural log."""
    # only an encoder far out of order shows in differences at one pose; geometry is then the likelier cause
    return -4.0 if effect_id == "encoder_harmonics" and kind == "loaded" else 0.0


def choices(owners: list[str]) -> Iterator[Array]:
    """Multiples of the prior widths to choose from by evidence, one set after the other, each (k, p).

    First torsion and bending at several levels each, then every further effect by itself.
    """
    owner = np.array(owners)
    torsion, bending = owner == "joint_torsion", owner == "link_bending"
    levels = [
        np.where(torsion, t, np.where(bending, v, 1.0))
        for t in (LEVELS if torsion.any() else (1.0,))
        for v in (LEVELS if bending.any() else (1.0,))
    ]
    yield np.array(levels)
    for name in dict.fromkeys(o for o in owners if o not in ("joint_torsion", "link_bending")):
        yield np.where(owner == name, FACTORS[:, None], 1.0)
