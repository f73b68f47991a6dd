# SPDX-License-Identifier: Apache-2.0
"""A course with correction through RSI and CAN, and what happens when parts of that fail. ROS only watches."""

from __future__ import annotations

import os
import shutil
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rsi_can_line import PERIOD, RATE_LIMIT, RESOLUTION, Line, calibrated_model, course_deviation, without_correction

pytestmark = [pytest.mark.ros, pytest.mark.alone]
SPEED = 0.25  # m/s: faster than the demo, to keep the test short
STEP = RATE_LIMIT * PERIOD + 2 * RESOLUTION
UNDER_FORCE = 2e-4  # m; such an offset can only come from the process force
START = 90.0  # s for four processes to come up on a busy machine


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    return calibrated_model(tmp_path_factory.mktemp("calibration"))


@pytest.fixture
def line() -> Iterator[Line]:
    made = Line()
    yield made
    made.close()


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def pressed(line: Line) -> None:
    line.drive(1.5, line.press)
    line.until(lambda: np.linalg.norm(line.sent[-1]) > UNDER_FORCE, START, "offset under the process force")
    line.drive(1.0)


def test_course_is_held_through_rsi_and_can(model, line, port, ros_domain, start_process):
    line.start(start_process, model, port)
    pressed(line)
    times, corrected = course_deviation(line.cell, line.plan, line.drive, SPEED)
    judged = line.undisturbed(times)
    if judged.mean() < 0.5:
        pytest.skip(f"this machine stopped the simulated controller {len(line.pauses)} times on the way: nothing to judge")
    plain, corrected = without_correction(line, SPEED)[judged], corrected[judged]
    mean = [np.linalg.norm(d, axis=1).mean() for d in (plain, corrected)]
    worst = [np.linalg.norm(d, axis=1).max() for d in (plain, corrected)]
    print(f"mean {1e3 * mean[0]:.4f} -> {1e3 * mean[1]:.4f} mm, max {1e3 * worst[0]:.4f} -> {1e3 * worst[1]:.4f} mm")  # pytest -s
    assert mean[1] < 0.1 * mean[0], (mean, worst)
    assert worst[1] < 0.25 * worst[0], (mean, worst)
    assert line.largest_step <= STEP


class Operator:
    """Puts the model in force again after a fault, by the service."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        from irec_msgs.srv import ActivateModel

        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("operator", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._request = ActivateModel.Request
        self._client = self._node.create_client(ActivateModel, "irec/correction/activate_model")

    def activate(self, line: Line, model: Path) -> None:
        from irec_ros.seen import SeenBy

        def spun(condition: Callable[[], bool]) -> Callable[[], bool]:
            def look() -> bool:
                self._executor.spin_once(timeout_sec=0.0)
                return condition()

            return look

        line.until(spun(SeenBy(self._node, "irec/correction/activate_model")), START, "bridge that knows this client")
        answer = self._client.call_async(self._request(model_path=str(model)))
        line.until(spun(answer.done), START, "answer of activate_model")
        assert answer.result().success, answer.result().message
        line.until(lambda: np.linalg.norm(line.sent[-1]) > UNDER_FORCE, START, "offset after starting again")
        line.drive(0.7)

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def children_of(pid: int) -> list[int]:
    """Processes that a process has started, without Python's own helpers."""
    children = [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [c for c in children if b"resource_tracker" not in Path(f"/proc/{c}/cmdline").read_bytes()]


@pytest.fixture
def operator(ros_domain) -> Iterator[Operator]:
    made = Operator()
    yield made
    made.close()


def test_failures_make_no_step_and_only_a_dead_process_stops_the_robot(model, line, port, operator, start_process, tmp_path):
    own = Path(shutil.copy(model, tmp_path / "in_force.yaml"))
    _, bridge = line.start(start_process, own, port)
    pressed(line)
    controller = line.controller
    controller.timeout = 100
    held = line.sent[-1]
    for way in ("lose_answers", "lose_sent", "late_answers", "double_sent", "old_again"):
        for packets, times in ((1, 1), (5, 40)):  # 40 times 5: 200 packets
            for _ in range(times):
                setattr(controller.faults, way, packets)
                line.drive(0.04)
    own.write_text("format: irec-model/1\neffects: []\n")  # swapped under it: the model in force is the one that was read
    line.drive(0.3)
    assert np.linalg.norm(line.sent[-1] - held) < 5e-5

    def gone() -> bool:
        return bool(np.linalg.norm(line.sent[-1]) < 2e-7)

    for fault in ("silent", "frozen"):
        setattr(line.sensor.faults, fault, True)
        line.until(gone, START, f"offset faded out while the sensor is {fault}")
        setattr(line.sensor.faults, fault, False)
        line.drive(0.3)
        assert gone()  # it waits for the operator
        operator.activate(line, model)
    line.adapter.unplug()
    line.until(gone, START, "offset faded out after CAN was unplugged")
    for node in children_of(bridge.pid):
        os.kill(node, signal.SIGKILL)
    line.drive(0.5)
    assert gone() and not controller.stopped
    assert line.largest_step <= STEP
    os.kill(bridge.pid, signal.SIGKILL)
    line.drive(2.0)
    assert "packets in a row" in controller.stopped
    assert line.largest_step <= STEP
