# SPDX-License-Identifier: Apache-2.0
"""The bridge as processes: model through the service, wrench over shared memory, offset to the controller; the node may die."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chain import PERIOD, ROBOT, WRENCH, Q, model
from irec_calibration.cell import read_cell
from irec_calibration.model_file import save_model
from irec_correction.deflection import Deflection
from irec_correction.shared import WRENCH_SIZE, SharedValues
from irec_sim.devices.rsi_controller import RobotState, RsiController

pytestmark = pytest.mark.ros
CELL = Path(__file__).parents[2] / "config/cells/afp.yaml"
STATE = RobotState(Q, np.array([1.5, 0.0, 1.2]), np.zeros(3))
STEP = 0.02 * PERIOD + 2e-7


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def listening(port: int) -> bool:
    """Whether a process of this machine has this UDP port of 127.0.0.1 open."""
    entry = f"0100007F:{port:04X}"
    return any(line.split()[1] == entry for line in Path("/proc/net/udp").read_text().splitlines()[1:])


def wait_for_port(port: int, seconds: float = 60.0) -> None:
    """A controller that was running before the bridge would get no answer: it might hold a correction."""
    end = time.monotonic() + seconds
    while not listening(port):
        assert time.monotonic() < end, f"nobody listens on port {port} within {seconds} s"
        time.sleep(0.05)


class Drive:
    """The controller, and the sensor's shared memory."""

    def __init__(self, port: int, block: SharedValues) -> None:
        self.controller = RsiController(("127.0.0.1", port), timeout=10**6)
        self.block, self.rng = block, np.random.default_rng(0)

    def state(self) -> RobotState:
        self.block.write(np.array([time.monotonic(), self.controller.counts.cycles, 0.0, *(WRENCH + self.rng.normal(0, 0.2, 6))]))
        return STATE

    def until(self, condition, seconds: float, what: str) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (
                f"{what} not within {seconds} s; offset {self.sent[-1]}, {self.controller.counts.late} late"
            )
            self.controller.run(10, self.state)

    @property
    def sent(self) -> list[np.ndarray]:
        """Offset that acts in the controller, one per cycle."""
        return self.controller.acted

    @property
    def largest_step(self) -> float:
        """Between two cycles of the controller."""
        return float(np.linalg.norm(np.diff(np.array(self.sent), axis=0), axis=1).max())


def children_of(pid: int) -> list[int]:
    return [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def name_of(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()


def test_offset_reaches_the_controller_and_the_loop_outlives_the_node(ros_domain, start_process, tmp_path):
    afp = replace(model(), serial="KR120-0001", urdf_sha256=read_cell(CELL).robot.sha256)
    path = save_model(afp, tmp_path / "model.yaml")
    port, block = free_port(), SharedValues.create(WRENCH_SIZE)
    bridge = start_process([
        sys.executable, "-m", "irec_correction.nodes.rsi_bridge", "--ros-args", "-p", f"cell:={CELL}", "-p", f"port:={port}",
        "-p", f"wrench_block:={block.name}", "-p", f"model_path:={path}", "-p", "filter.cutoff:=0.0",
        "-p", "watch.wrench_timeout:=0.5", "-p", "watch.joints_timeout:=0.5", "-p", "watch.frozen_after:=0.5",
    ], name="rsi_bridge")  # fmt: skip
    wait_for_port(port)
    drive = Drive(port, block)
    expected, _ = Deflection(model(), ROBOT)(Q, WRENCH[:3], WRENCH[3:], PERIOD)
    drive.until(lambda: np.linalg.norm(drive.sent[-1] + expected) < 3e-6, 60.0, "offset of the model")
    node = [c for c in children_of(bridge.pid) if "resource_tracker" not in name_of(c)]
    assert len(node) == 1
    os.kill(node[0], signal.SIGKILL)
    drive.until(lambda: np.linalg.norm(drive.sent[-1]) < 1e-7, 10.0, "offset faded out")
    answered = drive.controller.counts.answered
    drive.until(lambda: drive.controller.counts.answered > answered + 50, 10.0, "answers without the node")
    assert bridge.poll() is None
    assert drive.largest_step <= STEP
    bridge.send_signal(signal.SIGINT)
    assert bridge.wait(10) == 0
    drive.controller.close()
    block.close()


def test_a_bridge_without_a_cell_refuses_and_says_so(ros_domain, start_process, tmp_path):
    bridge = start_process([sys.executable, "-m", "irec_correction.nodes.rsi_bridge"], name="refused")
    assert bridge.wait(60) == 2
    assert "cell" in (tmp_path / "refused.log").read_text()
