# SPDX-License-Identifier: Apache-2.0
"""The simulated cell behind ros2_control: what its trajectory controller and broadcasters offer, and a tracker; no more.

    ros2 run irec_sim ros2_control_node --ros-args -p cell:=afp

Topics as joint_trajectory_controller, joint_state_broadcaster and force_torque_sensor_broadcaster have them: positions in, by
name and time from now; joint states and the raw sensor out. It has no force control, no dead man's switch, no offset: a driver
has to add them. Where no point comes it holds the last one.
"""

from __future__ import annotations

import sys
import threading
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped, WrenchStamped
from irec_ros.guard import GuardedNode
from irec_ros.parameters import Parameters
from irec_ros.startup import refuse_unknown_parameters, run_process, spin_node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from ..errors import SimError
from ..trajectory import TrajectoryFollower
from .cell_parameters import PARAMETERS, cell_of, instruments_of
from .followers import Followers
from .loop import SimulationLoop
from .messages import point_message, wrench_message
from .streams import SENSOR_QOS, Stream, Streams, Template, ros_time

CONTROLLER, SENSOR = "joint_trajectory_controller/joint_trajectory", "force_torque_sensor_broadcaster/wrench"
NUMBERS = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


class Ros2ControlNode(GuardedNode):
    """Parameters: those of the cell; the rates of what it does not publish mean nothing."""

    def __init__(self) -> None:
        super().__init__("ros2_control")
        p = Parameters(self, PARAMETERS)
        refuse_unknown_parameters(self)
        self.cell = cell = cell_of(p, instruments_of(p))
        self._controller = TrajectoryFollower(cell)
        self._names = self._controller.names
        self.followers = Followers(self, p["max_lead"])
        self.loop = SimulationLoop(
            self._step, cell.period, p["speed_factor"], lambda: self.followers.may_go_on(cell.time), self._flush
        )
        p.when_set("speed_factor", lambda speed: setattr(self.loop, "speed", speed))
        ones = [float(k + 1) for k in range(len(self._names))]
        self._joints = Template(JointState(name=self._names, position=ones), ones)
        self._sensor = Template(wrench_message("ft_sensor", NUMBERS), NUMBERS)
        self._outbox: list[tuple[Any, Any]] = []
        kinds = {"joint_states": JointState, SENSOR: WrenchStamped, "tracker/point": PointStamped, "/clock": Clock}
        self._out = {topic: self.create_publisher(kind, topic, SENSOR_QOS) for topic, kind in kinds.items()}
        self._streams = Streams(
            [Stream(p["rate.joint_states"], self._send_joints), Stream(p["rate.wrench_raw"], self._send_sensor),
             Stream(p["rate.tracker"], self._send_point), Stream(p["rate.clock"], self._send_clock)], cell.period,
        )  # fmt: skip
        self.create_subscription(JointTrajectory, CONTROLLER, self._on_trajectory, 10)

    def _on_trajectory(self, m: JointTrajectory) -> None:
        if sorted(m.joint_names) != sorted(self._names):
            self.get_logger().error(f"trajectory refused: joints {list(m.joint_names)}, the controller has {self._names}")
            return
        order = [list(m.joint_names).index(name) for name in self._names]
        points = [(p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec, np.array(p.positions)[order]) for p in m.points]
        self.loop.call(lambda: self._controller.take(points))

    def _step(self) -> None:
        self._controller.before_step()
        self.cell.step()
        self._streams.after_step()

    def _put(self, topic: str, message: Any) -> None:
        self._outbox.append((self._out[topic], message))

    def _send_joints(self) -> None:
        q, rail = self.cell.joints()
        values = [*q.tolist(), rail] if self.cell.rail_names else q.tolist()
        self._put("joint_states", self._joints.serialized(ros_time(self.cell.time), values))

    def _send_sensor(self) -> None:
        self._put(SENSOR, self._sensor.serialized(ros_time(self.cell.time), self.cell.wrench_raw().tolist()))

    def _send_point(self) -> None:
        reading = self.cell.tracker()
        if reading is not None:
            message = point_message(reading[0], reading[1].tolist())
            message.header.stamp = ros_time(self.cell.time)
            self._put("tracker/point", message)

    def _send_clock(self) -> None:
        self._put("/clock", Clock(clock=ros_time(self.cell.time)))

    def _flush(self) -> None:
        for publisher, message in self._outbox:
            publisher.publish(message)
        self._outbox.clear()


def main() -> int:
    """Until SIGINT, SIGTERM or SIGHUP; 2 where a parameter or file is wrong."""
    return run_process("ros2_control", _work, SimError)


def _work(asked_to_stop: threading.Event) -> None:
    node = Ros2ControlNode()
    node.loop.start()
    spin_node(node, asked_to_stop, done=lambda: node.loop.failure is not None)
    node.loop.stop()
    if node.loop.failure is not None:
        raise node.loop.failure


if __name__ == "__main__":
    sys.exit(main())
