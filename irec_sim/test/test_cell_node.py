# SPDX-License-Identifier: Apache-2.0
"""The simulated cell keeps the robot's side of the contract, as a process of its own over DDS."""

from __future__ import annotations

import csv
import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

from action_msgs.msg import GoalStatusArray
from cell_client import Client, client, seconds
from geometry_msgs.msg import TransformStamped
from irec_sim.cellfile import read_cell
from irec_sim.course import plan_course
from irec_sim.nodes.followers import PATIENCE
from std_srvs.srv import Trigger

from irec_msgs.action import Move
from irec_msgs.msg import RobotState

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = pytest.mark.ros
CELL = Path(__file__).parents[2] / "config" / "cells" / "afp.yaml"
MAX_LEAD = 0.25  # s, default of the parameter
FEW_MESSAGES = {f"rate__{stream}": 25.0 for stream in ("joint_states", "tcp_pose", "wrench", "wrench_raw", "tracker")}
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def cell_arguments(**parameters: object) -> list[str]:
    values = {"cell": CELL, "speed_factor": 6.0} | {name.replace("__", "."): value for name, value in parameters.items()}
    settings = [text for name, value in values.items() for text in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", "irec_sim.nodes.cell_node", "--ros-args", *settings]


@pytest.fixture
def cell(ros_domain: int, start_process: Start) -> Iterator[Client]:
    """A running cell and a client that has heard every stream of it."""
    start_process(cell_arguments(), name="cell")
    with client() as connected:
        connected.wait_for_cell()
        yield connected


@pytest.fixture
def fast_cell(ros_domain: int, start_process: Start) -> Iterator[Client]:
    """The same as fast as it will go, for what takes long and does not count messages."""
    start_process(cell_arguments(speed_factor=30.0, **FEW_MESSAGES), name="cell")
    with client() as connected:
        connected.wait_for_cell()
        yield connected


def press(cell: Client, force_z: float = -1100.0) -> None:
    """Go above the mould, almost onto it, and press."""
    plan = plan_course(read_cell(CELL))
    assert cell.go(plan.q_approach, plan.rail).success
    x, y, z = -0.145 * plan.normal[0]
    assert cell.end_of(cell.start_move(cell.line(x, y, z))).result.success
    assert cell.switch(RobotState.MODE_FORCE, (0.0, 0.0, force_z)).success


def test_every_stream_has_its_rate_in_simulated_time(cell: Client) -> None:
    begin = cell.now
    cell.wait_until(begin + 4.0)
    for topic, rate in {"joint_states": 100, "tcp_pose": 100, "tracker/point": 100, "wrench": 250, "wrench_raw": 250}.items():
        stamps = [seconds(message.header.stamp) for message in cell.got[topic]]
        inside = [t for t in stamps if begin < t <= begin + 3.0]
        assert len(inside) == pytest.approx(3 * rate, rel=0.02), topic
        assert all(after > before for before, after in zip(stamps, stamps[1:], strict=False)), topic


def test_streams_name_their_frames_and_joints(cell: Client) -> None:
    assert list(cell.last("joint_states").name) == [*(f"joint_{k}" for k in range(1, 7)), "ext_rail"]
    assert cell.last("tcp_pose").header.frame_id == "base_link"
    assert cell.last("wrench").header.frame_id == "tool0"
    assert cell.last("wrench_raw").header.frame_id == "ft_sensor"
    assert cell.last("tracker/point").header.frame_id == "A"
    assert "<robot" in cell.last("robot_description").data


def test_a_joint_move_ends_where_it_was_sent(cell: Client) -> None:
    goal = [*read_cell(CELL).home, 0.0]
    goal[0] += 0.2
    goal[6] = 0.3
    assert cell.go(goal[:6], goal[6]).success
    cell.wait_until(cell.now + 0.1)
    assert list(cell.last("joint_states").position) == pytest.approx(goal, abs=1e-5)


def test_a_straight_move_stays_on_its_line(cell: Client) -> None:
    start = cell.last("tcp_pose").pose.position
    before = len(cell.got["tcp_pose"])
    x, y, z = start.x, start.y, start.z
    assert cell.end_of(cell.start_move(cell.line(dy=0.2))).status == SUCCEEDED
    path = [message.pose.position for message in cell.got["tcp_pose"][before:]]
    assert max(math.hypot(p.x - x, p.z - z) for p in path) < 2e-4
    assert path[-1].y - y == pytest.approx(0.2, abs=1e-5)


def test_a_cancelled_move_stops_on_its_path(cell: Client) -> None:
    start = cell.last("tcp_pose").pose.position
    x, y, z = start.x, start.y, start.z
    handle = cell.start_move(cell.line(dy=0.3, speed=0.02))
    cell.wait(lambda: cell.last("tcp_pose").pose.position.y > y + 0.01, "motion")
    cancelling = handle.cancel_goal_async()
    cell.wait(cancelling.done, "answer to cancel")
    answer = cell.end_of(handle)
    cell.wait_until(cell.now + 0.2)
    stopped = cell.last("tcp_pose").pose.position
    assert answer.status == CANCELED
    assert y + 0.01 < stopped.y < y + 0.29
    assert math.hypot(stopped.x - x, stopped.z - z) < 2e-4


def test_a_move_out_of_reach_is_aborted_with_the_reason_and_moves_nothing(cell: Client) -> None:
    before = list(cell.last("joint_states").position)
    answer = cell.end_of(cell.start_move(cell.line(dz=4.0)))
    assert answer.status == ABORTED
    assert "reach" in answer.result.message
    cell.wait_until(cell.now + 0.1)
    assert list(cell.last("joint_states").position) == pytest.approx(before, abs=1e-5)


def test_a_move_to_an_unknown_joint_is_aborted_with_the_names_of_the_joints(cell: Client) -> None:
    goal = Move.Goal(kind=Move.Goal.JOINT, joint_names=["joint_9"], joint_position=[0.0], speed=0.5)
    answer = cell.end_of(cell.start_move(goal))
    assert answer.status == ABORTED
    assert "joint_9" in answer.result.message
    assert "joint_6" in answer.result.message


def test_moves_that_have_ended_are_forgotten(ros_domain: int, start_process: Start) -> None:
    """Each change of a move publishes all moves that are remembered: their number must not grow for hours."""
    short = "import irec_ros.moves as moves; moves.RESULT_KEPT = 1; from irec_sim.nodes.cell_node import main; main()"
    start_process([sys.executable, "-c", short, *cell_arguments()[3:]], name="cell")
    with client() as cell:
        told: list[GoalStatusArray] = []
        cell.node.create_subscription(GoalStatusArray, "robot/move/_action/status", told.append, 100)
        cell.wait_for_cell()
        refused = Move.Goal(joint_names=["joint_9"], joint_position=[0.0], speed=0.5)
        for _ in range(5):
            assert cell.end_of(cell.start_move(refused)).status == ABORTED
        cell.wait(lambda: told and len(told[-1].status_list) > 1, "status of several moves")
        since = time.monotonic()
        cell.wait(lambda: time.monotonic() > since + 2.5, "time")  # it looks every second
        told.clear()
        assert cell.end_of(cell.start_move(refused)).status == ABORTED
        cell.wait(lambda: told, "status of the last move")
        assert len(told[-1].status_list) == 1


def test_a_second_move_is_refused_and_the_first_goes_on(cell: Client) -> None:
    first = cell.start_move(cell.line(dy=0.1))
    second = cell.end_of(cell.start_move(cell.line(dy=-0.1)))
    assert second.status == ABORTED
    assert "another move" in second.result.message
    assert cell.end_of(first).status == SUCCEEDED


def test_force_control_presses_with_the_set_point(fast_cell: Client) -> None:
    cell = fast_cell
    press(cell)
    cell.wait(lambda: cell.last("wrench").wrench.force.z < -1080.0, "force")
    cell.wait_until(cell.now + 1.0)
    mean = np.mean([message.wrench.force.z for message in cell.got["wrench"][-20:]])
    assert mean == pytest.approx(-1100.0, abs=5.0)  # standard error of the mean: 0.5 N


def test_in_force_control_moves_are_refused(cell: Client) -> None:
    assert cell.switch(RobotState.MODE_FORCE).success
    answer = cell.end_of(cell.start_move(cell.line(dz=0.01)))
    assert answer.status == ABORTED
    assert "force control" in answer.result.message


def test_the_state_tells_the_active_mode(cell: Client) -> None:
    assert cell.last("robot/state").mode == RobotState.MODE_POSITION
    assert cell.switch(RobotState.MODE_FORCE).success
    cell.wait(lambda: cell.last("robot/state").mode == RobotState.MODE_FORCE, "state in force control")


def test_going_back_to_position_control_does_not_move_the_robot(fast_cell: Client) -> None:
    cell = fast_cell
    press(cell)
    cell.wait(lambda: cell.last("wrench").wrench.force.z < -1080.0, "force")
    cell.wait_until(cell.now + 1.0)
    before = np.mean([m.position for m in cell.got["joint_states"][-10:]], axis=0)
    assert cell.switch(RobotState.MODE_POSITION).success
    cell.wait_until(cell.now + 0.5)
    assert np.abs(np.array(cell.last("joint_states").position) - before).max() < 2e-5


def test_a_client_that_falls_silent_after_force_control_is_left_by_the_robot(fast_cell: Client) -> None:
    cell = fast_cell
    press(cell)
    cell.wait(lambda: cell.last("wrench").wrench.force.z < -1080.0, "force")
    assert cell.switch(RobotState.MODE_POSITION).success
    cell.wait(lambda: cell.last("robot/state").expired_leases == 1, "end of the time for a move")
    cell.wait(lambda: not cell.last("robot/state").retreating, "end of the way back")
    assert cell.last("robot/state").mode == RobotState.MODE_POSITION
    assert "no move came for 2 s" in cell.last("robot/state").message
    cell.wait(lambda: abs(cell.last("wrench").wrench.force.z) < 20.0, "no contact")


def test_a_client_that_falls_silent_while_it_presses_is_left_by_the_robot(fast_cell: Client) -> None:
    cell = fast_cell
    press(cell)
    cell.wait(lambda: cell.last("wrench").wrench.force.z < -1080.0, "force")
    state, begin = cell.last("robot/state"), cell.now
    assert state.mode == RobotState.MODE_FORCE and state.expired_leases == 0 and not state.message
    cell.pressing = None
    cell.wait(lambda: cell.last("robot/state").expired_leases == 1, "end of the lease")
    cell.wait(lambda: not cell.last("robot/state").retreating, "end of the way back")
    assert cell.now - begin < 3.0
    assert cell.last("robot/state").mode == RobotState.MODE_POSITION
    assert "no force set point came for 0.5 s" in cell.last("robot/state").message
    assert abs(cell.last("wrench").wrench.force.z) < 20.0
    answer = cell.switch(RobotState.MODE_POSITION)
    assert answer.success and answer.force_lease == 0.5 and answer.retract_distance == 0.02
    cell.wait(lambda: not cell.last("robot/state").message, "state without a message")


def test_an_offset_is_applied_held_and_faded(ros_domain: int, start_process: Start) -> None:
    start_process(cell_arguments(speed_factor=1.0), name="cell")
    with client() as cell:
        cell.wait_for_cell()
        heard = len(cell.got["wrench"])
        until = cell.now + 1.2

        def answer_each_wrench() -> bool:
            nonlocal heard
            if len(cell.got["wrench"]) > heard:
                heard = len(cell.got["wrench"])
                cell.send_offset(0.0, 0.0, 0.001)
            return cell.now >= until

        cell.wait(answer_each_wrench, "simulated time")
        assert max(m.offset.z for m in cell.got["robot/state"]) == pytest.approx(0.001, abs=1e-6)
        cell.wait(lambda: cell.last("robot/state").offset.z == 0.0, "fading")
        assert cell.last("robot/state").late_offsets >= 1


def test_offsets_of_two_senders_move_the_tool_no_more_than_a_fade_does(ros_domain: int, start_process: Start) -> None:
    start_process(cell_arguments(speed_factor=1.0), name="cell")
    with client() as cell:
        cell.wait_for_cell()

        def send() -> None:
            cell.send_offset(0.0, 0.0, 0.001)

        def applied() -> float:
            send()
            return float(cell.last("robot/state").offset.z)

        cell.wait(lambda: applied() > 0.00099, "the offset")
        rival = cell.node.create_publisher(TransformStamped, "irec/offset", 10)
        cell.wait(lambda: applied() == 0.0, "fading while the offset still comes")
        cell.node.destroy_publisher(rival)
        cell.wait(lambda: applied() > 0.00099, "the offset again")


def test_an_offset_beyond_the_limit_is_cut(ros_domain: int, start_process: Start) -> None:
    start_process(cell_arguments(speed_factor=1.0), name="cell")
    with client() as cell:
        cell.wait_for_cell()
        until = cell.now + 1.0

        def insist() -> bool:
            cell.send_offset(0.05, 0.0, 0.0)
            return cell.now >= until

        cell.wait(insist, "simulated time")
        assert max(m.offset.x for m in cell.got["robot/state"]) == pytest.approx(0.005, abs=1e-6)


def test_after_a_collision_the_robot_is_in_fault_until_the_operator_clears_it(fast_cell: Client) -> None:
    cell = fast_cell
    plan = plan_course(read_cell(CELL))
    assert cell.go(plan.q_approach, plan.rail).success
    x, y, z = -0.18 * plan.normal[0]
    answer = cell.end_of(cell.start_move(cell.line(x, y, z)))
    assert answer.status == ABORTED
    assert "collision" in answer.result.message
    cell.wait(lambda: cell.last("robot/state").mode == RobotState.MODE_FAULT, "state in fault")
    assert not cell.go(plan.q_approach, plan.rail).success
    assert cell.call(cell.clear, Trigger.Request()).success
    x, y, z = 0.1 * plan.normal[0]
    assert cell.end_of(cell.start_move(cell.line(x, y, z))).status == SUCCEEDED


def test_the_cell_does_not_outrun_a_follower(cell: Client) -> None:
    cell.wait_until(cell.now + 0.5)
    cell.follows = False
    told = cell.told
    with pytest.raises(AssertionError):  # well before the end of the cell's patience with a follower, which began a while ago
        cell.wait(lambda: cell.now > told + MAX_LEAD + 0.01, "time beyond the lead", patience=0.6 * PATIENCE)
    cell.follows = True
    cell.wait_until(told + MAX_LEAD + 0.5)


def test_the_course_records_the_true_deviation(ros_domain: int, start_process: Start, tmp_path: Path) -> None:
    start_process(cell_arguments(speed_factor=30.0, course_csv=tmp_path / "course.csv", **FEW_MESSAGES), name="cell")
    with client() as cell:
        cell.wait_for_cell()
        for _ in range(2):  # the second begins where the first has ended
            answer = cell.call(cell.course, Trigger.Request(), patience=120.0)
            assert answer.success, answer.message
    with open(answer.message, newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["s"]) > 1.3
    deviation = [math.hypot(*(float(row[f"deviation_{part}"]) for part in ("along", "lateral", "normal"))) for row in rows]
    assert 2e-4 < np.mean(deviation) < 2e-3
    assert max(float(row["force_z"]) for row in rows) < -500.0


@pytest.mark.parametrize(
    ("parameter", "value", "named"),
    [
        ("speed_factor", 0.0, "speed_factor"),
        ("speed_factor", "fast", "speed_factor"),
        ("cell", "nowhere", "nowhere"),
        ("seed", 1.5, "seed"),
        ("rate__wrench", 1000, "rate.wrench"),
        ("sped_factor", 2.0, "sped_factor"),
    ],
)
def test_a_wrong_parameter_ends_the_node_with_one_line(ros_domain: int, parameter: str, value: object, named: str) -> None:
    done = subprocess.run(cell_arguments(**{parameter: value}), capture_output=True, text=True, timeout=180)
    assert done.returncode == 2
    assert named in done.stderr
    assert "Traceback" not in done.stderr


def test_ros_arguments_that_cannot_be_read_end_the_node_with_the_reason(ros_domain: int) -> None:
    arguments = [*cell_arguments(), "--params-file", "/nowhere/params.yaml"]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=180)
    assert done.returncode == 2
    assert "/nowhere/params.yaml" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_name_from_a_launch_file_goes_for_one_of_the_two_nodes(ros_domain: int, start_process: Start) -> None:
    start_process([*cell_arguments(), "-r", "__node:=cell"], name="cell")
    with client() as cell:
        cell.wait_for_cell()
        cell.wait(lambda: {"cell", "simulator"} <= set(cell.node.get_node_names()), "node simulator beside node cell")
        assert cell.node.get_node_names().count("cell") == 1


def test_an_interrupt_ends_the_node_cleanly(ros_domain: int, start_process: Start) -> None:
    process = start_process(cell_arguments(), name="cell")
    with client() as cell:
        cell.wait_for_cell()
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
