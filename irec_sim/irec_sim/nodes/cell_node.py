# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: everything that the driver of a real one would offer, from one process."""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3, WrenchStamped
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import String

from irec_msgs.msg import RobotState

from ..cell import Cell
from ..cellfile import read_cell
from ..errors import SimError
from ..instruments import Delay, InstrumentSettings
from ..kinematics import quaternion_of_rotation
from ..truth import make_truth, read_truth
from .course_side import CourseSide
from .followers import Followers
from .loop import SimulationLoop
from .messages import point_message, pose_message, wrench_message
from .robot_side import FAULT_REASON, RobotSide
from .startup import begin, refuse_unknown_parameters
from .streams import LATCHED_QOS, SENSOR_QOS, Stream, Streams, Template, ros_time

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
_NUMBERS = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]  # to find their places in a serialized message
SPIN_TIME = 0.5  # s, after which a node looks whether it is to stop
MODE_NAMES = {RobotState.MODE_POSITION: "position", RobotState.MODE_FORCE: "force", RobotState.MODE_FAULT: "fault"}


class CellNode(Node):
    """Robot, force sensor and tracker of a cell on the topics of the README."""

    def __init__(self) -> None:
        super().__init__("cell")
        speed = self._number("speed_factor", 1.0, "simulated seconds per real second, > 0; can be set at any time")
        max_lead = self._number("max_lead", 0.25, "simulated s that the cell may be ahead of its slowest follower")
        rail_speed = self._number("rail_speed", 1.0, "velocity limit of the rail, m/s")
        rates = {
            name: self._number(f"rate.{name}", rate, f"publications of {name} per simulated second, Hz; 0: never")
            for name, rate in RATES.items()
        }
        self.settings = self._instruments()
        self.cell = cell = self._make_cell(self.settings)
        self.followers = Followers(self, max_lead)
        self.loop = SimulationLoop(self._step, cell.period, speed, lambda: self.followers.may_go_on(cell.time), self._flush)
        self._outbox: list[tuple[Publisher, Any]] = []  # messages, or serialized ones
        self.robot = RobotSide(self, cell, self.loop, rail_speed)
        self.course: CourseSide | None = None
        self._force_lag = cell.period * math.ceil(self.settings.force_delay / cell.period - 1e-9)
        self._tracker_stamps: Delay[Time] = Delay(self.settings.tracker_delay)
        self._mode: int | None = None
        axes = [*cell.chain.joint_names, *cell.rail_names]
        ones = [float(k + 1) for k in range(len(axes))]
        self._joints = Template(JointState(name=axes, position=ones), ones)
        self._pose = Template(pose_message(_NUMBERS[:7]), _NUMBERS[:7])
        six = _NUMBERS[:6]
        self._wrench, self._raw = (Template(wrench_message(frame, six), six) for frame in ("tool0", "ft_sensor"))
        self._point: dict[str, Template] = {}
        self._temperature: dict[str, Publisher] = {}
        self._send_state = self._sender(RobotState, "robot/state", self._state)
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
            cell.period,
        )
        description = self.create_publisher(String, "robot_description", LATCHED_QOS)
        description.publish(String(data=cell.chain.text))
        self._now = ros_time(cell.time)
        self.add_on_set_parameters_callback(self._on_parameters)

    def _step(self) -> None:
        self.robot.before_step()
        self.cell.step()
        self._now = ros_time(self.cell.time)
        if self.cell.mode != self._mode:
            self._mode = self.cell.mode
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
                self._put(publisher, message)

        return send

    def _put(self, publisher: Publisher, message: Any) -> None:
        """Send with the next flush."""
        self._outbox.append((publisher, message))

    def _flush(self) -> None:
        for publisher, message in self._outbox:
            publisher.publish(message)
        self._outbox.clear()

    def _fill_joints(self) -> bytes:
        q, rail = self.cell.joints()
        return self._joints.serialized(self._now, [*q.tolist(), rail] if self.cell.rail_names else q.tolist())

    def _fill_pose(self) -> bytes:
        p, R = self.cell.tcp()
        return self._pose.serialized(self._now, [*p.tolist(), *quaternion_of_rotation(R).tolist()])

    def _fill_wrench(self) -> bytes:
        return self._wrench.serialized(self._force_stamp(), self.cell.wrench().tolist())

    def _fill_raw(self) -> bytes:
        return self._raw.serialized(self._force_stamp(), self.cell.wrench_raw().tolist())

    def _force_stamp(self) -> Time:
        """Of the reading, which came out of the sensor `force_delay` ago."""
        return ros_time(max(self.cell.time - self._force_lag, 0.0)) if self._force_lag else self._now

    def _fill_point(self) -> bytes | None:
        reading = self.cell.tracker()
        stamp = self._tracker_stamps.pass_through(self.cell.time, self._now)
        if reading is None:
            return None
        station, p = reading
        if station not in self._point:
            self._point[station] = Template(point_message(station, _NUMBERS[:3]), _NUMBERS[:3])
        return self._point[station].serialized(stamp, p.tolist())

    def _send_temperatures(self) -> None:
        for name, value in self.cell.temperatures().items():
            if name not in self._temperature:
                self._temperature[name] = self.create_publisher(Temperature, f"temperature/{name}", SENSOR_QOS)
            message = Temperature(temperature=float(value))
            message.header.stamp, message.header.frame_id = self._now, name
            self._put(self._temperature[name], message)

    def _state(self) -> RobotState:
        x, y, z = self.cell.offset.tolist()
        message = RobotState(
            mode=int(self.cell.mode),
            in_motion=self.robot.in_motion,
            offset=Vector3(x=x, y=y, z=z),
            late_offsets=int(self.cell.late_offsets),
            message=FAULT_REASON if self.cell.mode == RobotState.MODE_FAULT else "",
        )
        message.header.stamp, message.header.frame_id = self._now, "base_link"
        return message

    def _diagnostics(self) -> DiagnosticArray:
        values = {
            "mode": MODE_NAMES[self.cell.mode],
            "in motion": str(self.robot.in_motion),
            "late offsets": str(self.cell.late_offsets),
            "speed factor": f"{self.loop.speed:g}",
        }
        fault = self.cell.mode == RobotState.MODE_FAULT
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if fault else DiagnosticStatus.OK,
            name="cell",
            message=FAULT_REASON if fault else "simulated",
            hardware_id="simulator",
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._now
        return message

    def _make_cell(self, settings: InstrumentSettings) -> Cell:
        name = self._declared("cell", "afp", "cell file, or its name in config/cells")
        truth_file = self._declared("truth", "", "truth file with hidden physics; empty: elastic with mild friction")
        truth_seed = self._declared("truth_seed", 0, "draws the compliances and what a truth file leaves open")
        seed = self._declared("seed", 1, "of all noise")
        file = read_cell(name)
        truth = read_truth(truth_file, file.name, truth_seed) if truth_file else make_truth(file.name, [], truth_seed)
        return Cell(file, truth, seed, settings)

    def _instruments(self) -> InstrumentSettings:
        values: dict[str, Any] = {}
        for entry in fields(InstrumentSettings):
            default = list(entry.default) if isinstance(entry.default, tuple) else entry.default
            value = self._declared(f"instruments.{entry.name}", default, "see irec_sim/instruments.py")
            values[entry.name] = tuple(value) if isinstance(default, list) else value
        return InstrumentSettings(**values)

    def _declared(self, name: str, default: Any, description: str) -> Any:
        return self.declare_parameter(name, default, ParameterDescriptor(description=description)).value

    def _number(self, name: str, default: float, description: str) -> float:
        descriptor = ParameterDescriptor(description=description, dynamic_typing=True)  # 2 as well as 2.0
        value = self.declare_parameter(name, default, descriptor).value
        problem = _problem(name, value)
        if problem:
            raise SimError(problem)
        return float(value)

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "speed_factor":
                problem = _problem(parameter.name, parameter.value)
                if problem:
                    return SetParametersResult(successful=False, reason=problem)
                self.loop.speed = float(parameter.value)
            else:
                return SetParametersResult(successful=False, reason=f"{parameter.name} can only be set at the start")
        return SetParametersResult(successful=True)


