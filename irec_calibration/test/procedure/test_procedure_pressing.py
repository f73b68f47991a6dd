# SPDX-License-Identifier: Apache-2.0
"""A force sensor or tracker that reads what is not so while the robot presses is found by the way of the TCP."""

from __future__ import annotations

import numpy as np
import pytest
from fake_robot import FakeRobot
from irec_calibration.procedure.settings import Checks
from irec_calibration.procedure.standstill import Streams

SPEED = 4e-3  # m/s at which a force control advances that has not reached its set point


def advancing(share: float, **arguments: object) -> FakeRobot:
    """A robot that advances in contact while the force reads a share of the set point, from then on."""
    robot = FakeRobot(2, **arguments).start()  # type: ignore[arg-type]
    robot.force_share = np.array([1.0, 1.0, share])
    robot.run(stop_when="contact")
    while robot.force[2] > -0.99 * share * 1100.0:
        robot.tick()
    robot.presses_in = SPEED
    return robot


@pytest.mark.parametrize("share", [0.8, 0.1])
def test_a_force_that_stays_while_the_tool_advances_in_contact_ends_the_run_within_a_millimetre(share: float) -> None:
    robot = advancing(share)
    begin = robot.tcp[2]
    robot.run(stop_when="position_mode")
    assert "force does not rise with the way" in robot.procedure.stopped_because
    assert robot.tcp[2] - begin < 7e-4
    assert robot.run(30.0).is_safe


def test_a_soft_tool_may_go_far_where_its_force_rises() -> None:
    """30 N per mm."""
    robot = FakeRobot(1).start()
    robot.force_share = np.zeros(3)
    robot.run(stop_when="contact")
    while robot.force_share[2] < 1.0:
        robot.force_share = np.full(3, robot.force_share[2] + SPEED * 0.01 * 3e4 / 1100.0)
        robot.tcp = robot.tcp + [0.0, 0.0, SPEED * 0.01]
        robot.tick()
    robot.run()
    assert robot.procedure.counts.complete == 1


def test_the_least_stiffness_is_a_setting() -> None:
    robot = FakeRobot(1, settings={"checks": Checks(least_stiffness=1e2)}).start()
    robot.force_share = np.array([1.0, 1.0, 0.5])
    robot.run(stop_when="contact")
    robot.presses_in = 1e-4
    for _ in range(300):
        robot.tick()
    assert robot.procedure.state == "contact"


def test_a_force_that_steps_in_contact_without_another_set_point_ends_the_run_at_once() -> None:
    robot = FakeRobot(2).start().run(stop_when="settle")
    robot.extra_force = np.array([0.0, 0.0, 1100.0])  # the bias is set anew
    begin = robot.now
    robot.run(stop_when="position_mode")
    assert robot.now - begin < 0.1
    assert "has stepped from -1" in robot.procedure.stopped_because and "bias set anew" in robot.procedure.stopped_because
    robot.extra_force = np.zeros(3)
    assert robot.run(30.0).is_safe


def test_one_wrong_reading_is_no_step() -> None:
    robot = FakeRobot(1).start().run(stop_when="settle")
    robot.extra_force = np.array([0.0, 0.0, 1100.0])
    robot.tick()
    robot.extra_force = np.zeros(3)
    robot.run()
    assert robot.procedure.counts.complete == 1


def test_a_tool_that_goes_on_into_the_surface_at_its_set_point_ends_the_run() -> None:
    robot = FakeRobot(2).start().run(stop_when="contact")
    while abs(robot.force[2]) < 900.0:
        robot.tick()
    robot.presses_in = SPEED
    robot.run(stop_when="position_mode")
    assert "the robot presses on" in robot.procedure.stopped_because
    assert robot.tcp[2] < -0.003 + 2e-3
    assert robot.run(30.0).is_safe


def test_contact_is_not_searched_for_further_than_the_cell_file_says() -> None:
    robot = FakeRobot(2, settings={"checks": Checks(surface_m=0.004)}).start()
    robot.force_share = np.zeros(3)
    robot.run(stop_when="contact")
    robot.tcp = robot.tcp + [0.0, 0.0, 0.0075]
    robot.run(30.0)
    assert "no contact: the tool has advanced 8 mm" in robot.procedure.stopped_because and robot.is_safe


