# SPDX-License-Identifier: Apache-2.0
"""The driver for ros2_control robots against mock hardware that speaks only ros2_control's topics: to a solved session."""

from __future__ import annotations

import os
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
from irec_calibration.commands.tool_load import parameter_file
from irec_calibration.effects import find_effect
from irec_calibration.identification.identify import identify
from irec_calibration.model import Term
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import write_poses
from irec_calibration.sensors.tool_load import ToolLoad
from irec_calibration.session import read_session
from irec_ros.seen import SeenBy
from irec_sim.cellfile import read_cell as read_simulated
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState

from irec_msgs.action import Move, RunProcedure
from irec_msgs.msg import RobotState
from irec_msgs.srv import SetControlMode

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = pytest.mark.ros
CELL = Path(__file__).parents[1] / "config" / "cells" / "afp.yaml"
PATIENCE = 240.0  # s of the machine's clock
SPEED = 2.0
BIAS = (18.0, -11.0, 25.0, 1.2, -0.8, 0.5)  # of the simulated sensor, known from irec tool-load


def node(module: str, *rules: str, **parameters: object) -> list[str]:
    settings = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", module, "--ros-args", *rules, *settings]


class Operator:
    """Asks the driver and the procedure, and listens."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("operator")
        self.move = ActionClient(self.node, Move, "robot/move")
        self.run = ActionClient(self.node, RunProcedure, "irec/run_procedure")
        self.mode = self.node.create_client(SetControlMode, "robot/set_control_mode")
        self.state: RobotState | None = None
        self.force = np.full(3, np.nan)
        self.joints: dict[str, float] = {}
        self.node.create_subscription(RobotState, "robot/state", lambda m: setattr(self, "state", m), 10)
        self.node.create_subscription(WrenchStamped, "wrench", self._on_wrench, 10)
        self.node.create_subscription(JointState, "joint_states", self._on_joints, 10)

    def _on_wrench(self, m: WrenchStamped) -> None:
        f = m.wrench.force
        self.force = np.array([f.x, f.y, f.z])

    def _on_joints(self, m: JointState) -> None:
        self.joints = dict(zip(m.name, m.position, strict=True))

    def until(self, condition: Callable[[], Any], what: str) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"no {what} within {PATIENCE:g} s; robot/state: {self.state}"
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def done(self, client: ActionClient, name: str, goal: Any) -> Any:
        """Status and result of a goal of the action of this name."""
        self.until(client.server_is_ready, "action")
        self.until(SeenBy.of_action(self.node, name), "server that knows the client")
        sent = client.send_goal_async(goal)
        self.until(sent.done, "answer to a goal")
        ended = sent.result().get_result_async()
        self.until(ended.done, "end of a goal")
        return ended.result()


@pytest.fixture
def operator(ros_domain: int, start_process: Start, tmp_path: Path) -> Iterator[Operator]:
    chain = read_simulated(CELL).chain
    start_process(node("irec_sim.nodes.ros2_control_node", cell=CELL, speed_factor=SPEED, max_lead=0.1), name="hardware")
    x, y, z = (float(v) for v in chain.tool_com)
    load = ToolLoad(float(chain.tool_mass), (x, y, z), BIAS[:3], BIAS[3:])
    weight = tmp_path / "tool_load.yaml"
    weight.write_text(parameter_file(load, ("mass", "com", "bias_force", "bias_torque")), encoding="utf-8")
    driver = node("irec_calibration.nodes.ros2_control_driver", "--params-file", str(weight), cell=CELL, use_sim_time="true")
    start_process(driver, name="driver")
    rclpy.init()
    made = Operator()
    made.until(lambda: made.state is not None and made.joints and np.isfinite(made.force).all(), "driver")
    made.until(lambda: not made.state.message, "driver that knows where the robot stands")
    yield made
    made.node.destroy_node()
    rclpy.try_shutdown()


@pytest.mark.slow
@pytest.mark.long
def test_procedure_1_runs_on_a_robot_that_takes_joint_trajectories_only(
    operator: Operator, start_process: Start, tmp_path: Path
) -> None:
    assert np.abs(operator.force).max() < 8.0, "bias and weight are off"
    cell = read_cell(CELL)
    poses = write_poses(pose_list(cell, make_plan(cell, 2, pool_size=40)), tmp_path / "poses.yaml")
    arguments = {"cell": CELL, "session_folder": tmp_path, "use_sim_time": "true"}
    start_process(node("irec_calibration.nodes.procedure_node", **arguments), name="procedure")
    goal = RunProcedure.Goal(poses_path=str(poses), session_path=str(tmp_path / "s.mcap"))
    end = operator.done(operator.run, "irec/run_procedure", goal)
    assert end.result.success and end.result.poses_recorded == 2, end.result.message
    session = read_session(tmp_path / "s.mcap")
    assert len(session) == 12
    for row in np.flatnonzero(session.load_case):
        np.testing.assert_allclose(session.force_in_tool[row], cell.forces_in_tool[session.load_case[row] - 1], atol=16.0)
    residual = identify(session, [Term(find_effect("joint_torsion"))]).residual
    assert float(np.sqrt(np.mean(np.square(residual)))) < 2e-4


def test_a_refusal_names_the_reason_and_a_killed_driver_leaves_a_robot_that_stands(operator: Operator) -> None:
    beyond = Move.Goal(kind=Move.Goal.JOINT, joint_names=["joint_1"], joint_position=[9.0], speed=0.2)
    assert "joint_1 would be at 9" in operator.done(operator.move, "robot/move", beyond).result.message
    ok = Move.Goal(kind=Move.Goal.JOINT, joint_names=["joint_1"], joint_position=[0.1], speed=0.2)
    assert operator.done(operator.move, "robot/move", ok).result.success
    assert operator.joints["joint_1"] == pytest.approx(0.1, abs=1e-3)


def test_the_driver_ends_quietly_on_an_interrupt(operator: Operator, start_process: Start, tmp_path: Path) -> None:
    second = start_process(node("irec_calibration.nodes.ros2_control_driver", "-r", "__ns:=/other", cell=CELL), name="second")
    operator.until(lambda: "/other" in operator.node.get_namespace() or operator.node.count_publishers("/other/tcp_pose"), "node")
    os.killpg(second.pid, signal.SIGINT)
    assert second.wait(60.0) == 0
    assert "Traceback" not in (tmp_path / "second.log").read_text()
