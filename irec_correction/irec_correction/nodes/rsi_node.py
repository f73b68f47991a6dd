# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the RSI bridge: parameters and models in, measurements and diagnostics out. Nothing waits for it."""

from __future__ import annotations

import sys
import time
from array import array
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TransformStamped, WrenchStamped
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_calibration.model_file import check_belongs, file_sha256, load_model
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from irec_msgs.msg import CorrectionState
from irec_msgs.srv import ActivateModel

from ..errors import SettingsError
from ..rsi.bridge import BridgeSetup
from ..rsi.loop import KEPT, REPORT_SIZE, Link
from ..rsi.sources import OFFSET_SIZE, ChainSettings
from ..shared import WRENCH_SIZE, SharedValues
from ..state import State
from . import parameters
from .messages import LEVELS, fill_quaternion, fill_vector, ros_time

OUT_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
IN_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
ANSWER_WAIT = 2.0  # s for the loop to carry out a command
MONITOR_RATE = 100.0  # Hz
OWN = (
    ("address", "127.0.0.1", "address of this machine on the robot's network"),
    ("port", 59152, "UDP port that the controller sends to"),
    ("peer", "127.0.0.1", "address of the controller; packets of others are dropped"),
    ("sentype", "IREC", "SENTYPE of the controller's ethernet XML"),
    ("cycle_ms", 4, "4 (IPO_FAST) or 12 (IPO)"),
    ("source", "chain", "chain: compute the offset in the loop's process; offset_topic: follow irec/offset"),
    ("wrench_block", "", "chain: shared memory that can_ft_node writes; empty: the topic wrench or wrench_raw"),
    ("offset_timeout", 0.05, "offset_topic: s without an offset"),
    ("realtime_priority", 0, "SCHED_FIFO priority of the loop, 0: none"),
)