def interleaved(robot: FakeRobot, force: np.ndarray, ticks: int = 40) -> FakeRobot:
    """Every second reading is beside the true one by this, N, until the run does something else."""
    state = robot.procedure.state
    for k in range(ticks):
        robot.extra_force = force * (k % 2)
        if robot.procedure.state == state:
            robot.tick()
    return robot


def test_a_force_that_steps_in_every_second_reading_ends_the_run_too() -> None:
    robot = interleaved(FakeRobot(2).start().run(stop_when="settle"), np.array([0.0, 0.0, 1100.0]))
    assert robot.procedure.state == "position_mode" and "has stepped from -1" in robot.procedure.stopped_because


def test_a_force_beyond_the_abort_limit_is_seen_whoever_sends_the_newest_reading() -> None:
    robot = FakeRobot(2).start().run(stop_when="home")
    for force in (-1700.0, 0.0):  # between two looks
        robot.streams.add_wrench(robot.now + 0.001, (0.0, 0.0, force, 0.0, 0.0, 0.0))
    robot.delivers_force = False
    robot.tick()
    assert "force is 1700 N, limit 1600 N" in robot.procedure.stopped_because


# --- the torque that a pad can carry -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("without_tracker", [False, True])
def test_a_torque_about_the_sensor_gives_no_row_with_a_force_across_the_tool_and_ends_the_run(without_tracker: bool) -> None:
    robot = FakeRobot(3, settings={"pad_radius": 0.03, "without_tracker": without_tracker})
    robot.yields = np.full(3, -1e-7)
    robot.torque_lever = np.array([0.0, 0.0, 0.3])
    robot.start().run()
    assert [r.load_case for r in robot.rows] == [0, 1] and robot.is_safe
    told = robot.procedure.stopped_because
    assert "2 of 3 load cases were rejected" in told and "taken about the sensor in place of the TCP" in told
    assert "300 mm of its part across the tool" in told and "a pad of 30 mm radius (tool.pad_radius)" in told


def test_a_torque_that_the_weight_of_the_tool_leaves_before_contact_is_none_of_the_contact() -> None:
    robot = FakeRobot(1, settings={"pad_radius": 0.03})
    robot.torque_bias = np.array([60.0, -30.0, 5.0])
    robot.torque_lever = np.array([0.01, 0.005, 0.0])  # where the pad presses
    robot.start().run()
    assert robot.procedure.counts.complete == 1


def test_without_a_radius_of_the_pad_no_torque_is_judged() -> None:
    robot = FakeRobot(1)
    robot.torque_lever = np.array([0.0, 0.0, 0.3])
    assert robot.start().run().procedure.counts.complete == 1


# --- the marker in contact ----------------------------------------------------------------------------------------------------


def into_contact(robot: FakeRobot, way: float, marker_way: float) -> FakeRobot:
    """The tool goes `way` m from the reference until it touches, the marker `marker_way`."""
    robot.start().run(stop_when="contact")
    robot.tcp = robot.tcp + [0.0, 0.0, way]
    robot._marker_at = robot.tcp.copy()
    robot.marker = robot.marker + [0.0, 0.0, marker_way]
    return robot


@pytest.mark.parametrize(("way", "marker_way"), [(3e-3, 0.0), (3e-3, 13e-3), (3e-3, -3e-3)])
def test_a_marker_that_does_not_go_with_the_tool_into_the_contact_gives_no_row(way: float, marker_way: float) -> None:
    robot = into_contact(FakeRobot(1), way, marker_way)
    robot.run(60.0)
    assert [r.load_case for r in robot.rows] == [0]
    told = robot.events[0].text
    assert f"{1e3 * marker_way:.2f} mm along the tool" in told and "does not move as the tool does" in told


def test_a_marker_that_stays_behind_by_the_deflection_of_the_arm_is_recorded() -> None:
    robot = into_contact(FakeRobot(1), 3e-3, 3e-3)
    robot.yields = np.array([0.0, 0.0, -2e-6])  # the controller's TCP goes 2.2 mm further
    robot.run(60.0)
    assert robot.procedure.counts.complete == 1


