# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: everything that the driver of a real one would offer, from one process."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, WrenchStamped
from irec_ros.diagnostics import TOPIC as DIAGNOSTICS
from irec_ros.guard import GuardedNode
from irec_ros.parameters import Parameters
from irec_ros.startup import refuse_unknown_parameters, run_process, spin_node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String

from irec_msgs.msg import RobotState

from ..errors import SimError
from .cell_parameters import PARAMETERS, cell_of, instruments_of, lease_of
from .course_side import CourseSide
from .followers import Followers
from .loop import SimulationLoop
from .readings import Now, Readings
from .robot_side import RobotSide
from .streams import LATCHED_QOS, SENSOR_QOS, Stream, Streams, ros_time


class CellNode(GuardedNode):
    """Robot, force sensor and tracker of a cell on the topics of the README. Parameters: see cell_parameters.py."""

    def __init__(self) -> None:
        super().__init__("cell")
        p = Parameters(self, PARAMETERS)
        settings = instruments_of(p)
        self.cell = cell = cell_of(p, settings)
        self.followers = Followers(self, p["max_lead"])
        self.loop = SimulationLoop(
            self._step, cell.period, p["speed_factor"], lambda: self.followers.may_go_on(cell.time), self._flush
        )
        p.when_set("speed_factor", lambda speed: setattr(self.loop, "speed", speed))
        self.robot = RobotSide(self, cell, self.loop, p["rail_speed"], lease_of(p))
        self.course: CourseSide | None = None
        self._outbox: list[tuple[Publisher, Any]] = []  # messages, or serialized ones
        self._now = Now(ros_time(cell.time))
        self._mode: tuple[int, bool] | None = None
        self._temperature: dict[str, Publisher] = {}
        self.readings = r = Readings(self, cell, self.robot, settings, self._now)
        self._send_state = self._sender(RobotState, "robot/state", r.state)
        senders = {
            "joint_states": self._sender(JointState, "joint_states", r.joints),
            "tcp_pose": self._sender(PoseStamped, "tcp_pose", r.pose),
            "wrench": self._sender(WrenchStamped, "wrench", r.wrench),
            "wrench_raw": self._sender(WrenchStamped, "wrench_raw", r.wrench_raw),
            "tracker": self._sender(PointStamped, "tracker/point", r.point),
            "temperature": self._send_temperatures,
            "state": self._send_state,
            "diagnostics": self._sender(DiagnosticArray, DIAGNOSTICS, lambda: r.diagnostics(self.loop.speed)),
            "clock": self._sender(Clock, "/clock", lambda: Clock(clock=self._now.stamp)),
        }
        self._streams = Streams([Stream(p[f"rate.{name}"], send) for name, send in senders.items()], cell.period)
        self.create_publisher(String, "robot_description", LATCHED_QOS).publish(String(data=cell.chain.text))

    def _step(self) -> None:
        self.robot.before_step()
        self.cell.step()
        self._now.stamp = ros_time(self.cell.time)
        mode = self.cell.mode, self.robot.retreating
        if mode != self._mode:
            self._mode = mode
            self._send_state()
        if self.course is not None:
            self.course.after_step()
        self._streams.after_step()

    def _sender(self, message_class: type, topic: str, fill: Callable[[], Any]) -> Callable[[], None]:
        """What publishes the message, whole or serialized, that `fill` returns; nothing where that is None."""
        publisher = self.create_publisher(message_class, topic, SENSOR_QOS)

        def send() -> None:
            message = fill()
            if message is not None:
                self._outbox.append((publisher, message))  # sent with the next flush

        return send

    def _flush(self) -> None:
        for publisher, message in self._outbox:
            publisher.publish(message)
        self._outbox.clear()

    def _send_temperatures(self) -> None:
        for name, message in self.readings.temperatures().items():
            if name not in self._temperature:
                self._temperature[name] = self.create_publisher(Temperature, f"temperature/{name}", SENSOR_QOS)
            self._outbox.append((self._temperature[name], message))


def main() -> int:
    """Run the cell until SIGINT, SIGTERM or SIGHUP; 2 where a parameter or file is wrong."""
    return run_process("cell", lambda asked_to_stop: run(CellNode(), asked_to_stop), SimError)


def run(node: CellNode, asked_to_stop: threading.Event) -> None:
    """The cell and its course until it is asked to stop; raises what ended the simulation."""
    # a launch file gives its name with __node:=, which would go for both
    simulator = GuardedNode("simulator", cli_args=["--ros-args", "-r", "__node:=simulator"])
    node.course = CourseSide(simulator, node.cell, node.loop, node.robot, asked_to_stop)
    refuse_unknown_parameters(node, simulator)
    work = (asked_to_stop, lambda: node.loop.failure is not None)
    course_thread = threading.Thread(target=spin_node, args=(simulator, *work), name="course", daemon=True)
    node.loop.start()
    course_thread.start()
    spin_node(node, *work)
    node.loop.stop()
    course_thread.join(1.0)
    if node.loop.failure is not None:
        raise node.loop.failure


if __name__ == "__main__":
    sys.exit(main())
