# SPDX-License-Identifier: Apache-2.0
"""The side of the cell: publishes what a robot and its force sensor publish, takes what the correction gives."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from chain import WRENCH, Q, model
from irec_calibration.cell import read_cell
from irec_calibration.model.file import save_model
from irec_ros.seen import SeenBy

CELL = Path(__file__).parents[2] / "config/cells/afp.yaml"
START = 90.0  # s for a process to come up on a busy machine
QUEUE = 5000  # messages: none is lost while a busy machine stops this process


class CellSide:
    """Publishes what a cell publishes, takes what the correction gives."""

    def __init__(self) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import TransformStamped, WrenchStamped
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

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
        self.node.create_subscription(TransformStamped, "irec/offset", self._on_offset, QUEUE)
        self.node.create_subscription(CorrectionState, "irec/correction/state", self.states.append, 50)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)
        self.service = self.node.create_client(ActivateModel, "irec/correction/activate_model")
        self.request = ActivateModel.Request
        self.joint_trajectory = JointTrajectory
        self.types = JointState, WrenchStamped
        self.rng = np.random.default_rng(0)
        self.publishing = True
        self.load = 1.0  # share of WRENCH
        self.rail: float | None = 0.0  # m; None: it is not among the joint states
        self.instead: dict[str, object] = {}  # what is sent in place of the next "joints" or "wrench"
        self.node.create_timer(0.004, self._publish)

    def _on_offset(self, message) -> None:
        t = message.transform.translation
        assert message.header.frame_id == "base_link" and message.child_frame_id == "tool0"
        self.offsets.append(np.array([t.x, t.y, t.z]))

    def joints_now(self):
        """Joint states of now."""
        from array import array

        joint_state, _ = self.types
        j = joint_state(name=[f"joint_{k}" for k in range(1, 7)], position=array("d", Q.tolist()))
        if self.rail is not None:
            j.name, j.position = [*j.name, "ext_rail"], array("d", [*Q.tolist(), self.rail])
        j.header.stamp = self.node.get_clock().now().to_msg()
        return j

    def _publish(self) -> None:
        _, wrench = self.types
        j = self.joints_now()
        stamp = j.header.stamp
        instead, self.instead = self.instead, {}  # once each
        self.joints.publish(instead.get("joints", j))
        if "wrench" in instead:
            self.wrench.publish(instead["wrench"])
        elif self.publishing:
            w = wrench()
            w.header.stamp, w.header.frame_id = stamp, "tool0"
            f = (self.load * WRENCH + self.rng.normal(0, 0.5, 6)).tolist()
            w.wrench.force.x, w.wrench.force.y, w.wrench.force.z = f[:3]
            w.wrench.torque.x, w.wrench.torque.y, w.wrench.torque.z = f[3:]
            self.wrench.publish(w)

    def until(self, condition, seconds: float = START, what: str = "condition") -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what} not met within {seconds} s; last state {self.states[-1:]}"
            self.executor.spin_once(timeout_sec=0.05)

    def activate(self, path: str):
        return self.call(self.service, self.request(model_path=path))

    def call(self, client, request):
        """Answer of a service."""
        self.until(client.service_is_ready, what="service")
        self.until(SeenBy(self.node, client.srv_name), what="the server finds this client")
        answer = client.call_async(request)
        self.until(answer.done, what="answer")
        return answer.result()

    def joint_offset(self):
        """The next message on irec/joint_offset; not listened to for longer, as it comes 250 times a second."""
        heard = []
        subscription = self.node.create_subscription(self.joint_trajectory, "irec/joint_offset", heard.append, 1)
        self.until(lambda: heard, what="joint offset")
        self.node.destroy_subscription(subscription)
        return heard[-1]

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def afp_model(folder: Path, serial: str = "KR120-0001", tool: str = "") -> str:
    """Path of a model of the cell's robot."""
    sha = read_cell(CELL).robot.sha256
    return str(save_model(replace(model(), serial=serial, urdf_sha256=sha, tool=tool), folder / f"{serial}.yaml"))
