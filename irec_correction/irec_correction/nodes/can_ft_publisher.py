# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the CAN force sensor: parameters in, wrench_raw, diagnostics and the bias service out."""

from __future__ import annotations

import contextlib
import math
import socket
import sys
import threading
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import WrenchStamped
from irec_calibration.nodes.startup import begin, refuse_unknown_parameters
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ..can_ft.netft_can import Calibration, errors_of
from ..can_ft.process import RECORD, SensorSetup
from ..can_ft.reader import Bus, ReaderSettings
from ..errors import SettingsError
from .messages import fill_vector, ros_time

OUT_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
ANSWER_WAIT = 1.0  # s
PARAMETERS = (
    ("interface", "socketcan", "python-can interface: socketcan, slcan, virtual, ..."),
    ("channel", "can0", "channel of it: can0, /dev/ttyUSB0, ..."),
    ("bitrate", 1_000_000, "bit/s"),
    ("base_id", 0x40, "base identifier of the sensor (DIP switches)"),
    ("rate", 250.0, "readings per second, Hz"),
    ("short_answers", False, "answers of 16 bits (two frames) in place of 32 bits (four frames)"),
    ("sensor_rate", 7000.0, "samples per second by which the sensor's counter goes on"),
    ("counts_per_force", 1e6, "counts per unit of force, from the sensor's calibration page (cfgcpf)"),
    ("counts_per_torque", 1e6, "counts per unit of torque (cfgcpt)"),
    ("to_newton", 1.0, "newtons per unit of force: 1, or 4.4482216 for lbf"),
    ("to_newton_metre", 1.0, "N m per unit of torque: 1, or 0.11298483 for lbf in"),
    ("short_scale", [1.0] * 6, "counts of the long answer per count of the short one, Fx Fy Fz Tx Ty Tz"),
    ("frame_id", "ft_sensor", "frame of the readings"),
    ("block", "irec_wrench", "name of the shared memory that rsi_bridge can read (wrench_block)"),
    ("realtime_priority", 0, "SCHED_FIFO priority of the reading process, 0: none"),
)


class CanFtNode(Node):
    """Publishes wrench_raw; the service ~/bias takes the present reading as zero (only without contact)."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__("can_ft_node")
        for name, default, text in PARAMETERS:
            self.declare_parameter(name, default, ParameterDescriptor(description=text))
        refuse_unknown_parameters(self)
        self._pipe = pipe
        self._frame, self._short = str(self._get("frame_id")), bool(self._get("short_answers"))
        self._begin()
        self._message = WrenchStamped()
        self._message.header.frame_id = self._frame
        self._last: tuple[Any, ...] | None = None
        self._came_in = 0.0
        self._out = self.create_publisher(WrenchStamped, "wrench_raw", OUT_QOS)
        self._diagnostics_out = self.create_publisher(DiagnosticArray, "/diagnostics", OUT_QOS)
        self.create_service(Trigger, "~/bias", self._on_bias)
        self.create_timer(1.0, self._on_second)

    def _get(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _begin(self) -> None:
        scale = tuple(float(x) for x in self._get("short_scale"))
        if len(scale) != 6:
            raise SettingsError(f"parameter 'short_scale' has {len(scale)} numbers, it needs 6")
        calibration = Calibration(
            self._get("counts_per_force"),
            self._get("counts_per_torque"),
            self._get("to_newton"),
            self._get("to_newton_metre"),
            scale,
        )
        bus = Bus(str(self._get("interface")), str(self._get("channel")), int(self._get("bitrate")))
        reader = ReaderSettings(
            bus, int(self._get("base_id")), self._get("rate"), self._short, self._get("sensor_rate"), calibration
        )
        self._pipe.send(SensorSetup(reader, str(self._get("block")), int(self._get("realtime_priority"))))
        kind, content = self._pipe.recv()
        if kind != "ready":
            raise SettingsError(str(content))
        for text in content:
            self.get_logger().warning(text)
        self.get_logger().info(f"reading {bus.interface}:{bus.channel}, base identifier {reader.base:#x}, {reader.rate:g} Hz")

    def take(self, record: bytes) -> None:
        """Publish one record; called in the thread that hears the sensor's process."""
        values = RECORD.unpack(record)
        self._last = values
        if math.isnan(values[1]) or errors_of(values[7], self._short):  # a reading that is not to be believed gets stale
            return
        self._came_in = time.monotonic()
        self._message.header.stamp = ros_time(values[0])
        fill_vector(self._message.wrench.force, np.array(values[1:4]))
        fill_vector(self._message.wrench.torque, np.array(values[4:7]))
        self._out.publish(self._message)

    def _on_bias(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._pipe.send("bias")
        response.message = (
            self._pipe.recv() if self._pipe.poll(ANSWER_WAIT) else f"the sensor's process did not answer in {ANSWER_WAIT} s"
        )
        response.success = not response.message
        response.message = (
            response.message or "the present reading is zero from now on; identify the tool load again where it is removed"
        )
        return response

    def _on_second(self) -> None:
        status = DiagnosticStatus(
            name="can_ft_node: sensor", hardware_id=self._frame, level=DiagnosticStatus.OK, message="reading"
        )
        if self._last is not None:
            _, *_, word, sample, readings, unanswered, gaps, repeated, bad, failures = self._last
            errors = errors_of(word, self._short)
            values = {"status": f"{word:#x}", "sample": sample, "readings": readings, "unanswered": unanswered, "gaps": gaps,
                      "repeated": repeated, "bad": bad, "bus_failures": failures}  # fmt: skip
            status.values = [KeyValue(key=k, value=str(v)) for k, v in values.items()]
            if errors:
                status.level, status.message = DiagnosticStatus.ERROR, "sensor reports " + ", ".join(errors)
        if time.monotonic() - self._came_in > 0.5:
            status.level, status.message = DiagnosticStatus.ERROR, "no reading from the sensor"
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics_out.publish(message)


def main(pipe: Connection, records: socket.socket, arguments: list[str]) -> int:
    """Run the node; exit code."""
    if not begin("can_ft_node", args=arguments):
        return 2
    try:
        node = CanFtNode(pipe)
    except Exception as error:  # IrecError, and whatever rclpy raises for parameters
        print(f"can_ft_node: error: {error}", file=sys.stderr)
        with contextlib.suppress(OSError):  # the sensor's process has ended already where it was the one that refused
            pipe.send(None)
        rclpy.try_shutdown()
        return 2
    records.settimeout(0.2)

    def hear() -> None:
        while rclpy.ok():
            try:
                data = records.recv(RECORD.size)
                if rclpy.ok():
                    node.take(data)
            except TimeoutError:
                continue
            except (OSError, RuntimeError):
                return

    listener = threading.Thread(target=hear, daemon=True)
    listener.start()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
        listener.join(1.0)
    return 0
