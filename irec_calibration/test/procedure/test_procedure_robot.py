# SPDX-License-Identifier: Apache-2.0
"""A robot, driver or sensor that does not do what it is asked to: found within seconds, and the run ends retracted."""

from __future__ import annotations

import numpy as np
import pytest
from fake_robot import FakeRobot
from irec_calibration.procedure.commands import MoveLinear, SwitchMode


def test_the_force_set_point_is_renewed_five_times_per_lease_while_the_robot_presses() -> None:
    robot = FakeRobot(1)
    robot.lease = 1.0
    robot.start().run(stop_when="settle")
    begin, now = robot.set_points, robot.now
    robot.extra_force = np.array([0, 0, 40.0])
    while robot.now < now + 4.0:
        robot.tick()
    assert robot.set_points - begin == pytest.approx(20, abs=1)


def test_a_driver_without_dead_mans_switch_presses_only_where_the_cell_file_says_that_somebody_stands_there() -> None:
    robot = FakeRobot(1)
    robot.lease = 0.0
    robot.start().run()
    assert not robot.set_points and "dead man's switch" in robot.procedure.stopped_because
    assert "operator_at_robot" in robot.procedure.stopped_because and robot.is_safe
    robot = FakeRobot(1, settings={"operator_at_robot": True})
    robot.lease = 0.0
    robot.start().run()
    assert len(robot.rows) == 4


@pytest.mark.parametrize(
    ("lease", "sentence"),
    [(60.0, "press on for 60 s if this computer failed (force_lease), limit 2 s"), (float("nan"), "force_lease is nan s"),
     (float("inf"), "force_lease is inf s"), (-1.0, "force_lease is -1.0 s")],
)  # fmt: skip
def test_a_driver_whose_force_set_point_holds_for_too_long_or_for_no_time_at_all_is_not_pressed_with(
    lease: float, sentence: str
) -> None:
    robot = FakeRobot(1)
    robot.lease = lease
    robot.start().run()
    assert not robot.set_points and sentence in robot.procedure.stopped_because and robot.is_safe


def test_a_robot_that_is_found_pressing_is_led_out_of_the_contact_before_anything_else() -> None:
    robot = FakeRobot(1)
    robot.force_control, robot.near_surface, robot.tcp = True, True, np.array([1.0, 0.0, -0.003])
    robot.tick()
    robot.start().run()
    first, second = robot.commands[:2]
    assert isinstance(first, SwitchMode) and not first.force
    assert isinstance(second, MoveLinear) and second.p_in_base[2] == pytest.approx(-0.003 - 0.05)
    assert len(robot.rows) == 4 and robot.is_safe


def test_leaving_force_control_is_asked_for_again_where_it_was_refused() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.obeys_modes = False
    robot.procedure.stop("cancelled by the operator")
    for _ in range(200):
        robot.tick()
    robot.obeys_modes = True
    robot.run(30.0)
    assert robot.is_safe and robot.procedure.stopped_because == "cancelled by the operator"


def test_a_robot_that_left_the_contact_by_itself_ends_the_run_with_its_own_words() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.retreating, robot.says = True, "no force set point came for 0.5 s"
    robot.tick()
    robot.retreating = False
    robot.run(30.0)
    assert "no force set point came for 0.5 s" in robot.procedure.stopped_because and robot.is_safe


@pytest.mark.parametrize(("silent", "named"), [(True, "joint_states is silent"), (False, "names and units of the goal")])
def test_joint_angles_from_before_a_move_are_not_taken_for_where_it_has_led(silent: bool, named: str) -> None:
    robot = FakeRobot().start().run(stop_when="approach")
    robot.tick()
    robot.arrives = 0.5
    robot.delivers_joints = not silent
    robot.run()
    assert named in robot.procedure.stopped_because and robot.is_safe


def test_a_silent_robot_state_ends_the_run() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.speaks = False
    robot.run(30.0)
    assert "robot/state is silent for 1.5 s" in robot.procedure.stopped_because and robot.is_safe


def test_a_robot_that_is_not_in_force_control_while_it_should_press_is_noticed() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.speaks = False
    for _ in range(150):
        robot.procedure.watch.robot_said(0, False, "teach pendant took over")
        robot.tick()
    robot.run(30.0)
    assert "not in force control" in robot.procedure.stopped_because
    assert "teach pendant took over" in robot.procedure.stopped_because


@pytest.mark.parametrize("jumps", [(1000.0,), (1000.0, 980.0), (-20.0,)])
def test_a_clock_that_is_set_ends_the_run_retracted_within_seconds(jumps: tuple[float, ...]) -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    begin = robot.now
    for jump in jumps:
        robot.clock = jump
        robot.tick()
    robot.clock = 0.0
    robot.run(30.0)
    assert robot.is_safe and robot.now - begin < 5.0
    assert "clock was set by" in robot.procedure.stopped_because


