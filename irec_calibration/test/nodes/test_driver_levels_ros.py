# SPDX-License-Identifier: Apache-2.0
"""What check_driver does with a robot, without processes: a driver that is played, whose clock goes on while it is waited for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

from irec_calibration.cell import read_cell
from irec_calibration.driver_check.observed import Answer
from irec_calibration.nodes.driver_levels import FARTHEST, pressing
from irec_calibration.procedure.settings import read_settings

from irec_msgs.srv import SetControlMode

pytestmark = pytest.mark.ros
CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
STEP = 0.05  # s
ADVANCE = 0.01  # m/s


class NoSurface:
    """Goes along z of the tool while it is to press, and never feels anything."""

    def __init__(self) -> None:
        self.now, self.way, self.mode = 0.0, 0.0, SetControlMode.Request.POSITION
        self.pressing: np.ndarray | None = None
        self.farthest = 0.0

    def wait(self, until: Callable[[], bool], what: str, patience: float = 90.0) -> None:
        end = self.now + patience
        while not until() and self.now < end:
            self.now += STEP
            if self.mode == SetControlMode.Request.FORCE and self.pressing is not None:
                self.way += STEP * ADVANCE
                self.farthest = max(self.farthest, self.way)

    def pause(self, seconds: float) -> tuple[float, float]:
        begin = self.now
        self.wait(lambda: self.now >= begin + seconds, "time")
        return begin, self.now

    def last(self, topic: str) -> np.ndarray:
        return {"robot/state": np.array([float(self.mode)]), "wrench": np.zeros(6)}[topic]

    def tcp(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([1.0, 0.0, 0.5 + self.way]), np.eye(3)

    def switch(self, mode: int, force: np.ndarray) -> tuple[Answer, float, float]:
        self.mode = mode
        return Answer(True, "", 0.0), 0.5, 0.02

    def move_line(self, p: np.ndarray, R: np.ndarray, speed: float) -> Answer:
        self.way = float(p[2]) - 0.5
        return Answer(True, "", 0.0)


def test_a_tool_that_finds_no_surface_is_taken_back_after_two_centimetres_and_the_level_says_so() -> None:
    client = NoSurface()
    items = pressing(client, read_settings(CELL))  # type: ignore[arg-type]
    assert [(i.name, i.passed) for i in items] == [("the tool comes into contact", False)]
    assert "none within 2" in items[0].figure and "surface" in items[0].advice
    assert client.farthest < FARTHEST + 2.0 * STEP * ADVANCE
    assert client.way == 0.0 and client.mode == SetControlMode.Request.POSITION and client.pressing is None
