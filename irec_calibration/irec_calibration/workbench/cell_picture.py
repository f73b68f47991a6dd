# SPDX-License-Identifier: Apache-2.0
"""The workbench's picture of the cell for a page that stands alone."""

from __future__ import annotations

import numpy as np

from ..diagnose.result import Diagnosis
from ..session import Session
from . import figures
from .plain import Version
from .view import view_of


def cell_of(d: Diagnosis, session: Session) -> figures.Figure:
    """The cell in 3D with the residuals of a diagnosis, as a plotly dictionary."""
    c = d.comparison
    sigma = np.full(len(c.rows), c.noise_floor_m)
    version = Version(
        "", "", (), d.notes, c.rows, c.measured, c.predicted, c.residual, sigma, c.residual,
        c.rms_m, d.cv_rms_m, float("nan"), c.noise_floor_m, c.repeat_floor_m,
    )  # fmt: skip
    view = view_of(session)
    return figures.cell(view, version, c.residual, magnify=figures.nice_scale(view, c.residual))