def test_a_clock_that_is_set_again_and_again_does_not_put_time_outs_off() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="settle")
    robot.obeys_modes = False
    begin = robot.now
    for k in range(3000):
        robot.clock = 1000.0 if k % 2 else -20.0
        robot.tick()
        if robot.procedure.finished:
            break
    assert robot.procedure.finished and robot.now - begin < 12.0
    assert "position_mode" in robot.procedure.stopped_because


def test_the_sign_of_the_force_is_judged_within_a_second_of_contact() -> None:
    robot = FakeRobot(2).start()
    robot.force_share = -np.ones(3)
    robot.run(stop_when="contact")
    begin = robot.now
    robot.run(stop_when="position_mode")
    assert robot.now - begin < 1.0
    assert "wrong sign" in robot.procedure.stopped_because
    assert robot.run(30.0).is_safe


def test_a_robot_that_moves_away_when_it_is_to_press_is_stopped() -> None:
    robot = FakeRobot(2).start()
    robot.force_share = np.zeros(3)
    robot.run(stop_when="contact")
    robot.tcp[2] -= 0.004
    robot.run(30.0)
    assert "moves away from the surface" in robot.procedure.stopped_because and robot.is_safe


def test_a_surface_that_is_not_there_is_not_searched_for_on_and_on() -> None:
    robot = FakeRobot(2).start()
    robot.force_share = np.zeros(3)
    robot.run(stop_when="contact")
    robot.tcp[2] += 0.024
    robot.run(30.0)
    assert "no contact: the tool has advanced 24 mm" in robot.procedure.stopped_because and robot.is_safe


def test_a_force_in_kilonewtons_is_told_at_the_first_pose() -> None:
    robot = FakeRobot(3).start()
    robot.force_share, robot.force_noise = 1e-3 * np.ones(3), 1e-3
    robot.run()
    assert "it is in kN" in robot.procedure.stopped_because
    assert not robot.procedure.counts.complete and robot.is_safe


def test_a_set_point_that_is_ignored_is_told_within_seconds() -> None:
    robot = FakeRobot(3).start()
    while len(robot.rows) < 2:
        robot.tick()
    frozen = robot.wanted
    begin = robot.now
    while not robot.procedure.stopped_because:
        robot.tick()
        robot.wanted = frozen
    assert robot.now - begin < 5.0
    assert "force does not follow robot/force_setpoint" in robot.procedure.stopped_because
    assert "as before" in robot.procedure.stopped_because
    assert robot.run(30.0).is_safe


def test_a_tracker_that_never_spoke_is_told_at_the_first_reference() -> None:
    robot = FakeRobot(3)
    robot.sees_marker = False
    robot.start().run(stop_when="reference")
    begin = robot.now
    robot.run(30.0)
    assert robot.now - begin < 6.0 and "tracker/point has not sent a single point" in robot.procedure.stopped_because


def test_a_number_that_is_none_does_not_pass_the_force_limit() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.extra_force = np.array([0.0, np.nan, 0.0])
    robot.run(30.0)
    assert "force is nan N" in robot.procedure.stopped_because and robot.is_safe


def test_a_force_that_leaves_its_set_point_ends_the_run_retracted() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="settle")
    robot.extra_force = np.array([0.0, 0.0, 300.0])
    began = robot.now
    robot.run(30.0)
    assert "the force has left its set point for 1 s" in robot.procedure.stopped_because
    assert robot.is_safe and robot.now - began < 6.0


def test_a_force_before_contact_ends_the_run_before_anything_is_recorded() -> None:
    robot = FakeRobot(2)
    robot.extra_force = np.array([0.0, 0.0, -300.0])
    robot.start().run(30.0)
    assert "before contact the wrench reads" in robot.procedure.stopped_because
    assert robot.is_safe and not robot.rows


def test_a_pose_whose_tooling_is_touched_at_the_reference_is_measured_from_further_out() -> None:
    robot = FakeRobot(6).start()
    robot.run(stop_when="reference")
    robot.extra_force = np.array([-37.0, -53.0, -250.0])
    robot.run(stop_when="retract")
    robot.extra_force = np.zeros(3)
    robot.run()
    assert robot.procedure.counts.skipped == 0 and robot.procedure.counts.complete == 6
    z = [row.window.p_tcp_in_base[-1, 2] for row in robot.rows if row.load_case == 0]
    assert z == pytest.approx([-0.006, *5 * [-0.003]]) and robot.events[0].kind == "nearer"
    assert not robot.procedure.stopped_because and robot.is_safe
