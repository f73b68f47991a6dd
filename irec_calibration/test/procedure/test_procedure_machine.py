# SPDX-License-Identifier: Apache-2.0
"""The state machine of Procedure 1 against a robot of a few lines."""

from __future__ import annotations

import numpy as np
import pytest
from fake_robot import FORCES, FakeRobot
from irec_calibration.procedure.commands import ForceSetpoint, MoveJoint, MoveLinear, SwitchMode
from irec_calibration.procedure.entries import ENTRIES
from irec_calibration.procedure.guards import GUARDS
from irec_calibration.procedure.table import STATES


def keys(robot: FakeRobot) -> list[tuple[int, int, int]]:
    return [(r.pose, r.repeat, r.load_case) for r in robot.rows]


def kinds(robot: FakeRobot) -> list[str]:
    return [e.kind for e in robot.events]


def test_every_pose_gives_its_reference_and_all_load_cases_in_order() -> None:
    robot = FakeRobot(2).start().run()
    assert keys(robot) == [(p, 0, j) for p in (1, 2) for j in range(4)]
    assert kinds(robot) == ["complete", "complete", "finished"]
    assert robot.is_safe


def test_one_pose_goes_through_the_states_in_the_order_of_the_paper() -> None:
    robot = FakeRobot(1).start().run()
    visited = [s for s in robot.states if s not in ("record", "next_case", "next_pose", "idle")]
    assert visited == [
        "position_first", "home", "approach", "advance", "reference", "force_mode", "contact", *["establish", "settle"] * 3,
        "position_mode", "retract", "finished",
    ]  # fmt: skip


def test_the_lines_of_the_table_cover_all_27_lines_of_the_paper() -> None:
    covered: set[int] = set()
    for state in STATES.values():
        if state.lines != "-":
            first, _, last = state.lines.partition("-")
            covered |= set(range(int(first), int(last or first) + 1))
    assert covered == set(range(1, 28))


def test_every_name_in_the_table_exists() -> None:
    for state in STATES.values():
        assert state.enter in ENTRIES
        assert all(guard in GUARDS for guard, _ in state.leave)
        assert not state.timeout or STATES[state.timeout].otherwise
        assert {following for _, following in state.leave} <= STATES.keys()
        assert state.otherwise in ("", "stop", "skip_pose", *STATES)


def test_every_state_that_waits_for_the_robot_has_a_timeout() -> None:
    waits = {"moved", "switched", "force_is_near", "stands_still"}
    for state in STATES.values():
        if any(guard in waits for guard, _ in state.leave):
            assert state.otherwise, state.name


def test_the_robot_advances_only_from_the_approach_pose_and_goes_back_there() -> None:
    robot = FakeRobot(1).start().run()
    moves = [c for c in robot.commands if isinstance(c, MoveJoint | MoveLinear)]
    assert [type(m).__name__ for m in moves] == ["MoveJoint", "MoveJoint", "MoveLinear", "MoveLinear"]
    assert moves[2].p_in_base[2] == pytest.approx(0.003)  # type: ignore[union-attr]
    assert moves[3].p_in_base[2] == pytest.approx(0.15)  # type: ignore[union-attr]


def test_recorded_forces_are_the_means_of_what_was_read() -> None:
    robot = FakeRobot(1).start().run()
    for row in robot.rows[1:]:
        np.testing.assert_allclose(row.window.force_in_tool.mean(axis=0), FORCES[row.load_case - 1], atol=15.0)


def test_a_row_is_not_recorded_before_the_force_stands_still() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="settle")
    robot.extra_force = np.array([0, 0, 14.0])
    wave = 0.0
    for _ in range(300):
        wave += 0.05
        robot.extra_force = np.array([0, 0, 60.0 * np.sin(wave)])
        robot.tick()
    assert keys(robot) == [(1, 0, 0)]
    robot.extra_force = np.zeros(3)
    robot.run()
    assert len(robot.rows) == 4


def test_a_drifting_marker_is_waited_for_and_then_given_up() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="establish")
    robot.sliding = np.array([0, 0, 2e-4])
    robot.run()
    assert keys(robot) == [(1, 0, 0)]
    assert kinds(robot).count("rejected") == 3
    assert "marker drifts" in robot.events[0].text and "timeout" in robot.events[0].text
    assert robot.is_safe


def test_a_slipping_contact_is_not_recorded() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="reference").run(stop_when="establish")
    robot.marker = robot.marker + np.array([0.002, 0, 0])  # it jumped along the surface and stands still again
    robot.run()
    assert keys(robot) == [(1, 0, 0)]
    assert "slipped" in robot.events[0].text


