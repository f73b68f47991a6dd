# SPDX-License-Identifier: Apache-2.0
"""A course with correction through RSI and CAN, and what happens when parts of that fail. ROS only watches."""

from __future__ import annotations

import os
import shutil
import signal
import socket
from pathlib import Path

import numpy as np
import pytest
from rsi_can_line import PERIOD, RATE_LIMIT, RESOLUTION, Line, calibrated_model, course_deviation, without_correction

pytestmark = pytest.mark.ros
SPEED = 0.25  # m/s: faster than the demo, to keep the test short
STEP = RATE_LIMIT * PERIOD + 2 * RESOLUTION
UNDER_FORCE = 2e-4  # m; such an offset can only come from the process force
START = 90.0  # s for four processes to come up on a busy machine


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    return calibrated_model(tmp_path_factory.mktemp("calibration"))


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def pressed(line: Line) -> None:
    line.drive(1.5, line.press)
    line.until(lambda: np.linalg.norm(line.sent[-1]) > UNDER_FORCE, START, "offset under the process force")
    line.drive(1.0)


def test_course_is_held_through_rsi_and_can(model, port, ros_domain, start_process):
    line = Line()
    line.start(start_process, model, port)
    pressed(line)
    corrected = course_deviation(line.cell, line.plan, line.drive, SPEED)
    plain = without_correction(line, SPEED)
    mean = [np.linalg.norm(d, axis=1).mean() for d in (plain, corrected)]
    worst = [np.linalg.norm(d, axis=1).max() for d in (plain, corrected)]
    assert mean[1] < 0.1 * mean[0], (mean, worst)
    assert worst[1] < 0.25 * worst[0], (mean, worst)
    assert line.largest_step <= STEP
    line.adapter.unplug()


def test_failures_make_no_step_and_only_a_dead_process_stops_the_robot(model, port, ros_domain, start_process, tmp_path):
    line, own = Line(), Path(shutil.copy(model, tmp_path / "in_force.yaml"))
    _, bridge = line.start(start_process, own, port)
    pressed(line)
    controller = line.controller
    controller.timeout = 100
    held = line.sent[-1]
    for packets in (1, 5):
        controller.faults.lose_answers = packets
        line.drive(0.3)
        controller.faults.lose_sent = packets
        line.drive(0.3)
    own.write_text("format: irec-model/1\neffects: []\n")  # swapped under it: the model in force is the one that was read
    line.drive(0.3)
    assert np.linalg.norm(line.sent[-1] - held) < 5e-5
    line.adapter.unplug()
    line.until(lambda: np.linalg.norm(line.sent[-1]) < 2e-7, 20.0, "offset faded out after CAN was unplugged")
    line.drive(0.3)
    assert not controller.stopped
    assert line.largest_step <= STEP
    os.kill(bridge.pid, signal.SIGKILL)
    line.drive(2.0)
    assert "packets in a row" in controller.stopped
    assert line.largest_step <= STEP
