# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the RSI bridge: parameters and models in, measurements and diagnostics out. Nothing waits for it."""

from __future__ import annotations

import contextlib
import sys
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_calibration.model_file import file_sha256, load_model
from irec_calibration.nodes.startup import begin, refuse_unknown_parameters
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from irec_msgs.srv import ActivateModel

from ..errors import SettingsError
from ..rsi.bridge import BridgeSetup
from ..rsi.loop import Link
from ..rsi.report import KEPT, REPORT_SIZE
from ..rsi.sources import OFFSET_SIZE, ChainSettings
from ..shared import WRENCH_SIZE, SharedValues
from . import parameters
from .model_checks import affordable, check_mounted
from .rsi_monitor import MONITOR_RATE, RsiMonitor

IN_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
ANSWER_WAIT = 2.0  # s for the loop to carry out a command
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
    ("realtime_processor", -1, "processor that the loop stays on (isolcpus=), from 0; -1: any"),
)


class RsiNode(Node):
    """Creates the blocks, tells the loop its setup, publishes what it reports."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__("rsi_bridge")
        parameters.declare(self)
        for name, default, text in OWN:
            self.declare_parameter(name, default, ParameterDescriptor(description=text))
        refuse_unknown_parameters(self)
        self._p = p = parameters.Values(self)
        self._pipe = pipe
        if not p["cell"]:
            raise SettingsError("parameter 'cell' is empty; name a cell file")
        self._cell = read_cell(p["cell"])
        self._serial = str(p["robot_serial"]) or self._cell.serial
        self._report, self._latency = SharedValues.create(REPORT_SIZE), SharedValues.create(KEPT)
        self._wrench, self._offset_in = SharedValues.create(WRENCH_SIZE), SharedValues.create(OFFSET_SIZE)
        self._answers: list[str] = []
        names = list(self._cell.robot.joint_names)
        self._monitor = RsiMonitor(self, self._report, self._latency, names, self._serial, p["source"] == "chain")
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
        if p["cycle_ms"] not in (4, 12):
            raise SettingsError(f"parameter 'cycle_ms' is {p['cycle_ms']}; 4 (IPO_FAST) or 12 (IPO) is possible")
        period = 1e-3 * p["cycle_ms"]  # parameter 'rate' is that of correction_node
        frame = str(p["sensor_frame"]) if p["raw_wrench"] else "tool0"
        settings = replace(parameters.correction_settings(p, frame), period=period)
        filters = parameters.filter_settings(p)
        if filters.rate > 1.0 / period:  # one reading per cycle goes through the chain, the newest
            self.get_logger().info(f"filters act at {1.0 / period:g} Hz, the rate of RSI, not at wrench_rate {filters.rate:g} Hz")
            filters = replace(filters, rate=1.0 / period)
        chain = None
        if source == "chain":
            chain = ChainSettings(
                correction=settings,
                filters=filters,
                urdf_text=self._cell.robot.urdf_text,
                wrench_block=str(p["wrench_block"]) or self._wrench.name,
                raw=bool(p["raw_wrench"]),
                sensor_frame=str(p["sensor_frame"]),
                load=parameters.tool_load(p),
                cable=parameters.cable(p),
                gravity=p.three("gravity"),
                payload=self._cell.payload,
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
                int(p["realtime_processor"]),
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
        if p["source"] == "chain":
            self.create_service(ActivateModel, "irec/correction/activate_model", self._on_activate_model)
            if not p["wrench_block"]:
                topic = "wrench_raw" if p["raw_wrench"] else "wrench"
                self._count = 0
                self.create_subscription(WrenchStamped, topic, self._on_wrench, IN_QOS)
        else:
            self.create_subscription(TransformStamped, "irec/offset", self._on_offset, IN_QOS)
            self._ask("start")
        self.create_timer(1.0 / MONITOR_RATE, self._on_timer)
        self.create_timer(1.0, self._monitor.tell_second)

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
            self._monitor.hear(kind, content)

    def _put_in_force(self, path: str) -> str:
        try:
            model, digest = load_model(path), file_sha256(path)
            check_mounted(model, self._cell.robot, self._serial, str(self._p["tool"]))
            affordable(model, self._cell.robot, self._p.three("gravity"), self._cell.payload, 1e-3 * self._p["cycle_ms"])
        except (IrecError, OSError) as error:
            return str(error)
        why = self._ask("model", model)
        if not why:
            self._monitor.digest = digest
            why = self._ask("start")
        return why

    def _on_activate_model(self, request: ActivateModel.Request, response: ActivateModel.Response) -> ActivateModel.Response:
        response.message = self._put_in_force(request.model_path) if request.model_path else self._ask("stop")
        response.success = not response.message
        response.sha256 = self._monitor.digest if response.success and request.model_path else ""
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
        self._monitor.tell()

    def close(self) -> None:
        """Remove the blocks; the loop keeps its own hold on them."""
        for block in (self._report, self._latency, self._wrench, self._offset_in):
            block.close()


def main(pipe: Connection, arguments: list[str]) -> int:
    """Run the node; exit code."""
    if not begin("rsi_bridge", args=arguments):
        return 2
    try:
        node = RsiNode(pipe)
    except Exception as error:  # IrecError, and whatever rclpy raises for parameters out of range
        print(f"rsi_bridge: error: {error}", file=sys.stderr)
        with contextlib.suppress(OSError):  # the loop's process has ended already where it was the one that refused
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
