# SPDX-License-Identifier: Apache-2.0
"""How a run ends, waits and goes on: cancelled, paused, started again, out of time."""

from __future__ import annotations

import numpy as np
import pytest
from fake_robot import FakeRobot, keys
from irec_calibration.procedure.commands import ForceSetpoint, MoveJoint, MoveLinear, SwitchMode
from irec_calibration.procedure.table import STATES

BARRED = ("stand_off", "let_go", "position_last")  # where the way out was not driven: test_procedure_leaving.py


@pytest.mark.parametrize("state", [s.name for s in STATES.values() if s.otherwise and s.name not in BARRED])
def test_cancel_in_any_state_ends_retracted_in_position_control(state: str) -> None:
    robot = FakeRobot(2)
    robot.force_control = state == "withdraw"
    robot.tick()
    robot.start()
    robot.run(stop_when=state)
    robot.procedure.stop("cancelled by the operator")
    robot.run(30.0)
    assert robot.is_safe
    assert robot.events[-1].kind == "stopped" and "operator" in robot.events[-1].text


def test_cancel_before_the_start_ends_the_run_without_moving() -> None:
    robot = FakeRobot(1)
    robot.procedure.stop("cancelled")
    robot.start().run(1.0)
    assert not [c for c in robot.commands if isinstance(c, MoveJoint)]


def test_too_much_force_ends_the_run_retracted() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.extra_force = np.array([0, 0, -700.0])
    robot.run(30.0)
    assert robot.is_safe
    assert "1600 N" in robot.procedure.stopped_because


def test_a_silent_force_sensor_ends_the_run_retracted() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.delivers_force = False
    robot.run(30.0)
    assert robot.is_safe
    assert "no force readings" in robot.procedure.stopped_because


@pytest.mark.parametrize("state", ["approach", "reference", "settle"])
def test_a_pause_leaves_the_contact_and_the_pose_is_measured_again(state: str) -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when=state)
    robot.procedure.pause()
    robot.run(30.0, stop_when="paused")
    assert robot.is_safe
    for _ in range(2000):
        robot.tick()
    assert robot.procedure.state == "paused"
    before = len(robot.rows)
    robot.procedure.resume()
    robot.run()
    assert keys(robot)[before:] == [(p, 0, j) for p in (1, 2) for j in range(4)]


def test_a_paused_run_can_be_cancelled() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="settle")
    robot.procedure.pause()
    robot.run(30.0, stop_when="paused")
    robot.procedure.stop("cancelled")
    robot.run(1.0)
    assert robot.is_safe


def test_after_a_restart_complete_poses_are_not_measured_again() -> None:
    robot = FakeRobot(3, done=frozenset({(1, 0), (2, 0)})).start().run()
    assert {r.pose for r in robot.rows} == {3}


def test_each_repeat_has_its_own_reference() -> None:
    robot = FakeRobot(1, repeats=2).start().run()
    assert keys(robot) == [(1, r, j) for r in (0, 1) for j in range(4)]


def test_a_move_that_never_ends_is_cancelled_and_the_pose_skipped() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="approach")
    robot._move = None
    robot.run()
    assert robot.events[0].kind == "skipped" and "timeout of 10 s in state approach" in robot.events[0].text
    assert {r.pose for r in robot.rows} == {2}


def test_a_robot_that_does_not_leave_force_control_is_reported() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.obeys_modes = False
    robot.procedure.stop("cancelled by the operator")
    robot.run(30.0)
    assert "position_mode" in robot.procedure.stopped_because
    assert not isinstance(robot.commands[-1], MoveLinear)


def test_a_cell_whose_clock_stops_is_given_up() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    for i in range(200):
        robot._read(0.0)
        robot.procedure.watch.robot_said(int(robot.force_control))
        robot.procedure.step(robot.now, robot.now + 0.1 * i)
    assert robot.procedure.finished
    assert "clock" in robot.procedure.stopped_because


@pytest.mark.parametrize(("state", "gap", "limit"), [("settle", 5.0, "1"), ("settle", 1.1, "1"), ("approach", 2.1, "2")])
def test_a_process_that_was_held_up_says_so_and_calls_no_driver_silent(state: str, gap: float, limit: str) -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when=state)
    robot.now += gap
    robot._read(0.0)  # the newest of what came meanwhile
    robot.delivers_joints = False  # the others are not read yet
    for command in robot.procedure.step(robot.now, robot.now):
        robot._carry_out(command)
    robot.delivers_joints = True
    reason = robot.procedure.stopped_because
    assert f"this process was held up: it has not watched the robot for {gap:.1f} s, limit {limit} s" in reason
    assert "silent" not in reason
    robot.run(30.0)
    assert robot.is_safe and robot.procedure.stopped_because == reason, "the way out has all of its time"


def test_a_process_that_was_held_up_shortly_goes_on() -> None:
    robot = FakeRobot(1).start()
    robot.lease = 2.0
    robot.run(stop_when="settle")
    robot.tick(0.9)
    robot.run(stop_when="retract")
    robot.tick(1.9)
    assert not robot.run().procedure.stopped_because


def test_a_stream_is_silent_from_when_somebody_listened() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="approach")
    robot._move = None
    robot.delivers_joints = False
    for _ in range(3):
        robot.tick(1.9)
    assert not robot.procedure.stopped_because, "nobody has listened for long enough"
    for _ in range(310):
        robot.tick()
    reason = robot.procedure.stopped_because
    assert "no joints readings for 3 s: joint_states is silent" in reason
    assert "(before that this process was held up" not in reason, "that is too long ago"


def test_who_ends_shortly_after_it_was_held_up_says_so() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="settle")
    robot.tick(0.8)
    robot.extra_force = np.array([0, 0, -700.0])
    robot.run(30.0)
    assert robot.procedure.stopped_because.endswith("(before that this process was held up for 0.8 s)")


def test_a_robot_fault_ends_the_run_and_asks_nothing_more() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    commands = len(robot.commands)
    robot.procedure.fault("drives off")
    robot.run(1.0)
    assert "drives off" in robot.events[-1].text
    assert not [c for c in robot.commands[commands:] if isinstance(c, MoveJoint | MoveLinear | SwitchMode | ForceSetpoint)]


def test_too_many_skipped_poses_end_the_run() -> None:
    robot = FakeRobot(4).start()
    robot.tick()
    robot.sees_marker = False
    robot.run()
    assert robot.procedure.counts.skipped == 3
    assert "limit 50%" in robot.procedure.stopped_because


def test_the_operator_is_told_which_pose_of_how_many() -> None:
    robot = FakeRobot(3, bad={2: "out of reach"}, repeats=2).start()
    places = []
    while not robot.procedure.finished:
        robot.tick()
        places.append(robot.procedure.place)
    assert sorted(set(places)) == [1, 3] and places == sorted(places)
    assert robot.procedure.total == 3


def test_the_time_left_falls_to_nothing() -> None:
    robot = FakeRobot(3).start()
    left = []
    while not robot.procedure.finished:
        robot.tick()
        left.append(robot.procedure.remaining_s())
    assert left[0] > 10.0 and left[-1] == 0.0
    assert left[len(left) // 2] < left[0]
