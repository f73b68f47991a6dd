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
from irec_calibration.nodes.driver_levels import FARTHEST, above_surface, pressing
from irec_calibration.poses.store import read_poses
from irec_calibration.procedure.axes import read_axes
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

    def newest(self, topic: str, n: int) -> np.ndarray:
        return np.tile(self.last(topic), (n, 1))

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


class NearSurface:
    """A robot at rest that reads a force from the moment its straight move is nearer than `touches` m to the contact."""

    def __init__(self, p_contact: np.ndarray, z: np.ndarray, touches: float) -> None:
        self.p_contact, self.z, self.touches = p_contact, z, touches
        self.lines: list[tuple[float, float]] = []  # distance from contact, m, at the end; speed, m/s
        self.cancelled_at: np.ndarray | None = None
        self._at = np.inf  # m from contact

    def move_joints(self, names: object, position: object, speed: float) -> Answer:
        return Answer(True, "", 0.0)

    def move_line(
        self, p: np.ndarray, R: np.ndarray, speed: float, cancel_when: Callable[[], bool] | None = None
    ) -> Answer:
        end = float((self.p_contact - p) @ self.z)
        self.lines.append((round(end, 4), speed))
        self._at, self.cancelled_at = end, None
        if cancel_when is not None and cancel_when():
            self.cancelled_at = p
        return Answer(True, "", 1.0)

    def newest(self, topic: str, n: int) -> np.ndarray:
        return np.tile(self.last(topic), (n, 1))

    def last(self, topic: str) -> np.ndarray:
        return np.array([1.0, 0.0, -100.0 if self._at < self.touches else 0.0, 0.0, 0.0, 0.0])

    def tcp(self) -> tuple[np.ndarray, np.ndarray]:
        return self.p_contact - self._at * self.z, np.eye(3)


def to_first_pose(touches: float) -> tuple[NearSurface, Answer]:
    pose = read_poses(CELL.poses_path, CELL.serial, CELL.robot.sha256).poses[0]
    at = CELL.robot.kinematics(pose.q[None])
    client = NearSurface(at.p_tcp[0], at.R_tool[0][:, 2], touches)
    axes, settings = read_axes(CELL), read_settings(CELL)
    answer = above_surface(client, CELL, axes, settings, pose.q, 0.0, CELL.reference_distance)  # type: ignore[arg-type]
    return client, answer


def test_the_last_centimetre_to_the_first_pose_is_slow() -> None:
    client, answer = to_first_pose(0.0)
    assert answer.success and client.lines == [(0.013, 0.15), (0.003, 0.003)]


def test_tooling_that_is_touched_on_the_way_to_the_first_pose_ends_the_level_out_of_contact() -> None:
    client, answer = to_first_pose(0.005)
    assert not answer.success and "the wrench reads [1.0, 0.0, -100.0] N" in answer.message
    assert client.lines[-1][0] > 0.09
