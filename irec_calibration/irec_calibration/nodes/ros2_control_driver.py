# SPDX-License-Identifier: Apache-2.0
"""Driver of the contract for robots behind ros2_control: joint_trajectory_controller and force_torque_sensor_broadcaster.

    ros2 run irec_calibration ros2_control_driver --ros-args -p cell:=cell.yaml --params-file kuka_drivers.yaml

Once somebody has asked for something, each joint state gives one point for the topic of the trajectory controller, two periods
ahead. Asked to end (SIGINT, SIGTERM, SIGHUP) it leaves a contact first; the controller then holds the last point, as it does in
fault. What it can and can't do of the contract: docs/drivers.md.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from irec_ros.diagnostics import ERROR, OK, WARN, Diagnostics, status
from irec_ros.guard import GuardedNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import refuse_unknown_parameters, run_process
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from irec_msgs.msg import RobotState

from ..cell import read_cell
from ..drivers.moves import Planner
from ..drivers.position_robot import FAULT, WRENCH_LOST, PositionRobot
from ..drivers.sensor import RawReadings
from ..drivers.settings import Settings
from ..drivers.wrench import ProcessWrench
from ..errors import CellError, IrecError
from ..procedure.axes import read_axes
from ..procedure.commands import LONGEST_LEASE
from ..sensors.tool_load import ToolLoad
from .driver_commands import DriverCommands
from .orderly_end import work_until_ended
from .rows import vector

# s without joint states that can be believed, after which the robot is in fault; of the cell's clock where time is simulated
SILENCE = 0.5
STATE_PERIOD = 0.08  # s, after which robot/state is sent again: ten a second are asked for, and it is sent at a joint state
WAITS = "waits until joint_states say for some time where the robot stands"
SENSORS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
EITHER = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches every publisher
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEFAULTS = Settings()
PARAMETERS = (
    P("cell", "", "cell file (irec-cell/1)"),
    P("trajectory_topic", "joint_trajectory_controller/joint_trajectory", "topic of the trajectory controller"),
    P("sensor_topic", "force_torque_sensor_broadcaster/wrench", "readings of the force sensor as its broadcaster sends them"),
    P("sensor_sign", 1, "-1 where the sensor reads what the robot exerts on the environment", -1, 1),
    P("rate", 100.0, "points sent to the trajectory controller, at most one for each joint state", 20.0, 1000.0, "Hz"),
    P("rail_speed", 0.5, "largest speed of the rail", 1e-3, 10.0, "m/s"),
    P("force_lease", DEFAULTS.lease, "time for which a force set point holds", 0.1, LONGEST_LEASE, "s"),
    P("retract_distance", DEFAULTS.retract, "way back after a force set point has run out", 1e-3, 0.2, "m"),
    P("contact_stiffness", DEFAULTS.contact_stiffness, "of arm and surface along the tool", 1e4, 1e8, "N/m"),
    P("force_time", DEFAULTS.force_time, "time constant of the force control", 0.05, 10.0, "s"),
    P("contact_speed", DEFAULTS.contact_speed, "largest speed of the force control", 1e-4, 0.02, "m/s"),
    P("touch_force", DEFAULTS.first_touch, "change of the force that is the first sign of contact", 0.5, 200.0, "N"),
    P("advance_limit", DEFAULTS.advance, "way into the contact within which the force has to rise", 2e-4, 0.02, "m"),
    P("approach_limit", DEFAULTS.approach, "longest way of the force control without contact", 1e-3, 0.2, "m"),
    P("follow_limit", DEFAULTS.follow_limit, "difference between sent and reported positions that is a fault", 1e-3, 0.5, "rad"),
    P("tool_load.mass", 0.0, "mass behind the sensor (irec tool-load)", 0.0, 2000.0, "kg"),
    P("tool_load.com", [0.0, 0.0, 0.0], "its centre of mass in the sensor's frame", unit="m"),
    P("tool_load.bias_force", [0.0, 0.0, 0.0], "reading without load", unit="N"),
    P("tool_load.bias_torque", [0.0, 0.0, 0.0], "reading without load", unit="N m"),
    P("tool_load.alignment", [0.0, 0.0, 0.0], "rotation vector from the stated to the true sensor", unit="rad"),
)


class Ros2ControlDriver(GuardedNode):
    """One robot. Parameters: see PARAMETERS."""

    def __init__(self) -> None:
        super().__init__("driver")
        p = Parameters(self, PARAMETERS)
        refuse_unknown_parameters(self)
        if not p["cell"]:
            raise CellError("parameter 'cell' is empty; name a cell file, e.g. -p cell:=config/cells/afp.yaml")
        self.cell = read_cell(p["cell"])
        self._axes = read_axes(self.cell)
        self._planner = Planner(self.cell, self._axes, p["rail_speed"])
        self._robot = PositionRobot(
            self._planner,
            Settings(
                lease=p["force_lease"], retract=p["retract_distance"], contact_stiffness=p["contact_stiffness"],
                force_time=p["force_time"], contact_speed=p["contact_speed"], follow_limit=p["follow_limit"],
                first_touch=p["touch_force"], advance=p["advance_limit"], approach=p["approach_limit"],
            ),
        )  # fmt: skip
        vectors = (p.three(f"tool_load.{name}") for name in ("com", "bias_force", "bias_torque", "alignment"))
        load = ToolLoad(p["tool_load.mass"], *vectors)
        frame = self.cell.raw["force_sensor"]["frame"]
        self._sensor_frame, self._sensor = frame, ProcessWrench(self.cell, frame, load, float(p["sensor_sign"] or 1))
        self._readings = RawReadings(frame, self._sensor.links)
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        self._period = 1.0 / p["rate"]
        self._ticked = self._state_sent = -1.0
        self._state_told, self._state_stamp = time.monotonic(), 0  # s; ns
        self._stamp = 0.0  # of the newest joint states that were believed
        self._last_joints = self._now
        self._R_tool = np.eye(3)
        self._wrench: tuple[float, np.ndarray] | None = None
        self._places: tuple[list[str], list[int]] = ([], [])
        self._last_state: tuple[Any, ...] = ()
        self._health = Diagnostics(self)
        self._trajectory = self.create_publisher(JointTrajectory, p["trajectory_topic"], 10)
        self._point = JointTrajectory(joint_names=list(self._axes.driver), points=[JointTrajectoryPoint()])
        self._point.points[0].time_from_start.nanosec = round(2e9 * self._period)
        self._pose = self.create_publisher(PoseStamped, "tcp_pose", SENSORS)
        self._raw_out, self._wrench_out = (self.create_publisher(WrenchStamped, t, SENSORS) for t in ("wrench_raw", "wrench"))
        self._state = self.create_publisher(RobotState, "robot/state", SENSORS)
        self._follower = self.create_publisher(Header, "sim/follower", 10) if self._simulated else None
        self._described = self.create_publisher(String, "robot_description", LATCHED)
        self._described.publish(String(data=self.cell.robot.urdf_text))
        self.create_subscription(JointState, "joint_states", self._on_joints, EITHER)
        self.create_subscription(WrenchStamped, p["sensor_topic"], self._on_sensor, EITHER)
        self._commands = DriverCommands(
            self, self._robot, self._planner, lambda: self._now, self._no_controller, self._no_force,
            lambda: self._publish_state(self._now),
        )  # fmt: skip
        self.create_timer(0.1, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def _now(self) -> float:
        """Clock of leases and moves, s: the machine's steady one; where time is simulated the cell's (/clock may be late)."""
        return max(self._ros_time, self._stamp) if self._simulated else time.monotonic()

    @property
    def _ros_time(self) -> float:
        """Clock of the stamps, s; 0 before a simulated one has come."""
        return float(self.get_clock().now().nanoseconds) * 1e-9

    @property
    def robot(self) -> PositionRobot:
        return self._robot

    def end(self) -> None:
        """Leave a contact of force control; nothing that is asked is taken any more."""
        self._robot.end(self._now)

    def _no_controller(self) -> str:
        """Why nothing that is sent would move the robot; empty where somebody listens."""
        if self._trajectory.get_subscription_count():
            return ""
        return f"nobody listens on {self._trajectory.topic_name}: is the trajectory controller active?"

    def _no_force(self) -> str:
        """Why there is no force to control; empty where there is."""
        if self._wrench is None:
            return f"the force sensor has not sent anything yet{self._readings.problem and ': '}{self._readings.problem}"
        silent = self._now - self._wrench[0]
        if silent <= WRENCH_LOST:
            return ""
        return self._readings.problem or f"the force sensor has said nothing new for {silent:.1f} s"

    def on_error(self, where: str, error: Exception, answered: bool) -> None:
        """Nothing more is sent: the trajectory controller holds."""
        self._robot.fault(f"unexpected error in {where}: {type(error).__name__}: {error}")

    # --- from the robot -----------------------------------------------------------------------------------------------

    def _on_joints(self, m: JointState) -> None:
        self._follow(m)
        if self._follower is not None:  # each, or a simulated cell waits for points that are not due
            self._follower.publish(Header(stamp=m.header.stamp, frame_id=self.get_fully_qualified_name()))

    def _positions(self, m: JointState) -> np.ndarray | None:
        """Of all axes (k,); None where the message is of others, e.g. of a gripper, or wrong."""
        names = list(m.name)
        if names != self._places[0]:
            if any(name not in names for name in self._axes.driver):
                return None
            self._places = names, [names.index(name) for name in self._axes.driver]
            twice = [name for name in self._axes.driver if names.count(name) > 1]
            if twice:
                self._robot.fault(f"joint_states: {twice[0]} is there twice: {names}")
                self._places = [], []
                return None
        if len(m.position) != len(names):
            self._robot.fault(f"joint_states: {len(names)} names with {len(m.position)} positions")
            return None
        return np.array([m.position[k] for k in self._places[1]])

    def _follow(self, m: JointState) -> None:
        q, clock = self._positions(m), self._ros_time
        if q is None or clock == 0.0:  # a simulated clock that has not come yet
            return
        stamp = m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        if not self._robot.report(clock, stamp, q):
            return
        self._stamp = stamp
        self._last_joints = self._now
        at = self.cell.robot.kinematics(q[None, : self._planner.n])
        self._R_tool = at.R_tool[0]
        pose = PoseStamped(header=m.header)
        pose.header.frame_id = "base_link"
        x = pose.pose.position
        x.x, x.y, x.z = (float(v) for v in at.p_tcp[0])
        o = pose.pose.orientation
        o.x, o.y, o.z, o.w = (float(v) for v in Rotation.from_matrix(np.array(at.R_tool[0])).as_quat())
        self._pose.publish(pose)
        now = self._now
        if now - self._ticked < 0.9 * self._period:
            return
        self._ticked = now
        sent = self._robot.tick(now, self._wrench, self._readings.problem)
        if sent is not None:
            self._point.points[0].positions = sent.tolist()
            self._trajectory.publish(self._point)
        self._publish_state(now)

    def _on_sensor(self, m: WrenchStamped) -> None:
        f, t = m.wrench.force, m.wrench.torque
        reading = np.array([f.x, f.y, f.z, t.x, t.y, t.z])
        stamp = m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        if not self._readings.take(self._now, self._ros_time, stamp, m.header.frame_id, reading) or self._readings.at is None:
            return  # silence is noticed; what says nothing must not move the robot
        raw = self._sensor.raw(reading)
        at_tcp = self._sensor.at_tcp(raw, self._R_tool)
        self._wrench = self._readings.at, at_tcp[:3]  # a late reading, or one that repeats, must not drive the force control
        for publisher, frame, values in ((self._raw_out, self._sensor_frame, raw), (self._wrench_out, "tool0", at_tcp)):
            out = WrenchStamped()
            out.header.stamp, out.header.frame_id = m.header.stamp, frame
            out.wrench.force, out.wrench.torque = vector(values[:3]), vector(values[3:])
            publisher.publish(out)

    def _look(self) -> None:
        if self._places[0] and self._now - self._last_joints > SILENCE:
            why = f"; the last state was left out because {self._robot.left_out}" if self._robot.left_out else ""
            self._robot.fault(f"joint_states is silent for {SILENCE:g} s; clear it with robot/clear_fault when it is back{why}")
        if time.monotonic() - self._state_told > STATE_PERIOD:  # who waits for it counts by that clock, however slow a cell is
            self._state_sent = -1.0
            self._publish_state(self._now)

    def _publish_state(self, now: float) -> None:
        r = self._robot
        message = r.message or (WAITS if r.waits else "")
        state = (r.mode, r.in_motion, r.retreating, r.expired, message)
        if state == self._last_state and now - self._state_sent < STATE_PERIOD:
            return
        self._last_state, self._state_sent, self._state_told = state, now, time.monotonic()
        m = RobotState(
            mode=r.mode, in_motion=r.in_motion, retreating=r.retreating, expired_leases=r.expired, message=message,
            offset=vector(r.offset[:3]), late_offsets=r.late_offsets,
        )  # fmt: skip
        clock = self.get_clock().now().nanoseconds
        if clock < self._state_stamp - 1_000_000_000:  # set back
            self._state_stamp = 0
        self._state_stamp = max(clock, self._state_stamp + 1000)  # newer than the one before, also where a simulated clock stands
        m.header.stamp.sec, m.header.stamp.nanosec = divmod(self._state_stamp, 1_000_000_000)
        m.header.frame_id = "base_link"
        self._state.publish(m)
        level = ERROR if r.mode == FAULT else WARN if message or self._readings.problem else OK
        mode = ("position", "force", "fault")[r.mode]
        values = {"mode": mode, "expired force leases": r.expired, "late offsets": r.late_offsets,
                  "force sensor": self._readings.problem or "as it should be"}  # fmt: skip
        self._health.publish(status(self, "robot", level, message or "as asked", values, self.cell.serial))


def main() -> int:
    """Until SIGINT, SIGTERM or SIGHUP, and out of the contact; 2 where a parameter or file is wrong."""
    return run_process("ros2_control_driver", lambda asked: work_until_ended(Ros2ControlDriver(), asked), IrecError)


if __name__ == "__main__":
    sys.exit(main())
