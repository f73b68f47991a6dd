# SPDX-License-Identifier: Apache-2.0
"""Driver of the contract for robots behind ros2_control: joint_trajectory_controller and force_torque_sensor_broadcaster.

    ros2 run irec_calibration ros2_control_driver --ros-args -p cell:=cell.yaml --params-file kuka_drivers.yaml

Each joint state gives one point for the topic of the trajectory controller, two periods ahead. When this node ends, the
controller holds the last point. What it can and can't do of the contract: docs/drivers.md.
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
from irec_ros.startup import refuse_unknown_parameters, run_node
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from irec_msgs.msg import RobotState

from ..cell import read_cell
from ..drivers.moves import Planner
from ..drivers.position_robot import FAULT, PositionRobot, Settings
from ..drivers.wrench import ProcessWrench
from ..errors import CellError, IrecError
from ..procedure.axes import read_axes
from ..sensors.tool_load import ToolLoad
from .driver_commands import DriverCommands
from .rows import vector

SILENCE = 0.5  # s without joint states, after which the robot is in fault; of the cell's clock where time is simulated
STATE_PERIOD = 0.1  # s, longest between two robot/state, by the cell's clock and by the machine's
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
    P("force_lease", DEFAULTS.lease, "time for which a force set point holds", 0.1, 10.0, "s"),
    P("retract_distance", DEFAULTS.retract, "way back after a force set point has run out", 1e-3, 0.2, "m"),
    P("contact_stiffness", DEFAULTS.contact_stiffness, "of arm and surface along the tool", 1e4, 1e8, "N/m"),
    P("force_time", DEFAULTS.force_time, "time constant of the force control", 0.05, 10.0, "s"),
    P("contact_speed", DEFAULTS.contact_speed, "largest speed of the force control", 1e-4, 0.02, "m/s"),
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
            ),
        )  # fmt: skip
        vectors = (p.three(f"tool_load.{name}") for name in ("com", "bias_force", "bias_torque", "alignment"))
        load = ToolLoad(p["tool_load.mass"], *vectors)
        frame = self.cell.raw["force_sensor"]["frame"]
        self._sensor_frame, self._sensor = frame, ProcessWrench(self.cell, frame, load, float(p["sensor_sign"] or 1))
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        self._period = 1.0 / p["rate"]
        self._ticked = self._state_sent = -1.0
        self._state_told, self._state_stamp = time.monotonic(), 0  # s; ns
        self._stamp = 0.0  # of the newest joint states
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
            self, self._robot, self._planner, lambda: self._now, lambda: self._wrench is not None,
            lambda: self._publish_state(self._now),
        )  # fmt: skip
        self.create_timer(0.1, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def _now(self) -> float:
        """Clock of leases and moves, s: the machine's steady one; where time is simulated the cell's (/clock may be late)."""
        return max(self.get_clock().now().nanoseconds * 1e-9, self._stamp) if self._simulated else time.monotonic()

    def on_error(self, where: str, error: Exception, answered: bool) -> None:
        """Nothing more is sent: the trajectory controller holds."""
        self._robot.fault(f"unexpected error in {where}: {type(error).__name__}: {error}")

    # --- from the robot -----------------------------------------------------------------------------------------------

    def _on_joints(self, m: JointState) -> None:
        self._stamp = m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        self._follow(m)
        if self._follower is not None:  # each, or a simulated cell waits for points that are not due
            self._follower.publish(Header(stamp=m.header.stamp, frame_id=self.get_fully_qualified_name()))

    def _follow(self, m: JointState) -> None:
        if list(m.name) != self._places[0]:
            missing = [name for name in self._axes.driver if name not in m.name]
            if missing:  # another publisher of joint_states, e.g. of a gripper
                return
            self._places = list(m.name), [list(m.name).index(name) for name in self._axes.driver]
        if len(m.position) != len(m.name):
            return
        q = np.array([m.position[k] for k in self._places[1]])
        if not np.isfinite(q).all():
            self._robot.fault("joint_states holds a position that is no number")
            return
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
        sent = self._robot.tick(now, q, self._wrench)
        if sent is not None:
            self._point.points[0].positions = sent.tolist()
            self._trajectory.publish(self._point)
        self._publish_state(now)

    def _on_sensor(self, m: WrenchStamped) -> None:
        f, t = m.wrench.force, m.wrench.torque
        reading = np.array([f.x, f.y, f.z, t.x, t.y, t.z])
        if not np.isfinite(reading).all():
            return  # silence is noticed; a number that is none must not move the robot
        raw = self._sensor.raw(reading)
        at_tcp = self._sensor.at_tcp(raw, self._R_tool)
        stamp = m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        age = self.get_clock().now().nanoseconds * 1e-9 - stamp  # a late reading must not drive the force control
        self._wrench = self._now - max(age, 0.0), at_tcp[:3]
        for publisher, frame, values in ((self._raw_out, self._sensor_frame, raw), (self._wrench_out, "tool0", at_tcp)):
            out = WrenchStamped()
            out.header.stamp, out.header.frame_id = m.header.stamp, frame
            out.wrench.force, out.wrench.torque = vector(values[:3]), vector(values[3:])
            publisher.publish(out)

    def _look(self) -> None:
        if self._places[0] and self._now - self._last_joints > SILENCE:
            self._robot.fault(f"joint_states is silent for {SILENCE:g} s; clear it with robot/clear_fault when it is back")
        if time.monotonic() - self._state_told > STATE_PERIOD:  # who waits for it counts by that clock, however slow a cell is
            self._state_sent = -1.0
            self._publish_state(self._now)

    def _publish_state(self, now: float) -> None:
        r = self._robot
        state = (r.mode, r.in_motion, r.retreating, r.expired, r.message)
        if state == self._last_state and now - self._state_sent < STATE_PERIOD:
            return
        self._last_state, self._state_sent, self._state_told = state, now, time.monotonic()
        m = RobotState(
            mode=r.mode, in_motion=r.in_motion, retreating=r.retreating, expired_leases=r.expired, message=r.message,
            offset=vector(r.offset[:3]), late_offsets=r.late_offsets,
        )  # fmt: skip
        clock = self.get_clock().now().nanoseconds
        if clock < self._state_stamp - 1_000_000_000:  # set back
            self._state_stamp = 0
        self._state_stamp = max(clock, self._state_stamp + 1000)  # newer than the one before, also where a simulated clock stands
        m.header.stamp.sec, m.header.stamp.nanosec = divmod(self._state_stamp, 1_000_000_000)
        m.header.frame_id = "base_link"
        self._state.publish(m)
        level = ERROR if r.mode == FAULT else WARN if r.message else OK
        mode = ("position", "force", "fault")[r.mode]
        values = {"mode": mode, "expired force leases": r.expired, "late offsets": r.late_offsets}
        self._health.publish(status(self, "robot", level, r.message or "as asked", values, self.cell.serial))


def main() -> int:
    """Until SIGINT, SIGTERM or SIGHUP; 2 where a parameter or file is wrong."""
    return run_node("ros2_control_driver", Ros2ControlDriver, IrecError)


if __name__ == "__main__":
    sys.exit(main())
