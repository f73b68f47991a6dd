# SPDX-License-Identifier: Apache-2.0
"""The state machine of Procedure 1 against a robot of a few lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_robot import FORCES, FakeRobot, keys, settings
from irec_calibration.procedure.commands import MoveJoint, MoveLinear, SwitchMode
from irec_calibration.procedure.entries import ENTRIES
from irec_calibration.procedure.guards import GUARDS
from irec_calibration.procedure.table import STATES


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
        "position_first", "home", "approach", "advance", "near", "reference", "force_mode", "contact",
        *["establish", "settle"] * 3, "position_mode", "lift", "retract", "finished",
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
    assert [type(m).__name__ for m in moves] == ["MoveJoint", "MoveJoint", *["MoveLinear"] * 4]
    assert moves[2].p_in_base[2] == pytest.approx(-0.013)  # type: ignore[union-attr]
    assert moves[3].p_in_base[2] == pytest.approx(-0.003)  # type: ignore[union-attr]
    assert moves[4].p_in_base[2] == pytest.approx(-0.006) and moves[4].speed == 0.005  # type: ignore[union-attr]
    assert moves[5].p_in_base[2] == pytest.approx(-0.15)  # type: ignore[union-attr]


def move_names(robot: FakeRobot) -> list[str]:
    return [type(c).__name__ for c in robot.commands if isinstance(c, MoveJoint | MoveLinear)]


def test_a_repeat_advances_again_from_the_approach_pose_without_the_way_home() -> None:
    robot = FakeRobot(2, repeats=3, order_seed=4).start().run()
    assert [(r.pose, r.repeat) for r in robot.rows if r.load_case == 0] == [(p, k) for p in (1, 2) for k in range(3)]
    assert kinds(robot) == ["complete"] * 6 + ["finished"] and robot.is_safe
    assert move_names(robot) == ["MoveJoint", "MoveJoint", *["MoveLinear"] * 4 * 3] * 2
    orders = {tuple(r.load_case for r in robot.rows if (r.pose, r.repeat) == (1, k)) for k in range(3)}
    assert len(orders) > 1, "each repeat draws an order of its own"


def test_poses_of_other_numbers_at_the_same_place_are_visited_without_the_way_home() -> None:
    robot = FakeRobot(2)
    (first, _), (second, _) = robot.procedure.work
    robot.procedure.work[1] = (replace(first, pose=second.pose), 0)
    robot.start().run()
    assert [r.pose for r in robot.rows if r.load_case == 0] == [1, 2]
    assert move_names(robot) == ["MoveJoint", "MoveJoint", *["MoveLinear"] * 4 * 2] and robot.is_safe


def test_a_repeat_after_one_that_was_given_up_or_broken_off_begins_at_home() -> None:
    robot = FakeRobot(1, repeats=2, settings={"skip_limit": 1.0}).start()
    robot.run(stop_when="reference")
    robot.sees_marker = False
    robot.run(stop_when="home")
    robot.sees_marker = True
    robot.run()
    assert [(r.pose, r.repeat) for r in robot.rows if r.load_case == 0] == [(1, 1)]
    assert move_names(robot) == ["MoveJoint", "MoveJoint", *["MoveLinear"] * 4] * 2

    robot = FakeRobot(1, repeats=2).start()
    robot.run(stop_when="settle")
    robot.procedure.pause()
    robot.run(stop_when="paused")
    robot.procedure.resume()
    robot.run()
    assert move_names(robot)[:8] == ["MoveJoint", "MoveJoint", *["MoveLinear"] * 4, "MoveJoint", "MoveJoint"]
    assert robot.is_safe


def test_recorded_forces_are_the_means_of_what_was_read() -> None:
    robot = FakeRobot(1).start().run()
    for row in robot.rows[1:]:
        np.testing.assert_allclose(row.window.force_in_tool.mean(axis=0), FORCES[row.load_case - 1], atol=15.0)


def test_a_load_case_is_held_as_long_as_the_cell_file_says_before_its_window_begins() -> None:
    still = settings().settling
    quick, held = (FakeRobot(1, settings={"settling": replace(still, hold_s=s)}).start().run() for s in (0.0, 3.0))
    assert keys(held) == keys(quick)
    for robot, least in ((quick, 0.0), (held, 3.0)):
        begun = [row.window.begin for row in robot.rows]
        between = np.diff(begun)  # the first is the reference, which nothing loads
        assert (between > least).all() and between.max() < least + 3.0


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
    robot.sliding = np.array([2e-4, 0, 0])
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


# --- nothing presses on, nothing false is believed ------------------------------------------------------------------------


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
