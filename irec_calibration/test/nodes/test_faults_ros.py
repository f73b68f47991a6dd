# SPDX-License-Identifier: Apache-2.0
"""Faults at the wrong moment, with real processes: the robot leaves the contact, the cause is told, the node lives."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from quick_cell import quick_cell
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from test_loop_ros import ABORTED, CELL, Operator, node

from irec_msgs.msg import RobotState

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(900)]
SPEED = 3.0  # of simulated time: on a busy machine a node may not hear the clock for a second
FIND = 2.0  # s


class Cell:
    """The simulated cell, a procedure, and an operator."""

    def __init__(self, operator: Operator, procedure: subprocess.Popen[bytes], start: Start, folder: Path) -> None:
        self.operator, self.procedure, self.start, self.folder = operator, procedure, start, folder
        self.told: dict[str, str] = {}
        operator.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.told.update({s.name: s.message for s in message.status if s.level != s.OK})


@pytest.fixture
def cell(ros_domain: int, start_process: Start, tmp_path: Path) -> Iterator[Cell]:
    quick = quick_cell(tmp_path)
    start_process(node("irec_sim.nodes.cell_node", cell=quick, speed_factor=SPEED), name="cell")
    arguments = {"cell": quick, "session_folder": tmp_path, "use_sim_time": "true"}
    procedure = start_process(node("irec_calibration.nodes.procedure_node", **arguments), name="procedure")
    rclpy.init()
    made = Operator()
    try:
        yield Cell(made, procedure, start_process, tmp_path)
    finally:
        made.node.destroy_node()
        rclpy.try_shutdown()


def in_contact(cell: Cell, **goal: Any) -> Any:
    handle = cell.operator.start(session_path=str(cell.folder / "s.mcap"), **goal)
    cell.operator.in_state("settle")
    return handle


def test_a_second_sender_of_joint_states_in_contact_ends_the_run_retracted(cell: Cell) -> None:
    handle = in_contact(cell)
    cell.operator.node.create_publisher(JointState, "joint_states", 10)
    end = cell.operator.end(handle)
    assert end.status == ABORTED and "2 publishers of /joint_states (/cell, /operator)" in end.result.message
    cell.operator.until(lambda: cell.operator.robot is not None and cell.operator.robot.mode == RobotState.MODE_POSITION)
    assert cell.procedure.poll() is None


def test_a_wrench_that_is_no_number_ends_the_run(cell: Cell) -> None:
    """It comes from a second sender, which may be told first."""
    handle = in_contact(cell)
    wrenches = cell.operator.node.create_publisher(WrenchStamped, "wrench", 10)
    cell.operator.until(lambda: wrenches.get_subscription_count() > 0)
    message = WrenchStamped()
    message.header.frame_id = "tool0"
    message.wrench.force.x = float("nan")
    wrenches.publish(message)
    end = cell.operator.end(handle)
    told = ("wrench: the force is (nan, 0, 0)", "2 publishers of /wrench (/cell, /operator)")
    assert end.status == ABORTED and any(text in end.result.message for text in told)


def test_a_killed_procedure_leaves_a_robot_that_leaves_the_contact_by_itself(cell: Cell) -> None:
    in_contact(cell)
    os.kill(cell.procedure.pid, signal.SIGKILL)
    robot = cell.operator
    robot.until(lambda: robot.robot is not None and robot.robot.expired_leases == 1 and not robot.robot.retreating)
    assert robot.robot is not None and robot.robot.mode == RobotState.MODE_POSITION
    assert "no force set point came" in robot.robot.message


def test_a_clock_that_is_set_in_contact_ends_the_run_within_seconds(cell: Cell) -> None:
    clock = cell.operator.node.create_publisher(Clock, "/clock", 10)
    cell.operator.until(lambda: clock.get_subscription_count() > 0)
    handle = in_contact(cell)
    assert cell.operator.robot is not None
    now = cell.operator.robot.header.stamp
    jumps = itertools.cycle((1000, 1000, 1000, -20))
    result = handle.get_result_async()

    def ended() -> bool:
        """Set the clock once more: a reader keeps the last message alone, which may be one of the cell's own."""
        message = Clock()
        message.clock.sec = max(0, now.sec + next(jumps))
        clock.publish(message)
        return result.done()

    cell.operator.until(ended)
    end = result.result()
    assert end.status == ABORTED and "clock" in end.result.message
    cell.operator.until(lambda: cell.operator.robot.mode == RobotState.MODE_POSITION)  # type: ignore[union-attr]


def test_a_recording_that_fails_ends_the_run_retracted_and_the_next_one_works(
    ros_domain: int, start_process: Start, tmp_path: Path
) -> None:
    """The file may not grow beyond 400 kB, as on a full disk: it ends early in the run, which need not be fast."""
    start_process(node("irec_sim.nodes.cell_node", cell=CELL, speed_factor=1.0), name="cell")
    arguments = node("irec_calibration.nodes.procedure_node", cell=CELL, session_folder=tmp_path, use_sim_time="true")
    limited = ["bash", "-c", 'trap "" XFSZ; ulimit -f 400; exec "$@"', "limited", *arguments]
    process = start_process(limited, name="procedure")
    rclpy.init()
    operator = Operator()
    try:
        end = operator.end(operator.start(session_path=str(tmp_path / "s.mcap")))
        assert end.status == ABORTED and "recording" in end.result.message, end.result.message
        operator.until(lambda: operator.robot is not None and operator.robot.mode == RobotState.MODE_POSITION)
        assert process.poll() is None
    finally:
        operator.node.destroy_node()
        rclpy.try_shutdown()


def test_what_can_not_be_asked_for_is_refused_with_the_reason(cell: Cell) -> None:
    end = cell.operator.end(cell.operator.start(session_path=str(cell.folder / "s.mcap"), repeats=4294967295))
    assert end.status == ABORTED and "repeats is 4294967295; 1 to 1000 are possible" in end.result.message
    poses = (CELL.parent / "afp_poses.yaml").read_text().replace("pose: 1\n", "pose: abc\n", 1)
    (cell.folder / "poses.yaml").write_text(poses)
    end = cell.operator.end(cell.operator.start(poses_path=str(cell.folder / "poses.yaml")))
    assert end.status == ABORTED and "abc" in end.result.message
    assert cell.procedure.poll() is None


def test_two_procedures_do_not_drive_one_robot(cell: Cell) -> None:
    arguments = {"cell": CELL, "session_folder": cell.folder, "use_sim_time": "true"}
    cell.start(node("irec_calibration.nodes.procedure_node", **arguments), name="second")
    robot = cell.operator
    robot.until(lambda: robot.node.count_publishers("robot/force_setpoint") == 2 and bool(np.isfinite(robot.p_tcp).all()))
    found = time.monotonic() + FIND  # the procedures have to find each other, which nobody can ask them
    robot.until(lambda: time.monotonic() > found)
    p_before = robot.p_tcp
    end = robot.end(robot.start(session_path=str(cell.folder / "s.mcap")))
    assert end.status == ABORTED
    refused = ("2 nodes publish /robot/force_setpoint", "exists already", "recordings are never overwritten")
    assert any(words in end.result.message for words in refused), end.result.message
    assert abs(robot.p_tcp - p_before).max() < 1e-4
