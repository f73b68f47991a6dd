# SPDX-License-Identifier: Apache-2.0
"""The driver for ros2_control robots as a process, before hardware that is made to say and do wrong things."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from geometry_msgs.msg import WrenchStamped
from irec_calibration.cell import read_cell
from irec_calibration.poses.ik import Chain
from irec_calibration.procedure.axes import read_axes
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from irec_msgs.msg import RobotState
from irec_msgs.srv import SetControlMode

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = pytest.mark.ros
FILE = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
CELL = read_cell(FILE)
NAMES = read_axes(CELL).driver
CHAIN = Chain.of(CELL.robot)
HOME = np.array([*CELL.home, 0.1])
PATIENCE = 60.0  # s
STIFFNESS = 4e5  # N/m, of a plane 1 mm before the tool at HOME
ASKED = -300.0  # N


class Hardware:
    """Joint states and force sensor at 100 Hz, a controller that goes where it is sent, and somebody who asks the driver."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("hardware")
        self.q, self.says = HOME.copy(), lambda q: q  # what joint_states say of where the robot is
        self.order, self.extra = list(range(len(NAMES))), 0
        self.held: np.ndarray | None = None
        self.sent: list[np.ndarray] = []
        self.state: RobotState | None = None
        self.pressing = False
        p, R, _ = CHAIN.forward(HOME[None, :6])
        self.p0, self.z = p[0], R[0][:, 2]
        self.noise = np.random.default_rng(1)
        self._joints = self.node.create_publisher(JointState, "joint_states", 10)
        self._sensor = self.node.create_publisher(WrenchStamped, "force_torque_sensor_broadcaster/wrench", 10)
        self._set = self.node.create_publisher(WrenchStamped, "robot/force_setpoint", 10)
        self.node.create_subscription(JointTrajectory, "joint_trajectory_controller/joint_trajectory", self._take, 10)
        self.node.create_subscription(RobotState, "robot/state", lambda m: setattr(self, "state", m), 10)
        self._mode = self.node.create_client(SetControlMode, "robot/set_control_mode")
        self._clear = self.node.create_client(Trigger, "robot/clear_fault")
        self.node.create_timer(0.01, self._tell)

    @property
    def force(self) -> float:
        """True force along the tool, N."""
        depth = float((CHAIN.forward(self.q[None, :6])[0][0] - self.p0) @ self.z) - 1e-3
        return -STIFFNESS * max(depth, 0.0)

    def _take(self, m: JointTrajectory) -> None:
        assert list(m.joint_names) == list(NAMES)
        self.q = np.array(m.points[0].positions)
        self.sent.append(self.q)

    def _tell(self) -> None:
        stamp = self.node.get_clock().now().to_msg()
        q = self.says(self.q)
        names = [NAMES[k] for k in self.order] + ["gripper"] * self.extra
        m = JointState(name=names, position=[float(q[k]) for k in self.order] + [0.01] * self.extra)
        m.velocity = m.effort = [float("nan")] * len(names)
        m.header.stamp = stamp
        self._joints.publish(m)
        reading = np.array([0.0, 0.0, self.force, 0.0, 0.0, 0.0]) + self.noise.normal(0.0, 0.3, 6)
        w = WrenchStamped()
        w.header.stamp, w.header.frame_id = stamp, "ft_sensor"
        f, t = w.wrench.force, w.wrench.torque
        f.x, f.y, f.z, t.x, t.y, t.z = (float(v) for v in (reading if self.held is None else self.held))
        self._sensor.publish(w)
        if self.pressing:
            s = WrenchStamped()
            s.header.stamp, s.header.frame_id, s.wrench.force.z = stamp, "tool0", ASKED
            self._set.publish(s)

    def until(self, condition: Callable[[], Any], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"no {what} within {PATIENCE:g} s; robot/state: {self.state}, force {self.force}"
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def _asked(self, client: Any, request: Any) -> Any:
        self.until(client.service_is_ready, client.srv_name)
        answer = client.call_async(request)
        self.until(answer.done, "answer")
        return answer.result()

    def clear(self) -> None:
        assert self._asked(self._clear, Trigger.Request()).success

    def press(self) -> None:
        """Until the set point is reached."""
        self.until(lambda: self.state is not None and not self.state.message, "driver that knows where the robot stands")
        request = SetControlMode.Request(mode=SetControlMode.Request.FORCE)
        request.force_in_tool.z = ASKED
        answer = self._asked(self._mode, request)
        assert answer.success, answer.message
        self.pressing = True
        self.until(lambda: self.force < 0.9 * ASKED, "force")


def driver(*parameters: str) -> list[str]:
    settings = [word for parameter in (f"cell:={FILE}", *parameters) for word in ("-p", parameter)]
    return [sys.executable, "-m", "irec_calibration.nodes.ros2_control_driver", "--ros-args", *settings]


@pytest.fixture
def hardware(ros_domain: int) -> Iterator[Hardware]:
    rclpy.init()
    made = Hardware()
    yield made
    made.node.destroy_node()
    rclpy.try_shutdown()


def test_zeros_before_the_hardware_was_read_and_beside_it_are_a_fault_and_nothing_is_sent(
    hardware: Hardware, start_process: Start
) -> None:
    hardware.says = np.zeros_like
    start_process(driver(), name="driver")
    hardware.until(lambda: hardware.state is not None and not hardware.state.message, "driver")
    hardware.says = lambda q: q
    hardware.until(lambda: hardware.state.mode == RobotState.MODE_FAULT, "fault")
    assert "joint_2 has moved from 0 to -1.9 rad" in hardware.state.message
    count = [0]

    def now_and_then(q: np.ndarray) -> np.ndarray:
        count[0] += 1
        return q if count[0] % 10 else 0.0 * q

    hardware.says = now_and_then
    for _ in range(3):
        hardware.clear()
        hardware.until(lambda: hardware.state.mode == RobotState.MODE_POSITION, "cleared fault")
        hardware.until(lambda: hardware.state.mode == RobotState.MODE_FAULT, "fault again")
    assert not hardware.sent


def test_a_sensor_that_repeats_its_reading_in_contact_ends_in_a_retreat(hardware: Hardware, start_process: Start) -> None:
    hardware.order, hardware.extra = (
        [6, 2, 0, 1, 5, 3, 4],
        1,
    )  # in another order, with another joint, velocities that are no numbers
    start_process(driver("contact_stiffness:=4e5"), name="driver")
    hardware.press()
    np.testing.assert_allclose(hardware.sent[0], HOME, atol=1e-3)
    hardware.held = np.array([0.1, 0.2, -0.5 * abs(ASKED), 0.3, 0.4, 0.5])
    hardware.until(lambda: hardware.force == 0.0, "way out of the contact")
    hardware.until(lambda: hardware.state.mode == RobotState.MODE_POSITION, "position control")
    assert "repeats one reading to the last bit" in hardware.state.message and hardware.state.expired_leases == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_driver_that_is_asked_to_end_in_contact_leaves_it_first(
    number: signal.Signals, hardware: Hardware, start_process: Start
) -> None:
    process = start_process(driver("contact_stiffness:=4e5"), name="driver")
    hardware.press()
    process.send_signal(number)
    hardware.until(lambda: process.poll() is not None, "end of the driver")
    assert process.returncode == 0 and hardware.force == 0.0


def test_a_second_signal_ends_the_driver_at_once_and_it_says_that_the_robot_may_press(
    hardware: Hardware, start_process: Start, tmp_path: Path
) -> None:
    process = start_process(driver("contact_stiffness:=4e5", "retract_distance:=0.2"), name="driver")
    hardware.press()
    process.send_signal(signal.SIGINT)
    hardware.until(lambda: hardware.state.retreating, "way out")
    process.send_signal(signal.SIGINT)
    hardware.until(lambda: process.poll() is not None, "end of the driver")
    assert process.returncode == 0
    assert "by a second signal before the robot was out of the contact" in (tmp_path / "driver.log").read_text()


@pytest.mark.parametrize("lease", ["5.0", ".nan", "-1.0"])
def test_a_lease_that_is_too_long_or_no_number_is_refused_at_the_start(
    lease: str, ros_domain: int, start_process: Start, tmp_path: Path
) -> None:
    assert start_process(driver(f"force_lease:={lease}"), name="driver").wait(PATIENCE) == 2
    assert "force_lease" in (tmp_path / "driver.log").read_text()
