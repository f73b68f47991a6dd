# SPDX-License-Identifier: Apache-2.0
"""Whether a model may be put in force: it belongs to this robot and tool, and is fast enough."""

from __future__ import annotations

import time

import numpy as np
from irec_calibration.model import Model
from irec_calibration.model_file import check_belongs
from irec_calibration.robot import Payload, Robot
from irec_calibration.typing import Array

from ..deflection import Deflection
from ..errors import ActivationError

SHARE_OF_PERIOD = 0.5
EVALUATIONS = 30


def check_mounted(model: Model, robot: Robot, serial: str, tool: str) -> None:
    """Serial, robot description and, where both are named, the tool. Raises IrecError."""
    check_belongs(model, robot, serial, "this cell")
    if model.tool and tool and model.tool != tool:
        raise ActivationError(f"the model was identified with tool '{model.tool}', '{tool}' is mounted")


def affordable(
    model: Model, robot: Robot, gravity: tuple[float, float, float], payload: Payload | None, period: float
) -> tuple[Deflection, float]:
    """The compiled model and the time of an evaluation, s.

    Args:
        gravity: in base_link, m/s^2. period: of the correction, s.

    Raises:
        ActivationError: an effect can't act in real time, or all together take too long.
    """
    deflection = Deflection(model, robot, gravity, payload)
    spent = _time_of(deflection)
    if spent > SHARE_OF_PERIOD * period:
        raise ActivationError(
            f"the model takes {spent * 1e3:.2f} ms per evaluation, half a period of {period * 1e3:.1f} ms is allowed;"
            " use a model without effects of your own, or a lower rate"
        )
    return deflection, spent


def _time_of(deflection: Deflection) -> float:
    q: Array = np.zeros(deflection.n_joints)
    spent = []
    for _ in range(EVALUATIONS):
        t = time.perf_counter()
        deflection(q, np.ones(3), np.ones(3), 0.004)
        spent.append(time.perf_counter() - t)
    deflection.reset()
    return float(np.median(spent))
