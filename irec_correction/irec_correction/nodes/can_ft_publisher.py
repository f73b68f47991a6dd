# SPDX-License-Identifier: Apache-2.0
"""The ROS side of the CAN force sensor: parameters in, wrench_raw, diagnostics and the bias service out.

A lifecycle node: configured, the bus is open; active, readings are passed on; cleaned up, the bus is free.
"""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from irec_ros.diagnostics import ERROR, OK, WARN, Diagnostics, status
from irec_ros.parameters import Parameters
from irec_ros.startup import refuse_unknown_parameters
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from ..can_ft.netft_can import Calibration, errors_of
from ..can_ft.process import COUNTS, RECORD, SensorSetup
from ..can_ft.reader import Bus, ReaderSettings
from ..errors import SettingsError
from .managed import Managed, run_managed
from .messages import fill_vector, ros_time
from .parameters import CAN_FT

OUT_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
ANSWER_WAIT = 1.0  # s
RELEASE_WAIT = 5.0  # s for bus and block to be closed
SILENT = 0.5  # s without a reading
SPOILT = 5  # answers in a second that were spoilt on the bus, beyond which somebody should look at it


class CanFtNode(Managed):
    """Publishes wrench_raw; the service ~/bias takes the present reading as zero (only without contact)."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__("can_ft_node")
        self._p = Parameters(self, CAN_FT)
        refuse_unknown_parameters(self)
        self._status = self._diagnostics = Diagnostics(self)
        self._pipe = pipe
        self._frame, self._short = str(self._p["frame_id"]), bool(self._p["short_answers"])
        self._reading = False  # the sensor
        self._message = WrenchStamped()
        self._message.header.frame_id = self._frame
        self._last: tuple[Any, ...] | None = None
        self._came_in = 0.0
        self.listener: threading.Thread | None = None  # receives from the sensor's process
        self._foreign = 0  # requests of another device up to the last second
        self._flooded = self._spoilt = 0  # counts up to the last second
        self._out = self.create_publisher(WrenchStamped, "wrench_raw", OUT_QOS)
        self.create_service(Trigger, "~/bias", self._on_bias)
        self.create_timer(1.0, self._on_second, clock=Clock(clock_type=ClockType.STEADY_TIME))
        if self._p["autostart"]:
            self.go_through(self.trigger_configure, self.trigger_activate)

    # -- lifecycle -----------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Pass readings on. Raises SettingsError."""
        if why := self._ask("pass on"):
            raise SettingsError(why)

    def stop(self) -> None:
        """Pass no more readings on; the sensor is read all the same."""
        self._ask("pause")

    def release(self) -> None:
        """Free bus and block."""
        if self._reading:
            self._ask("release", RELEASE_WAIT)
        self._reading = False
        self._last = None

    def _ask(self, command: str, wait: float = ANSWER_WAIT) -> str:
        """Empty, or why the sensor's process did not do it."""
        self._pipe.send(command)
        if not self._pipe.poll(wait):
            return f"the sensor's process did not answer in {wait} s"
        return str(self._pipe.recv())

    def configure(self) -> None:
        """Open bus and block. Raises SettingsError."""
        p = self._p
        scale = tuple(float(x) for x in p["short_scale"])
        if len(scale) != 6:
            raise SettingsError(f"parameter 'short_scale' has {len(scale)} numbers, it needs 6")
        calibration = Calibration(
            p["counts_per_force"],
            p["counts_per_torque"],
            p["to_newton"],
            p["to_newton_metre"],
            scale,
        )
        bus = Bus(str(p["interface"]), str(p["channel"]), int(p["bitrate"]))
        reader = ReaderSettings(bus, int(p["base_id"]), p["rate"], self._short, p["sensor_rate"], calibration)
        self._pipe.send(SensorSetup(reader, str(p["block"]), int(p["realtime_priority"])))
        kind, content = self._pipe.recv()
        if kind != "ready":
            raise SettingsError(str(content))
        for text in content:
            self.get_logger().warning(text)
        self.get_logger().info(f"reading {bus.interface}:{bus.channel}, base identifier {reader.base:#x}, {reader.rate:g} Hz")
        self._reading = True

    def take(self, record: bytes) -> None:
        """Publish one record; called in the thread that receives from the sensor's process."""
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
        response.message = self._ask("bias") if self._reading else "not configured: the sensor is not read"
        response.success = not response.message
        response.message = (
            response.message or "the present reading is zero from now on; identify the tool load again where it is removed"
        )
        return response

    def ended(self) -> None:
        """Wait for the thread that receives."""
        if self.listener is not None:
            self.listener.join(1.0)

    def _on_second(self) -> None:
        level, text, values = OK, "reading", {}
        if self._last is not None:
            _, *_, status_word, sample = self._last[:9]
            counts = dict(zip(COUNTS, self._last[9:], strict=True))
            values = {"status": f"{status_word:#x}", "sample": sample, **counts}
            errors = errors_of(status_word, self._short)
            level, text = self._judge_counts(counts)
            if errors:
                level, text = ERROR, "sensor reports " + ", ".join(errors)
        if not self.active:
            level, text = WARN, "not active: readings are not passed on"
        elif time.monotonic() - self._came_in > SILENT:
            level, text = ERROR, f"no reading from the sensor{'' if text == 'reading' else '; ' + text}"
        if errors_here := "; ".join(self.errors.values()):
            level, text = ERROR, f"{text}; {errors_here}"
        self._status.publish(status(self, "sensor", level, text, values, self._frame))

    def _judge_counts(self, counts: dict[str, int]) -> tuple[bytes, str]:
        """What somebody else does on the bus."""
        asked, self._foreign = counts["foreign_requests"] - self._foreign, counts["foreign_requests"]
        flooded, self._flooded = counts["flooded"] - self._flooded, counts["flooded"]
        spoilt = counts["bad"] + counts["incomplete"]
        spoilt, self._spoilt = spoilt - self._spoilt, spoilt
        if counts["foreign_bias"]:
            return (
                ERROR,
                "another device has set the sensor's zero: set it again without contact (~/bias), and end that device",
            )
        if flooded:
            return ERROR, "more frames with the sensor's identifiers come than can be read: look for what else sends on its bus"
        if asked:
            return WARN, f"another device asks the sensor too, {asked} times in the last second: answers may be cut off"
        if spoilt > SPOILT:
            return (
                WARN,
                f"{spoilt} answers of the last second were of the wrong length or lost a frame, more than {SPOILT}: look for"
                " another device with the sensor's identifiers, and at bit rate, cable and termination",
            )
        return OK, "reading"


def main(pipe: Connection, records: socket.socket, arguments: list[str]) -> int:
    """Run the node; exit code."""
    records.settimeout(0.2)

    def make(asked_to_stop: threading.Event) -> CanFtNode:
        node = CanFtNode(pipe)
        take = node.guarded("record of the sensor", node.take)

        def receive() -> None:
            while not asked_to_stop.is_set():
                try:
                    data = records.recv(RECORD.size)
                    if not asked_to_stop.is_set():
                        take(data)
                except TimeoutError:
                    continue
                except (OSError, RuntimeError):
                    return

        node.listener = threading.Thread(target=receive, daemon=True)
        node.listener.start()
        return node

    def if_refused() -> None:
        with contextlib.suppress(OSError):  # the sensor's process has ended already where it was the one that refused
            pipe.send(None)

    return run_managed("can_ft_node", make, arguments, executor_type=SingleThreadedExecutor, if_refused=if_refused)
