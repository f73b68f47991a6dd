# SPDX-License-Identifier: Apache-2.0
"""The state machine of Procedure 1 against a robot of a few lines."""

from __future__ import annotations

import numpy as np
import pytest
from fake_robot import FORCES, FakeRobot
from irec_calibration.procedure.commands import ForceSetpoint, MoveJoint, MoveLinear, SwitchMode
from irec_calibration.procedure.machine import Procedure
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
        "home", "approach", "advance", "reference", "force_mode", *["establish", "settle"] * 3, "position_mode", "retract",
        "finished",
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
        assert hasattr(Procedure, f"enter_{state.enter}")
        assert all(hasattr(Procedure, f"when_{guard}") for guard, _ in state.leave)
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
    robot.force_share = np.array([0.5, 1, 1])
    robot.run()
    assert keys(robot) == [(1, 0, 0), (1, 0, 1)]
    assert kinds(robot) == ["rejected", "rejected", "complete", "finished"]


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
    robot = FakeRobot(2).start()
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
    for i in range(100):
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
        left.append(robot.procedure.remaining_s(robot.now))
    assert left[0] > 10.0 and left[-1] == 0.0
    assert left[len(left) // 2] < left[0]
