# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: everything that the driver of a real one would offer, from one process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3, WrenchStamped
from irec_msgs.msg import RobotState
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String

from ..errors import SimError
from ..kinematics import quaternion_of_rotation
from .followers import Followers
from .loop import SimulationLoop
from .plant import Plant
from .robot_side import RobotSide
from .streams import LATCHED_QOS, SENSOR_QOS, Stream, Streams, ros_time

RATES = {  # Hz of simulated time
    "clock": 100.0,
    "joint_states": 100.0,
    "tcp_pose": 100.0,
    "wrench": 250.0,
    "wrench_raw": 250.0,
    "tracker": 100.0,
    "temperature": 1.0,
    "state": 10.0,
    "diagnostics": 1.0,
}
MODE_NAMES = {RobotState.MODE_POSITION: "position", RobotState.MODE_FORCE: "force", RobotState.MODE_FAULT: "fault"}


class CellNode(Node):
    """Robot, force sensor and tracker of a cell on the topics of the README."""

    def __init__(self, make_plant: Callable[[Node], Plant]) -> None:
        super().__init__("cell")
        speed = self._number("speed_factor", 1.0, "simulated seconds per second of the machine's clock, > 0; can be set at any time")
        max_lead = self._number("max_lead", 0.25, "simulated s that the cell may be ahead of its slowest follower")
        rail_speed = self._number("rail_speed", 1.0, "velocity limit of the rail, m/s")
        rates = {
            name: self._number(f"rate.{name}", rate, f"publications of {name} per simulated second, Hz; 0: never")
            for name, rate in RATES.items()
        }
        self.plant = plant = make_plant(self)
        self.followers = Followers(self, max_lead)
        self.loop = SimulationLoop(self._step, plant.period, speed, lambda: self.followers.may_go_on(plant.time))
        self.robot = RobotSide(self, plant, self.loop, rail_speed)
        self._mode: int | None = None
        self._joints = JointState(name=[*plant.chain.joint_names, *plant.rail_names])
        self._pose = PoseStamped()
        self._pose.header.frame_id = "base_link"
        self._wrench, self._raw = WrenchStamped(), WrenchStamped()
        self._wrench.header.frame_id, self._raw.header.frame_id = "tool0", "ft_sensor"
        self._point = PointStamped()
        self._publish_state = self.create_publisher(RobotState, "robot/state", SENSOR_QOS).publish
        self._publish_temperature: dict[str, Callable[[Any], None]] = {}
        self._streams = Streams(
            [
                Stream(rates["joint_states"], self._sender(JointState, "joint_states", self._fill_joints)),
                Stream(rates["tcp_pose"], self._sender(PoseStamped, "tcp_pose", self._fill_pose)),
                Stream(rates["wrench"], self._sender(WrenchStamped, "wrench", self._fill_wrench)),
                Stream(rates["wrench_raw"], self._sender(WrenchStamped, "wrench_raw", self._fill_raw)),
                Stream(rates["tracker"], self._sender(PointStamped, "tracker/point", self._fill_point)),
                Stream(rates["temperature"], self._send_temperatures),
                Stream(rates["state"], self._send_state),
                Stream(rates["diagnostics"], self._sender(DiagnosticArray, "diagnostics", self._diagnostics)),
                Stream(rates["clock"], self._sender(Clock, "/clock", lambda: Clock(clock=self._now))),
            ],
            plant.period,
        )
        description = self.create_publisher(String, "robot_description", LATCHED_QOS)
        description.publish(String(data=plant.chain.text))
        self._now = ros_time(plant.time)
        self.add_on_set_parameters_callback(self._on_parameters)

    def _step(self) -> None:
        self.robot.before_step()
        self.plant.step()
        self._now = ros_time(self.plant.time)
        if self.plant.mode != self._mode:
            self._mode = self.plant.mode
            self._send_state()
        self._streams.after_step()

    def _sender(self, message_class: type, topic: str, fill: Callable[[], Any]) -> Callable[[], None]:
        publisher = self.create_publisher(message_class, topic, SENSOR_QOS)

        def send() -> None:
            message = fill()
            if message is not None:
                publisher.publish(message)

        return send

    def _fill_joints(self) -> JointState:
        q, rail = self.plant.joints()
        self._joints.header.stamp = self._now
        self._joints.position = [*q.tolist(), *([float(rail)] if self.plant.rail_names else [])]
        return self._joints

    def _fill_pose(self) -> PoseStamped:
        p, R = self.plant.tcp()
        message = self._pose
        message.header.stamp = self._now
        position, orientation = message.pose.position, message.pose.orientation
        position.x, position.y, position.z = p.tolist()
        orientation.x, orientation.y, orientation.z, orientation.w = quaternion_of_rotation(R).tolist()
        return message

    def _fill_wrench(self) -> WrenchStamped:
        return self._filled(self._wrench, self.plant.wrench())

    def _fill_raw(self) -> WrenchStamped:
        return self._filled(self._raw, self.plant.wrench_raw())

    def _filled(self, message: WrenchStamped, values: Any) -> WrenchStamped:
        message.header.stamp = self._now
        force, torque = message.wrench.force, message.wrench.torque
        force.x, force.y, force.z, torque.x, torque.y, torque.z = values.tolist()
        return message

    def _fill_point(self) -> PointStamped | None:
        reading = self.plant.tracker()
        if reading is None:
            return None
        message = self._point
        message.header.stamp, message.header.frame_id = self._now, reading[0]
        message.point.x, message.point.y, message.point.z = reading[1].tolist()
        return message

    def _send_temperatures(self) -> None:
        for name, value in self.plant.temperatures().items():
            if name not in self._publish_temperature:
                self._publish_temperature[name] = self.create_publisher(Temperature, f"temperature/{name}", SENSOR_QOS).publish
            message = Temperature(temperature=float(value))
            message.header.stamp, message.header.frame_id = self._now, name
            self._publish_temperature[name](message)

    def _send_state(self) -> None:
        x, y, z = self.plant.offset.tolist()
        message = RobotState(
            mode=int(self.plant.mode),
            in_motion=self.robot.in_motion,
            offset=Vector3(x=x, y=y, z=z),
            late_offsets=int(self.plant.late_offsets),
        )
        message.header.stamp, message.header.frame_id = self._now, "base_link"
        self._publish_state(message)

    def _diagnostics(self) -> DiagnosticArray:
        values = {
            "mode": MODE_NAMES[self.plant.mode],
            "in motion": str(self.robot.in_motion),
            "late offsets": str(self.plant.late_offsets),
            "speed factor": f"{self.loop.speed:g}",
        }
        status = DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name="cell",
            message="simulated",
            hardware_id="simulator",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._now
        return message

    def _number(self, name: str, default: float, description: str) -> float:
        value = float(self.declare_parameter(name, default, ParameterDescriptor(description=description)).value)
        problem = _problem(name, value)
        if problem:
            raise SimError(problem)
        return value

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "speed_factor":
                problem = _problem(parameter.name, float(parameter.value))
                if problem:
                    return SetParametersResult(successful=False, reason=problem)
                self.loop.speed = float(parameter.value)
            else:
                return SetParametersResult(successful=False, reason=f"{parameter.name} can only be set at the start")
        return SetParametersResult(successful=True)


def _problem(name: str, value: float) -> str:
    """Why a number can't be the value of a parameter; empty where it can."""
    if name.startswith("rate."):
        return "" if 0.0 <= value <= 250.0 else f"parameter '{name}' is {value:g} Hz; 0 to 250 Hz are possible"
    return "" if 0.0 < value < 1000.0 else f"parameter '{name}' is {value:g}; a number above 0 and below 1000 is needed"


def run(make_plant: Callable[[Node], Plant]) -> int:
    """Run the cell until SIGINT or SIGTERM; 2 where the plant can't be made."""
    rclpy.init()
    try:
        node = CellNode(make_plant)
        executor = EventsExecutor()
        executor.add_node(node)
        node.loop.start()
        try:
            while rclpy.ok() and node.loop.failure is None:
                executor.spin_once(timeout_sec=0.5)
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        finally:
            node.loop.stop()
        if node.loop.failure is not None:
            raise node.loop.failure
    except SimError as error:
        print(f"cell: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0