def test_a_force_outside_the_friction_cone_is_not_recorded() -> None:
    robot = FakeRobot(1, settings={"friction": 0.2}).start().run()
    assert keys(robot) == [(1, 0, 0), (1, 0, 1)]
    assert [e.load_case for e in robot.events if e.kind == "rejected"] == [2, 3]
    assert "may slip" in robot.events[0].text


def test_a_load_that_can_not_be_established_costs_only_that_load_case() -> None:
    robot = FakeRobot(1).start()
    while len(robot.rows) < 2:
        robot.tick()
    robot.force_share = np.array([0.5, 1, 1])
    while not robot.events:
        robot.tick()
    robot.force_share = np.ones(3)
    robot.run()
    assert keys(robot) == [(1, 0, 0), (1, 0, 1), (1, 0, 3)]
    assert kinds(robot)[:2] == ["rejected", "complete"]


def test_a_run_of_which_most_load_cases_were_rejected_is_no_success_and_ends_after_the_first_pose() -> None:
    robot = FakeRobot(3).start()
    robot.force_share = np.array([0.5, 1, 1])
    robot.run()
    assert {r.pose for r in robot.rows} == {1} and robot.is_safe
    assert "2 of 3 load cases were rejected, limit 50%" in robot.procedure.stopped_because
    assert "asked for (-280, 0, -1100) N, the wrench reads (-1" in robot.procedure.stopped_because


def test_without_line_of_sight_the_pose_is_skipped_and_the_next_one_measured() -> None:
    robot = FakeRobot(2).start()
    robot.run(stop_when="reference")
    robot.sees_marker = False
    robot.run(stop_when="home")
    robot.sees_marker = True
    robot.run()
    assert [e.kind for e in robot.events] == ["skipped", "complete", "finished"]
    assert "marker" in robot.events[0].text
    assert {r.pose for r in robot.rows} == {2}


def test_a_pose_with_a_problem_is_never_approached() -> None:
    robot = FakeRobot(3, bad={2: "too close to a singularity"}).start().run()
    assert {r.pose for r in robot.rows} == {1, 3}
    assert robot.events[0].kind == "skipped" and "singularity" in robot.events[0].text
    approached = [c.q[0] for c in robot.commands if isinstance(c, MoveJoint)]
    assert 0.2 not in approached


def test_a_run_with_only_bad_poses_ends_without_moving() -> None:
    robot = FakeRobot(1, bad={1: "out of reach"}).start().run()
    assert not [c for c in robot.commands if isinstance(c, MoveJoint | MoveLinear)]
    assert robot.procedure.stopped_because


@pytest.mark.parametrize("state", [s.name for s in STATES.values() if s.otherwise])
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


# --- nothing presses on, nothing false is believed ------------------------------------------------------------------------


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


def test_a_robot_that_is_found_pressing_is_led_out_of_the_contact_before_anything_else() -> None:
    robot = FakeRobot(1)
    robot.force_control, robot.near_surface = True, True
    robot.tick()
    robot.start().run()
    first, second = robot.commands[:2]
    assert isinstance(first, SwitchMode) and not first.force
    assert isinstance(second, MoveLinear) and second.p_in_base[2] == pytest.approx(0.003 - 0.05)
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


def test_the_order_of_the_load_cases_is_drawn_per_pose_and_can_be_drawn_again() -> None:
    orders = []
    for _ in range(2):
        robot = FakeRobot(6, order_seed=7).start().run()
        orders.append([k for k in keys(robot) if k[2]])
    assert orders[0] == orders[1]
    per_pose = [[j for p, _, j in orders[0] if p == pose] for pose in range(1, 7)]
    assert all(sorted(order) == [1, 2, 3] for order in per_pose)
    assert len({tuple(order) for order in per_pose}) > 2


def test_contact_is_made_with_the_normal_force_alone_whatever_case_comes_first() -> None:
    robot = FakeRobot(6, order_seed=7).start().run()
    first = [c.force_in_tool for c in robot.commands if isinstance(c, SwitchMode) and c.force]
    np.testing.assert_allclose(first, np.tile([0, 0, -1100.0], (6, 1)))


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


def test_a_pose_whose_tooling_is_touched_too_early_is_skipped_and_the_run_goes_on() -> None:
    robot = FakeRobot(6).start()
    robot.run(stop_when="reference")
    robot.extra_force = np.array([-37.0, -53.0, -250.0])
    robot.run(stop_when="home")
    robot.extra_force = np.zeros(3)
    robot.run()
    assert robot.procedure.counts.skipped == 1 and robot.procedure.counts.complete == 5
    assert not robot.procedure.stopped_because and robot.is_safe