def _problem(name: str, value: Any) -> str:
    """Why this can't be the value of a numeric parameter; empty where it can."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return f"parameter '{name}' is {value!r}; a number is needed"
    if name.startswith("rate."):
        return "" if 0.0 <= value <= 250.0 else f"parameter '{name}' is {value:g} Hz; 0 to 250 Hz are possible"
    return "" if 0.0 < value < 1000.0 else f"parameter '{name}' is {value:g}; a number above 0 and below 1000 is needed"


def main() -> int:
    """Run the cell until SIGINT or SIGTERM; 2 where a parameter or file is wrong."""
    if not begin("cell", signal_handler_options=SignalHandlerOptions.NO):  # the simulation has to stop before the context goes
        return 2
    asked_to_stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: asked_to_stop.set())
    try:
        node = CellNode()
        # a launch file gives its name with __node:=, which would go for both
        simulator = Node("simulator", cli_args=["--ros-args", "-r", "__node:=simulator"])
        node.course = CourseSide(simulator, node.cell, node.loop, node.robot, asked_to_stop)
        refuse_unknown_parameters(node, simulator)
        course_thread = threading.Thread(target=_spin, args=(simulator, node.loop, asked_to_stop), name="course", daemon=True)
        node.loop.start()
        course_thread.start()
        _spin(node, node.loop, asked_to_stop)
        node.loop.stop()
        course_thread.join(2.0 * SPIN_TIME)
        if node.loop.failure is not None:
            raise node.loop.failure
    except (SimError, ParameterException) as error:
        print(f"cell: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0


def _spin(node: Node, loop: SimulationLoop, asked_to_stop: threading.Event) -> None:
    executor = EventsExecutor()
    executor.add_node(node)
    while not asked_to_stop.is_set() and loop.failure is None:
        executor.spin_once(timeout_sec=SPIN_TIME)


if __name__ == "__main__":
    sys.exit(main())
