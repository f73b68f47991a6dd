# SPDX-License-Identifier: Apache-2.0
"""The way out of the contact is watched and checked: a run ends out of contact, or says that it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_robot import FakeRobot, settings
from irec_calibration.procedure.commands import CancelMove, ForceSetpoint, MoveJoint, MoveLinear, SwitchMode
from irec_calibration.procedure.settings import Checks


def leaving(**arguments: object) -> FakeRobot:
    """A robot in contact at the first pose, whose force stays when force control is left."""
    robot = FakeRobot(2, **arguments).start().run(stop_when="settle")  # type: ignore[arg-type]
    robot.holds = True
    return robot


def moves_after(robot: FakeRobot, kind: type) -> list[object]:
    """Moves that were asked for after the first command of a kind."""
    first = next(k for k, command in enumerate(robot.commands) if isinstance(command, kind))
    return [c for c in robot.commands[first:] if isinstance(c, MoveJoint | MoveLinear)]


def test_a_retract_that_was_answered_and_not_made_ends_the_run_and_nothing_moves_from_the_contact() -> None:
    robot = leaving()
    robot.retracts = False
    robot.run(60.0)
    told = robot.procedure.stopped_because
    assert "the robot has not left the contact" in told and "tcp_pose says (1000.0, 0.0, -3.0) mm" in told
    assert [type(c) for c in robot.commands if isinstance(c, MoveJoint)] == [MoveJoint, MoveJoint]
    assert "stand_off" in robot.states and robot.is_safe and robot.procedure.is_out
    assert not robot.procedure.counts.complete


def test_the_last_retract_is_checked_before_the_run_is_finished() -> None:
    robot = FakeRobot(1).start().run(stop_when="settle")
    robot.holds, robot.retracts = True, False
    robot.run(60.0)
    assert robot.events[-1].kind == "stopped" and robot.is_safe


def test_a_way_out_that_leads_into_the_surface_is_cancelled_before_the_abort_limit() -> None:
    robot = leaving()
    robot.retracts, robot.drives_in = False, 3000.0
    robot.run(stop_when="lift")
    largest = 0.0
    while robot.procedure.state != "finished":
        robot.tick()
        largest = max(largest, float(np.linalg.norm(robot.force)))
    assert "the move leads into the surface, or the wrench reads wrongly" in robot.procedure.stopped_because
    assert largest < 1400.0 and robot.is_safe
    assert not moves_after(robot, CancelMove)


@pytest.mark.parametrize(
    "way_out, says", [(0.02, "20.0 mm out of the surface, so the wrench reads wrongly"), (-2e-3, "into the surface (2.0 mm by")]
)
def test_by_the_way_of_the_tcp_a_sensor_that_reads_more_is_told_from_a_move_into_the_surface(way_out: float, says: str) -> None:
    robot = leaving()
    robot.run(stop_when="retract")
    robot.tick()
    robot.tcp = robot.tcp - [0.0, 0.0, way_out]
    robot.extra_force = np.array([0.0, 0.0, -700.0])
    robot.run(60.0)
    assert says in robot.procedure.stopped_because


def test_a_run_that_is_ending_watches_its_way_out_as_well() -> None:
    robot = leaving()
    robot.retracts, robot.drives_in = False, 3000.0
    robot.procedure.stop("cancelled by the operator")
    robot.run(60.0)
    assert "cancelled by the operator; the robot presses harder on its way out" in robot.procedure.stopped_because
    assert robot.is_safe


def test_where_the_driver_does_not_draw_the_tool_back_force_control_without_force_does() -> None:
    robot = leaving()
    robot.retracts, robot.leaves_by_itself = False, False
    robot.run(60.0, stop_when="let_go")
    robot.leaves_by_itself, robot.holds = True, False  # the lease is kept, the watch over a standing robot is not
    begun = robot.set_points
    robot.run(60.0)
    last = [c for c in robot.commands if isinstance(c, SwitchMode)][-1]
    assert last.force and not last.force_in_tool.any() and robot.set_points == begun
    assert robot.is_safe and robot.procedure.is_out


def test_without_a_lease_force_control_takes_the_force_away_and_position_control_stays() -> None:
    robot = leaving(settings={"operator_at_robot": True})
    robot.procedure.lease_s = robot.lease = 0.0
    robot.retracts, robot.leaves_by_itself = False, False
    robot.run(60.0, stop_when="let_go")
    robot.holds = False
    robot.run(60.0)
    assert [c.force for c in robot.commands if isinstance(c, SwitchMode)][-2:] == [True, False]
    assert np.linalg.norm(robot.force) < 60.0 and "still reads" not in robot.procedure.stopped_because


def test_a_robot_that_can_not_be_led_out_of_the_contact_is_told_with_its_force() -> None:
    robot = leaving()
    robot.retracts, robot.leaves_by_itself = False, False
    robot.run(60.0, stop_when="let_go")
    robot.obeys_modes, robot.force_control = False, False
    robot.run(60.0)
    told = robot.procedure.stopped_because
    assert "the wrench still reads a force ((-28" in told and "free by hand" in told
    assert not moves_after(robot, ForceSetpoint)[1:], "nothing but the first move off the surface was asked for"


def test_the_first_millimetres_out_of_the_contact_are_slow() -> None:
    robot = FakeRobot(1, settings={"checks": Checks(lift_speed=0.004)}).start().run()
    lift, retract = [c for c in robot.commands if isinstance(c, MoveLinear)][2:]
    assert lift.speed == 0.004 and lift.p_in_base[2] == pytest.approx(-0.006)
    assert retract.speed == robot.procedure.settings.linear_speed


# --- moves that are answered too early ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", ["home", "approach", "advance"])
def test_a_move_that_is_answered_half_way_is_waited_for_until_the_robot_stands(state: str) -> None:
    robot = FakeRobot(1).start().run(stop_when=state)
    for _ in range(3):
        robot.tick()
    q, tcp, at = robot.q.copy(), robot.tcp.copy(), robot.now
    robot.procedure.move_finished(True)  # and the robot goes on, for half a second
    wanted = robot._move
    robot._move = None
    assert wanted is not None
    robot._arrive(wanted[1])
    q_end, tcp_end = robot.q.copy(), robot.tcp.copy()
    while robot.now < at + 0.5:
        share = min(1.0, (robot.now - at) / 0.5)
        robot.q, robot.tcp = q + share * (q_end - q), tcp + share * (tcp_end - tcp)
        robot.tick()
        assert robot.procedure.state == state or share > 0.95 or not (q_end - q).any()
    robot.q, robot.tcp = q_end, tcp_end
    robot.run()
    assert len(robot.rows) == 4 and robot.is_safe


@pytest.mark.parametrize("state", ["approach", "advance"])
def test_a_move_that_ends_half_way_ends_the_run(state: str) -> None:
    robot = FakeRobot(2).start().run(stop_when=state)
    robot.arrives = 0.5
    while robot.procedure.state == state:
        robot.tick()
    robot.arrives = 1.0
    robot.run(60.0)
    assert "was answered with success" in robot.procedure.stopped_because
    assert robot.is_safe and not robot.rows


def touch(robot: FakeRobot, every: int = 1) -> None:
    """Let the wrench read a contact until the way in under way is left."""
    state = robot.procedure.state
    for k in range(20):
        robot.extra_force = np.array([0.0, 0.0, -200.0 if k % every == 0 else 0.0])
        if robot.procedure.state == state:
            robot.tick()
    robot.run(stop_when="lift")
    robot.extra_force = np.zeros(3)


@pytest.mark.parametrize("every", [1, 2], ids=["each reading", "every second reading"])
def test_an_advance_that_meets_the_tooling_is_cancelled_on_its_way(every: int) -> None:
    robot = FakeRobot(6).start().run(stop_when="advance")
    for _ in range(20):
        robot.tick()
    touch(robot, every)
    assert any(isinstance(c, CancelMove) for c in robot.commands)
    robot.run()
    assert robot.events[0].kind == "skipped" and "touches the tooling before the reference" in robot.events[0].text
    assert robot.procedure.counts.complete == 5 and robot.is_safe


def test_a_pose_whose_tooling_is_nearer_by_millimetres_is_measured_from_further_out() -> None:
    robot = FakeRobot(6).start().run(stop_when="near")
    for _ in range(20):
        robot.tick()
    stated, met = robot.procedure.target, robot.tcp[2]
    assert stated is not None
    touch(robot)
    robot.run()
    assert robot.events[0].kind == "nearer" and "measured again from a reference that is" in robot.events[0].text
    assert robot.procedure.counts.complete == 6 and robot.procedure.counts.skipped == 0 and robot.is_safe
    reference = next(row for row in robot.rows if (row.pose, row.load_case) == (stated.pose, 0)).window
    distance = robot.procedure.settings.reference_distance
    assert abs(met - reference.p_tcp_in_base[-1, 2]) == pytest.approx(distance, abs=2e-4)
    assert reference.p_tcp_in_base[-1, 2] != pytest.approx(stated.p_reference[2], abs=1e-3)


def test_a_pose_that_touches_again_is_given_up() -> None:
    robot = FakeRobot(6).start()
    for _ in range(2):
        robot.run(stop_when="near")
        for _ in range(20):
            robot.tick()
        touch(robot)
    robot.run()
    assert [event.kind for event in robot.events[:2]] == ["nearer", "skipped"]
    assert robot.procedure.counts.complete == 5 and robot.is_safe


def test_one_wrong_reading_cancels_no_advance() -> None:
    robot = FakeRobot(1).start().run(stop_when="near")
    robot.extra_force = np.array([0.0, 0.0, -200.0])
    robot.tick()
    robot.extra_force = np.zeros(3)
    robot.run()
    assert robot.procedure.counts.complete == 1 and not any(isinstance(c, CancelMove) for c in robot.commands)


def test_the_last_centimetre_to_the_reference_is_slow() -> None:
    robot = FakeRobot(1).start().run()
    advance, near = [c for c in robot.commands if isinstance(c, MoveLinear)][:2]
    assert advance.speed == robot.procedure.settings.linear_speed and advance.p_in_base[2] == pytest.approx(-0.013)
    assert near.speed == 0.003 and near.p_in_base[2] == pytest.approx(-0.003)


def test_where_the_approach_pose_is_nearer_than_that_all_of_the_way_is_slow() -> None:
    robot = FakeRobot(1, settings={"checks": Checks(near_m=0.2, near_speed=0.02)}).start().run()
    near, lift = [c for c in robot.commands if isinstance(c, MoveLinear)][:2]
    assert near.speed == 0.02 and near.p_in_base[2] == pytest.approx(-0.003) and lift.p_in_base[2] == pytest.approx(-0.006)
    assert robot.procedure.counts.complete == 1


def driven(speed: float, state: str) -> FakeRobot:
    """A robot that goes on at this speed, m/s, on a straight move that takes a second."""
    robot = FakeRobot(1).start().run(stop_when=state)
    for _ in range(30):
        robot.tcp = robot.tcp + [0.0, 0.0, 0.01 * speed]
        if robot.procedure.state == state:
            robot.tick()
    return robot


@pytest.mark.parametrize(("speed", "state", "asked"), [(1.0, "advance", "100"), (0.05, "near", "3")])
def test_a_straight_move_far_faster_than_was_asked_for_ends_the_run(speed: float, state: str, asked: str) -> None:
    robot = driven(speed, state)
    assert any(isinstance(c, CancelMove) for c in robot.commands)
    told = robot.procedure.stopped_because
    assert f"mm/s by tcp_pose on a straight move for which {asked} mm/s was asked" in told


@pytest.mark.parametrize(("speed", "state"), [(0.12, "advance"), (0.01, "near")])
def test_a_straight_move_of_about_the_speed_asked_for_is_none_of_these(speed: float, state: str) -> None:
    assert not driven(speed, state).procedure.stopped_because


def test_one_wrong_pose_is_no_speed() -> None:
    robot = FakeRobot(1).start().run(stop_when="near")
    for _ in range(20):
        robot.tick()
    robot.tcp = robot.tcp + [0.01, 0.0, 0.0]
    robot.tick()
    robot.tcp = robot.tcp - [0.01, 0.0, 0.0]
    robot.run()
    assert robot.procedure.counts.complete == 1


# --- what a run finds ---------------------------------------------------------------------------------------------------------


def test_a_robot_that_is_found_pressing_in_position_control_is_led_out_before_it_goes_home() -> None:
    robot = FakeRobot(1)
    robot.tcp, robot.force, robot.holds = np.array([1.0, 0.0, -0.003]), np.array([0.0, 0.0, -1110.0]), True
    for _ in range(30):
        robot.tick()
    robot.start().run()
    first = next(c for c in robot.commands if isinstance(c, MoveJoint | MoveLinear))
    assert isinstance(first, MoveLinear) and first.p_in_base[2] == pytest.approx(-0.053) and first.speed == 0.005
    assert len(robot.rows) == 4 and robot.is_safe


def test_a_force_across_the_tool_before_a_run_is_refused_since_nobody_knows_the_way_out() -> None:
    robot = FakeRobot(1)
    robot.extra_force = np.array([700.0, 0.0, -100.0])
    for _ in range(30):
        robot.tick()
    robot.start().run(5.0)
    assert "nobody knows the way out" in robot.procedure.stopped_because
    assert not [c for c in robot.commands if isinstance(c, MoveJoint | MoveLinear)]


# --- the sensor after the contact ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bias", "ends"), [(80.0, False), (400.0, True)])
def test_a_pose_counts_only_where_the_force_comes_back_to_that_of_before_contact(bias: float, ends: bool) -> None:
    robot = FakeRobot(3).start().run(stop_when="lift")
    robot.extra_force = np.array([0.0, 0.0, bias])
    robot.run(stop_when="retract")
    assert [e.kind for e in robot.events] == ["discarded", "skipped"]
    assert "the sensor's bias has changed under load" in robot.events[0].text and robot.events[0].pose == 1
    robot.run(stop_when="finished" if ends else "home")
    assert bool(robot.procedure.stopped_because) == ends and not robot.procedure.counts.complete


def test_a_tool_that_touches_a_little_at_the_reference_already_is_no_change_of_the_bias() -> None:
    robot = FakeRobot(2).start().run(stop_when="reference")
    robot.extra_force = np.array([0.0, 0.0, -70.0])
    robot.run(stop_when="contact")
    robot.extra_force = np.zeros(3)  # what is read at the set point is that, and off the surface it is nothing
    robot.run()
    assert robot.procedure.counts.complete == 2 and not [e for e in robot.events if e.kind == "discarded"]


def test_the_limit_of_the_unloaded_force_is_a_setting() -> None:
    robot = FakeRobot(1, settings={"checks": Checks(unloaded_n=120.0)}).start().run(stop_when="lift")
    robot.extra_force = np.array([0.0, 0.0, 80.0])
    robot.run()
    assert robot.procedure.counts.complete == 1


def test_a_marker_that_did_not_come_back_with_the_tcp_ends_the_run_and_its_pose_does_not_count() -> None:
    robot = FakeRobot(2).start().run(stop_when="position_mode")
    robot.marker_follows = False
    robot.run(60.0)
    assert "does not move as the TCP does: from the reference" in robot.procedure.stopped_because
    assert [e.kind for e in robot.events][:2] == ["discarded", "skipped"] and robot.is_safe


def test_noise_and_a_tool_that_swings_are_no_change_of_the_unloaded_force() -> None:
    robot = FakeRobot(2, settings={"settling": replace(settings().settling, force_drift_n=30.0)})
    robot.force_noise = 15.0
    robot.start().run()
    assert robot.procedure.counts.complete == 2


def test_a_sensor_whose_bias_was_set_anew_under_load_does_not_hold_the_robot_in_the_contact() -> None:
    robot = leaving()
    robot.extra_force = np.array([0.0, 0.0, 1100.0])
    robot.run(60.0)
    assert "has stepped" in robot.procedure.stopped_because and "presses harder" not in robot.procedure.stopped_because
    assert "stand_off" not in robot.states and robot.is_safe and not robot.procedure.counts.complete