class RsiNode(Node):
    """Creates the blocks, tells the loop its setup, publishes what it reports."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__("rsi_bridge")
        parameters.declare(self)
        for name, default, text in OWN:
            self.declare_parameter(name, default, ParameterDescriptor(description=text))
        self._p = p = parameters.Values(self)
        self._pipe = pipe
        if not p["cell"]:
            raise SettingsError("parameter 'cell' is empty; name a cell file")
        self._cell = read_cell(p["cell"])
        self._serial = str(p["robot_serial"]) or self._cell.serial
        self._report, self._latency = SharedValues.create(REPORT_SIZE), SharedValues.create(KEPT)
        self._wrench, self._offset_in = SharedValues.create(WRENCH_SIZE), SharedValues.create(OFFSET_SIZE)
        self._values = np.zeros(REPORT_SIZE)
        self._version = 0
        self._state, self._reason, self._digest = State.INACTIVE, "not started", ""
        self._answers: list[str] = []
        self.port = self._begin()
        self._create()
        if p["model_path"]:
            why = self._put_in_force(str(p["model_path"]))
            if why:
                raise SettingsError(why)

    def _begin(self) -> int:
        """Send the setup; the port that the loop listens on. Raises SettingsError where it can't."""
        p = self._p
        source = str(p["source"])
        if source not in ("chain", "offset_topic"):
            raise SettingsError(f"parameter 'source' is '{source}'; chain or offset_topic is possible")
        settings = parameters.correction_settings(p, str(p["sensor_frame"]) if p["raw_wrench"] else "tool0")
        chain = None
        if source == "chain":
            chain = ChainSettings(
                correction=settings,
                filters=parameters.filter_settings(p),
                urdf_text=self._cell.robot.urdf_text,
                wrench_block=str(p["wrench_block"]) or self._wrench.name,
                raw=bool(p["raw_wrench"]),
                sensor_frame=str(p["sensor_frame"]),
                load=parameters.tool_load(p),
                cable=parameters.cable(p),
                gravity=p.three("gravity"),
            )
        link = Link(str(p["address"]), int(p["port"]), str(p["peer"]), str(p["sentype"]))
        self._pipe.send(
            BridgeSetup(
                link,
                settings,
                self._report.name,
                self._latency.name,
                chain,
                self._offset_in.name,
                float(p["offset_timeout"]),
                int(p["cycle_ms"]),
                int(p["realtime_priority"]),
            )  # fmt: skip
        )
        kind, content = self._pipe.recv()
        if kind != "ready":
            raise SettingsError(str(content))
        port, refused = content
        for text in refused:
            self.get_logger().warning(text)
        self.get_logger().info(f"answering {link.peer} on {link.address}:{port}, offset from {source}")
        return int(port)

    def _create(self) -> None:
        p = self._p
        self._joints = JointState(name=list(self._cell.robot.joint_names))
        self._pose, self._offset, self._told = PoseStamped(), TransformStamped(), CorrectionState()
        self._joints_out = self.create_publisher(JointState, "joint_states", OUT_QOS)
        self._pose_out = self.create_publisher(PoseStamped, "tcp_pose", OUT_QOS)
        self._state_out = self.create_publisher(CorrectionState, "irec/correction/state", OUT_QOS)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", OUT_QOS)
        if p["source"] == "chain":
            self._offset_out = self.create_publisher(TransformStamped, "irec/offset", OUT_QOS)
            self.create_service(ActivateModel, "irec/correction/activate_model", self._on_activate_model)
            if not p["wrench_block"]:
                topic = "wrench_raw" if p["raw_wrench"] else "wrench"
                self._count = 0
                self.create_subscription(WrenchStamped, topic, self._on_wrench, IN_QOS)
        else:
            self._offset_out = None
            self.create_subscription(TransformStamped, "irec/offset", self._on_offset, IN_QOS)
            self._ask("start")
        self.create_timer(1.0 / MONITOR_RATE, self._on_timer)
        self.create_timer(1.0, self._on_second)

    # -- commands to the loop ------------------------------------------------------------------------------------------

    def _ask(self, command: str, argument: Any = None) -> str:
        """Empty, or why the loop did not do it."""
        self._answers.clear()
        self._pipe.send((command, argument))
        end = time.monotonic() + ANSWER_WAIT
        while not self._answers:
            if time.monotonic() > end:
                return f"the RSI loop did not answer within {ANSWER_WAIT} s"
            self._listen(0.05)
        return self._answers.pop()

    def _listen(self, timeout: float) -> None:
        while self._pipe.poll(timeout):
            kind, content = self._pipe.recv()
            if kind == "answer":
                self._answers.append(content)
                return
            self._state, self._reason = State(content[0]), content[1]
            text = f"{self._state.name}{': ' + self._reason if self._reason else ''}"
            if self._state in (State.HOLD, State.FADE, State.FAULT):
                self.get_logger().warning(text)
            else:
                self.get_logger().info(text)

    def _put_in_force(self, path: str) -> str:
        try:
            model = load_model(path)
            check_belongs(model, self._cell.robot, self._serial, "this cell")
            digest = file_sha256(path)
        except (IrecError, OSError) as error:
            return str(error)
        why = self._ask("model", model)
        if not why:
            self._digest = digest
            why = self._ask("start")
        return why

    def _on_activate_model(self, request: ActivateModel.Request, response: ActivateModel.Response) -> ActivateModel.Response:
        response.message = self._put_in_force(request.model_path) if request.model_path else self._ask("stop")
        response.success = not response.message
        response.sha256 = self._digest if request.model_path else ""
        return response

    # -- into the loop -------------------------------------------------------------------------------------------------

    def _on_wrench(self, message: WrenchStamped) -> None:
        f, t = message.wrench.force, message.wrench.torque
        self._count += 1
        self._wrench.write(np.array([time.monotonic(), self._count, 0.0, f.x, f.y, f.z, t.x, t.y, t.z]))

    def _on_offset(self, message: TransformStamped) -> None:
        t, r = message.transform.translation, message.transform.rotation
        if message.header.frame_id != "base_link":
            self.get_logger().warning(
                f"offset in frame '{message.header.frame_id}' ignored; base_link is needed", throttle_duration_sec=5.0
            )
            return
        w = r.w if r.w >= 0.0 else -r.w
        sign = 1.0 if r.w >= 0.0 else -1.0
        v = sign * np.array([r.x, r.y, r.z])
        sine = float(np.linalg.norm(v))
        turn = v * (2.0 * np.arctan2(sine, w) / sine) if sine > 1e-12 else 2.0 * v
        self._offset_in.write(np.array([time.monotonic(), 1.0, t.x, t.y, t.z, *turn]))

    # -- out of the loop -----------------------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        self._listen(0.0)
        if self._report.version == self._version or not self._report.read(self._values):
            return
        self._version = self._report.version
        v = self._values
        stamp = self.get_clock().now().to_msg()
        self._joints.header.stamp = stamp
        self._joints.position = array("d", v[15 : 15 + len(self._joints.name)].tolist())
        self._joints_out.publish(self._joints)
        self._pose.header.stamp, self._pose.header.frame_id = stamp, "base_link"
        fill_vector(self._pose.pose.position, v[21:24])
        fill_quaternion(self._pose.pose.orientation, _rotation_vector(v[24:27]))
        self._pose_out.publish(self._pose)
        if self._offset_out is not None:
            o = self._offset
            o.header.stamp, o.header.frame_id, o.child_frame_id = stamp, "base_link", "tool0"
            fill_vector(o.transform.translation, v[9:12])
            fill_quaternion(o.transform.rotation, v[12:15])
            self._offset_out.publish(o)
        if int(v[1]) % 25 < 3:
            self._tell_state(stamp)

    def _tell_state(self, stamp: Any) -> None:
        s = self._told
        s.header.stamp, s.header.frame_id = stamp, "base_link"
        s.state, s.reason = int(self._state), self._reason
        fill_vector(s.offset, self._values[9:12])
        s.model_serial, s.model_sha256 = self._serial, self._digest
        s.late = int(self._values[2])
        self._state_out.publish(s)

    def _on_second(self) -> None:
        v = self._values
        latency = self._latency.numbers[: max(1, min(int(v[1]), KEPT))]
        values = {
            "answered": int(v[1]), "late_here": int(v[2]), "late_at_controller": int(v[3]), "lost": int(v[4]),
            "foreign": int(v[5]), "unreadable": int(v[6]), "restarts": int(v[7]),
            "latency_p50_s": float(np.percentile(latency, 50)), "latency_p99_s": float(np.percentile(latency, 99)),
            "latency_max_s": float(latency.max()),
        }  # fmt: skip
        silent = time.monotonic() - v[0] > 0.5
        level = DiagnosticStatus.WARN if silent else LEVELS[self._state]
        text = "no packet of the controller" if silent else f"{self._state.name}{': ' + self._reason if self._reason else ''}"
        status = DiagnosticStatus(
            level=level, name="rsi_bridge: link", message=text, hardware_id=self._serial,
            values=[KeyValue(key=k, value=str(x)) for k, x in values.items()],
        )  # fmt: skip
        message = DiagnosticArray(status=[status])
        message.header.stamp = ros_time(self.get_clock().now().nanoseconds * 1e-9)
        self._diagnostics_out.publish(message)

    def close(self) -> None:
        """Remove the blocks; the loop keeps its own hold on them."""
        for block in (self._report, self._latency, self._wrench, self._offset_in):
            block.close()


def _rotation_vector(abc: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("ZYX", abc).as_rotvec()


def main(pipe: Connection, arguments: list[str]) -> int:
    """Run the node; exit code."""
    rclpy.init(args=arguments)
    try:
        node = RsiNode(pipe)
    except Exception as error:  # IrecError, and whatever rclpy raises for parameters out of range
        print(f"rsi_bridge: error: {error}", file=sys.stderr)
        pipe.send(None)
        rclpy.try_shutdown()
        return 2
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException, EOFError, BrokenPipeError):
        pass
    finally:
        node.close()
        rclpy.try_shutdown()
    return 0
