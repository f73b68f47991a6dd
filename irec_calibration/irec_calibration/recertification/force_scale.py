# SPDX-License-Identifier: Apache-2.0
"""Whether all of a robot gives way otherwise per newton than the calibration in force says: that is the force sensor, no robot.

A robot ages axis by axis. One factor for all of the deflection is what a sensor of another unit or gain makes, which the new
calibration would take over, as it fits as well as before.
"""

from __future__ import annotations

import numpy as np

from ..procedure.weighing import RUN_HIGH, RUN_LOW, likely_scale
from ..typing import Array

LEFT = 0.3  # of the deflection, RMS, that one factor may leave


def scale_doubt(measured: Array, predicted: Array) -> str:
    """Why the scale of the force is likely to be wrong, in a sentence; empty where it is not.

    Args:
        measured: displacements under load, (m, 3), m. predicted: of the calibration in force, (m, 3), m.
    """
    size = float((predicted * predicted).sum())
    if size <= 0.0:
        return ""
    factor = float((measured * predicted).sum()) / size
    left = float(np.linalg.norm(measured - factor * predicted)) / max(float(np.linalg.norm(measured)), 1e-12)
    if RUN_LOW <= factor <= RUN_HIGH or left > LEFT or factor <= 0.0:
        return ""
    return (
        f"All of the robot gives way {factor:.3g} times as far per newton as the calibration in force says ({RUN_LOW:g} to"
        f" {RUN_HIGH:g} is expected; {100.0 * left:.0f} % of the deflection go otherwise). No robot ages so; the force sensor"
        f" does not read what acts: {likely_scale(1.0 / factor)}."
    )
