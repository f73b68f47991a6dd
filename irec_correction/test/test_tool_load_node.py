# SPDX-License-Identifier: Apache-2.0
"""The tool load is identified in the running node, by its services, and taken off the raw wrench from then on."""

from __future__ import annotations

import re
import sys
import time
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chain import ROBOT, Q
from irec_calibration.sensors.tool_load import ToolLoad
from irec_correction.conditioning import sensor_in_tool
from irec_correction.orientations import WINDOW
from ros_side import RosSide

pytestmark = pytest.mark.ros
CELL = Path(__file__).parents[2] / "config/cells/afp.yaml"
GRAVITY = np.array([0.0, 0.0, -9.81])
LOAD = ToolLoad(42.0, (0.02, -0.01, 0.15), (18.0, -11.0, 25.0), (1.0, 2.0, -3.0))
TURNS = (  # of joints 4, 5, 6, rad: the tool turned to all sides
    (0.0, 0.0, 0.0), (0.0, 0.9, 0.0), (0.0, -1.6, 0.0), (1.5, 0.8, 0.0), (-1.5, 0.8, 0.0), (0.7, -1.2, 1.5), (3.0, 0.6, 0.8),
)  # fmt: skip


class Cell:
    """Publishes joint angles and what the raw sensor reads there."""

    def __init__(self) -> None:
        from geometry_msgs.msg import WrenchStamped
        from sensor_msgs.msg import JointState

        self.ros = RosSide("cell")
        self.q, self.rng = Q.copy(), np.random.default_rng(0)
        self.R_sensor_in_tool, _ = sensor_in_tool(ROBOT, "ft_sensor")
        self._joints, self._wrench = JointState(name=[*ROBOT.joint_names, "ext_rail"]), WrenchStamped()
        self._wrench.header.frame_id = "ft_sensor"
        self._joints_out = self.ros.node.create_publisher(JointState, "joint_states", 50)
        self._wrench_out = self.ros.node.create_publisher(WrenchStamped, "wrench_raw", 50)
        self.process = self.ros.collect(WrenchStamped, "irec/wrench_process")
        self.ros.node.create_timer(0.004, self._publish)

    def _publish(self) -> None:
        stamp = self.ros.node.get_clock().now().to_msg()
        self._joints.header.stamp = self._wrench.header.stamp = stamp
        self._joints.position = array("d", [*self.q.tolist(), 0.0])
        R = ROBOT.kinematics(self.q[None]).R_tool[0] @ self.R_sensor_in_tool
        f = (LOAD.reading(R, GRAVITY) + self.rng.normal(0.0, 0.2, 6)).tolist()
        w = self._wrench.wrench
        w.force.x, w.force.y, w.force.z, w.torque.x, w.torque.y, w.torque.z = f
        self._joints_out.publish(self._joints)
        self._wrench_out.publish(self._wrench)

    def call(self, name: str):
        from std_srvs.srv import Trigger

        return self.ros.call(Trigger, f"irec/wrench/{name}", Trigger.Request())

    def record(self) -> str:
        """Record an orientation as an operator would: after standing for a while, again while the node does not take it."""
        stands = time.monotonic() + 1.5 * WINDOW
        self.ros.until(lambda: time.monotonic() > stands, "standing")
        answers: list = []

        def recorded() -> bool:
            answers.append(self.call("record_orientation"))
            return answers[-1].success

        self.ros.until(recorded, f"recorded; {answers[-1:]}")
        return answers[-1].message


@pytest.fixture
def cell(ros_domain, start_process) -> Iterator[Cell]:
    start_process([
        sys.executable, "-m", "irec_correction.nodes.correction_node", "--ros-args", "-p", f"cell:={CELL}",
        "-p", "autostart:=true", "-p", "raw_wrench:=true", "-p", "watch.wrench_timeout:=0.5", "-p", "watch.joints_timeout:=0.5",
        "-p", "watch.age_limit:=0.5",
    ], name="correction")  # fmt: skip
    made = Cell()
    yield made
    made.ros.close()


def process_force(cell: Cell) -> float:
    f = cell.process[-1].wrench.force
    return float(np.linalg.norm([f.x, f.y, f.z]))


def test_recorded_orientations_give_the_load_and_the_process_wrench_is_free_of_it(cell):
    few = cell.call("identify_tool_load")
    assert not few.success and few.message
    for k, turn in enumerate(TURNS, 1):
        cell.q = Q + np.r_[np.zeros(3), turn]
        assert f"orientation {k} " in cell.record()
    cell.ros.until(lambda: cell.process, "process wrench")
    assert process_force(cell) > 0.5 * LOAD.mass * 9.81
    answer = cell.call("identify_tool_load")
    assert answer.success, answer.message
    assert "in force" in answer.message
    mass = float(re.search(r"mass +([0-9.]+) ", answer.message)[1])
    assert mass == pytest.approx(LOAD.mass, abs=0.1)
    heard = len(cell.process)
    cell.ros.until(lambda: len(cell.process) > heard + 100, "process wrench without the load")
    assert process_force(cell) < 2.0


def test_a_robot_that_moves_is_not_recorded(cell):
    cell.record()
    start = cell.q.copy()

    def refused() -> bool:
        cell.q = cell.q + 0.001
        answer = cell.call("record_orientation")
        return not answer.success and "moved" in answer.message

    cell.ros.until(refused, "refusal")
    cell.q = start
