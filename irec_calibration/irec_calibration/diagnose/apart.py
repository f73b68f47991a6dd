# SPDX-License-Identifier: Apache-2.0
"""Rows that stand out beside a model and its nonparametric remainder, given noise of their own before it is fitted for use.

A diagnosis carries such rows as displacements of their own, normal about 0 with an amplitude that the session shows. Integrated
over, that is a larger variance: sigma^2 + a^2 of a row, sigma_0^2 + a^2 of a reference that several rows share. So a model's
values are those that it has beside the bad rows, and a station that was bumped within a pose bends no spring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..identification.observe import Observation
from .directions import TYPICAL_DISPLACEMENT
from .family import Structure
from .remainder import Part


def set_apart(observation: Observation, bad: Sequence[Part]) -> Observation:
    """The same rows with the noise that those which stand out show.

    Args:
        bad: parts of a remainder that are bad rows, their amplitudes in units of TYPICAL_DISPLACEMENT.
    """
    own, shared = observation.whiten.sigma**2, observation.whiten.sigma_reference**2
    for part in bad:
        here = np.isin(observation.rows, part.structure.rows)
        more = (part.amplitude * TYPICAL_DISPLACEMENT) ** 2 * here
        if _move_together(part.structure):
            shared = shared + more
        else:
            own = own + more
    return replace(observation, whiten=replace(observation.whiten, sigma=np.sqrt(own), sigma_reference=np.sqrt(shared)))


def _move_together(structure: Structure) -> bool:
    """Whether one displacement moves all rows, as that of a reference does; else each row has its own."""
    return len(structure.rows) > 1 and structure.columns.stop - structure.columns.start < 3 * len(structure.rows)
