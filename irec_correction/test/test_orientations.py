# SPDX-License-Identifier: Apache-2.0
"""Orientations recorded in the cell for the tool load."""

from __future__ import annotations

import numpy as np
import pytest
from chain import ROBOT, Q
from irec_calibration.errors import SolveError
from irec_calibration.sensors.tool_load import ToolLoad
from irec_correction.conditioning import sensor_in_tool
from irec_correction.errors import CorrectionError
from irec_correction.orientations import Orientations

G = (0.0, 0.0, -9.81)
LOAD = ToolLoad(120.0, (0.01, -0.02, 0.2), (18.0, -11.0, 25.0), (1.2, -0.8, 0.5))
R_SENSOR, _ = sensor_in_tool(ROBOT, "ft_sensor")
TURNS = [(0, 0, 0), (0, 0.9, 0), (0, -1.6, 0), (1.5, 0.8, 0), (-1.5, 0.8, 0), (0.7, -1.2, 1.5)]


def stand(orientations: Orientations, q: np.ndarray, begin: float, speed: float = 0.0) -> None:
    for i in range(150):
        now = q + speed * 0.004 * i
        orientations.take_joints(begin + 0.004 * i, now)
        R = ROBOT.kinematics(now[None]).R_tool[0] @ R_SENSOR
        orientations.take_wrench(begin + 0.004 * i, LOAD.reading(R, np.array(G)))


def test_recorded_orientations_give_the_tool_load():
    orientations = Orientations(ROBOT, R_SENSOR, G)
    for i, turn in enumerate(TURNS):
        stand(orientations, Q + np.r_[0, 0, 0, turn], 10.0 * i)
        assert orientations.record() == i + 1
    load = orientations.identify().load
    assert load.mass == pytest.approx(120.0)
    np.testing.assert_allclose(load.com, LOAD.com, atol=1e-9)


def test_a_moving_robot_is_not_recorded():
    orientations = Orientations(ROBOT, R_SENSOR, G)
    stand(orientations, Q, 0.0, speed=0.01)
    with pytest.raises(CorrectionError, match="moved by"):
        orientations.record()


def test_without_readings_nothing_is_recorded_and_nothing_identified():
    orientations = Orientations(ROBOT, R_SENSOR, G)
    with pytest.raises(CorrectionError, match="0 readings"):
        orientations.record()
    with pytest.raises(SolveError, match="0 orientations"):
        orientations.identify()
