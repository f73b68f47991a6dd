# SPDX-License-Identifier: Apache-2.0
"""The node as a process: activated by its service, it streams the offset and fades out when the sensor dies."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from chain import WRENCH, Q, model
from irec_calibration.cell import read_cell
from irec_calibration.model_file import save_model
from irec_correction.deflection import Deflection

ROOT = Path(__file__).parents[2]
CELL = ROOT / "config/cells/afp.yaml"
START = 90.0  # s for a process to come up on a busy machine

pytestmark = pytest.mark.ros


class CellSide:
    """Publishes what a cell publishes, takes what the correction gives."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import TransformStamped, WrenchStamped
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState

        from irec_msgs.msg import CorrectionState
        from irec_msgs.srv import ActivateModel

        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("cell_side", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.offsets: list[np.ndarray] = []
        self.states: list[CorrectionState] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.joints = self.node.create_publisher(JointState, "joint_states", 50)
        self.wrench = self.node.create_publisher(WrenchStamped, "wrench", 50)
        self.node.create_subscription(TransformStamped, "irec/offset", self._on_offset, 50)
        self.node.create_subscription(CorrectionState, "irec/correction/state", self.states.append, 50)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)
        self.service = self.node.create_client(ActivateModel, "irec/correction/activate_model")
        self.request = ActivateModel.Request
        self.types = JointState, WrenchStamped
        self.rng = np.random.default_rng(0)
        self.publishing = True
        self.node.create_timer(0.004, self._publish)

    def _on_offset(self, message) -> None:
        t = message.transform.translation
        assert message.header.frame_id == "base_link" and message.child_frame_id == "tool0"
        self.offsets.append(np.array([t.x, t.y, t.z]))

    def _publish(self) -> None:
        from array import array

        joint_state, wrench = self.types
        stamp = self.node.get_clock().now().to_msg()
        j = joint_state(name=[f"joint_{k}" for k in range(1, 7)], position=array("d", Q.tolist()))
        j.header.stamp = stamp
        self.joints.publish(j)
        if self.publishing:
            w = wrench()
            w.header.stamp, w.header.frame_id = stamp, "tool0"
            f = (WRENCH + self.rng.normal(0, 0.5, 6)).tolist()
            w.wrench.force.x, w.wrench.force.y, w.wrench.force.z = f[:3]
            w.wrench.torque.x, w.wrench.torque.y, w.wrench.torque.z = f[3:]
            self.wrench.publish(w)

    def until(self, condition, seconds: float = 20.0, what: str = "condition") -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what} not met within {seconds} s; last state {self.states[-1:]}"
            self.executor.spin_once(timeout_sec=0.05)

    def activate(self, path: str):
        self.until(self.service.service_is_ready, START, "service")
        answer = self.service.call_async(self.request(model_path=path))
        self.until(answer.done, what="answer")
        return answer.result()

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def cell_side(ros_domain, start_process):
    start_process([
        sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}",
        "-p", "autostart:=true", "-p", "watch.wrench_timeout:=0.2", "-p", "watch.joints_timeout:=0.5",
        "-p", "filter.cutoff:=20.0",
    ], name="correction")  # fmt: skip
    side = CellSide()
    yield side
    side.close()


def afp_model(tmp_path: Path, serial: str = "KR120-0001") -> str:
    from dataclasses import replace

    cell = read_cell(CELL)
    return str(save_model(replace(model(), serial=serial, urdf_sha256=cell.robot.sha256), tmp_path / f"{serial}.yaml"))


def test_activated_node_streams_minus_the_deflection_and_fades_out_when_the_sensor_dies(cell_side, tmp_path):
    refused = cell_side.activate(afp_model(tmp_path, serial="SOMEONE-ELSE"))
    assert not refused.success and "SOMEONE-ELSE" in refused.message
    refused = cell_side.activate(str(tmp_path / "missing.yaml"))
    assert not refused.success and "missing.yaml" in refused.message
    answer = cell_side.activate(afp_model(tmp_path))
    assert answer.success, answer.message
    cell_side.until(lambda: cell_side.states and cell_side.states[-1].state == 2, what="ACTIVE")
    assert cell_side.states[-1].model_sha256 == answer.sha256
    expected, _ = Deflection(model(), read_cell(CELL).robot)(Q, WRENCH[:3], WRENCH[3:], 0.004)
    # a busy machine skips ticks, and each one moves by one step of the rate limit at most
    cell_side.until(lambda: np.linalg.norm(cell_side.offsets[-1] + expected) < 5e-6, what="offset of the model")
    cell_side.publishing = False
    cell_side.until(lambda: cell_side.states[-1].state == 5, what="FAULT")
    assert "no wrench" in cell_side.states[-1].reason
    cell_side.until(lambda: any("fault.wrench_stale" in str(d) for d in cell_side.diagnostics), what="diagnostics")
    assert np.linalg.norm(cell_side.offsets[-1]) < 1e-8
    steps = np.linalg.norm(np.diff(np.array([np.zeros(3), *cell_side.offsets]), axis=0), axis=1)
    assert steps.max() <= 0.02 * 0.004 * 3  # messages may be lost on the way here: three ticks at most between two


@pytest.mark.parametrize("module", ["correction_node", "rsi_bridge", "can_ft_node"])
def test_ros_arguments_that_cannot_be_read_are_a_line_and_no_trace(ros_domain, module):
    arguments = [sys.executable, "-m", f"irec_correction.nodes.{module}", "--ros-args", "--params-file", "/nowhere/params.yaml"]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "/nowhere/params.yaml" in done.stderr
    assert "Traceback" not in done.stderr