def test_the_limit_of_the_marker_is_a_setting() -> None:
    robot = into_contact(FakeRobot(1, settings={"checks": Checks(marker_m=4e-3)}), 3e-3, 0.0)
    robot.run(60.0)
    assert [r.load_case for r in robot.rows] == [0, 1, 2, 3]


# --- readings that are too few ------------------------------------------------------------------------------------------------


def test_the_forces_before_the_newest_are_none_where_they_are_too_few() -> None:
    streams = Streams(5.0)
    for k in range(6):
        assert streams.force_before(2, 0.06) is None
        streams.add_wrench(0.01 * k, (0.0, 0.0, float(k), 0.0, 0.0, 0.0))
    before = streams.force_before(2, 0.06)
    assert before is not None and before[2] == pytest.approx(1.5)
    np.testing.assert_array_equal(streams.last_forces(2)[:, 2], [4.0, 5.0])


class Controlled(FakeRobot):
    """Whose force control drives what it reads to its set point: the force that acts, with its axes in another order."""

    order, signs, overshoot = (0, 1, 2), np.ones(3), 0.0
    rate = 8.0  # 1/s

    def _read(self, dt: float) -> None:
        acts = self.force.copy()
        super()._read(dt)
        if self.force_control:
            read = acts[list(self.order)] * self.signs
            aim = self.wanted + self.overshoot * self.wanted * [1.0, 1.0, 0.0]
            self.force = acts + self.rate * dt * (aim - read)
            self.extra_force = self.force[list(self.order)] * self.signs - self.force
        else:
            self.extra_force = np.zeros(3)


@pytest.mark.parametrize(("order", "signs", "axis"), [((1, 0, 2), (1, 1, 1), "y"), ((0, 1, 2), (-1, 1, 1), "x")])
def test_a_lateral_force_that_is_driven_by_another_axis_ends_the_run_before_it_is_large(
    order: tuple[int, ...], signs: tuple[int, ...], axis: str
) -> None:
    robot = Controlled(2).start()
    robot.order, robot.signs = order, np.array(signs)
    largest = 0.0
    while not robot.procedure.stopped_because:
        robot.tick()
        largest = max(largest, float(np.hypot(robot.force[0], robot.force[1])))
    reason = robot.procedure.stopped_because
    assert f"the force along {axis} runs away from its set point: asked for (" in reason
    assert "axes" in reason and "exchanged" in reason
    assert largest < 700.0 < robot.procedure.settings.force_abort_n


def test_a_lateral_force_that_grows_while_contact_is_made_ends_the_run_there() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="contact")
    while not robot.procedure.stopped_because:
        assert robot.procedure.state == "contact"
        robot.extra_force = robot.extra_force + [8.0, -8.0, 0.0]
        robot.tick()
    assert "runs away from its set point: asked for (0, 0, -1100) N" in robot.procedure.stopped_because
    assert np.abs(robot.extra_force[:2]).max() < 1.5 * 0.333 * 1100.0 + 100.0


def test_a_tool_that_is_dragged_along_the_surface_as_contact_is_made_is_believed() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="contact")
    while robot.procedure.state == "contact":
        robot.extra_force = np.array([0.4 * robot.force[2] if robot.procedure.in_state_s < 0.6 else 0.0, 0.0, 0.0])
        robot.tick()
    assert robot.procedure.state == "establish" and not robot.procedure.stopped_because


def test_a_force_control_that_overshoots_by_a_fifth_is_believed_while_it_settles() -> None:
    robot = Controlled(1)
    robot.start().run(stop_when="establish")
    while robot.procedure.state not in ("lift", "finished"):
        robot.overshoot = 0.2 if robot.procedure.in_state_s < 0.8 else 0.0
        robot.tick()
    assert not robot.procedure.stopped_because


def test_a_force_beyond_the_abort_limit_names_the_axis_and_what_was_asked_for() -> None:
    robot = FakeRobot(1).start()
    robot.run(stop_when="contact")
    robot.extra_force = np.array([0.0, 1650.0, 0.0])
    robot.run(30.0)
    reason = robot.procedure.stopped_because
    assert "limit 1600 N (procedure.force_abort_n): asked for (0, 0, -1100) N" in reason and "off along y" in reason
