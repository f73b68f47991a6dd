# SPDX-License-Identifier: Apache-2.0
"""A robot that takes joint positions only becomes one of the contract: moves, force, dead man's switch, offset, faults."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.cell import read_cell
from irec_calibration.drivers.moves import Motion, MoveError, Planner, Way
from irec_calibration.drivers.position_robot import FAULT, FORCE, POSITION, Order, PositionRobot
from irec_calibration.drivers.settings import Settings
from irec_calibration.procedure.axes import read_axes
from scipy.spatial.transform import Rotation

CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
AXES = read_axes(CELL)
PLANNER = Planner(CELL, AXES, 0.5)
HOME = np.array([*CELL.home, 0.1])
TICK = 0.01


def tool(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p, R, _ = PLANNER.chain.forward(q[None, :6])
    return p[0], R[0]


class Line:
    """The robot, which follows at once, before a plane of some stiffness 3 mm along the tool from HOME."""

    def __init__(self, stiffness: float = 1e6, **settings: float) -> None:
        self.robot, self.stiffness = PositionRobot(PLANNER, Settings(**settings)), stiffness
        self.now, self.q = 0.0, HOME.copy()
        self.p0, self.R0 = tool(HOME)
        self.p = self.p0
        self.sensor = True
        self.run(0.6)  # until it is known where the robot stands

    @property
    def depth(self) -> float:
        return float((self.p - self.p0) @ self.R0[:, 2])

    @property
    def force(self) -> np.ndarray:
        sideways = self.R0[:, :2].T @ (self.p - self.p0)
        pressed = max(self.depth - 0.003, 0.0)
        return np.array([*(-0.5 * self.stiffness * sideways * (pressed > 0.0)), -self.stiffness * pressed])

    def tick(self, asked: tuple[float, float, float] | None = None) -> None:
        self.now += TICK
        if asked is not None:
            self.robot.set_force(asked, self.now)
        self.robot.report(self.now, self.now, self.q)
        out = self.robot.tick(self.now, (self.now, self.force) if self.sensor else None)
        if out is not None:
            self.q, self.p = out, tool(out)[0]

    def run(self, seconds: float, asked: tuple[float, float, float] | None = None) -> None:
        for _ in range(round(seconds / TICK)):
            self.tick(asked)

    def move(self, motion: Motion, cancelled: Callable[[], bool] = lambda: False) -> list[tuple[float, str]]:
        ended: list[tuple[float, str]] = []
        self.robot.begin(Order(motion, cancelled, lambda _: None, lambda f, p: ended.append((f, p))), self.now)
        return ended


def reported(line: Line, q: np.ndarray, force: np.ndarray) -> np.ndarray | None:
    """A tick with joint states and a force of our choice."""
    line.robot.report(line.now, line.now, q)
    return line.robot.tick(line.now, (line.now, force))


@given(st.floats(1e-4, 10.0), st.floats(1e-3, 5.0), st.floats(0.0, 1.0))
def test_a_stopped_way_ends_on_the_way_within_the_ramp(length: float, speed: float, share: float) -> None:
    way = Way(length, speed)
    t = share * way.duration
    before = way.at(t)
    way.stop(t)
    assert before - 1e-9 <= way.at(t + 0.15) <= way.at(t + 10.0) + 1e-9 <= length + 2e-9
    assert way.done(t + 0.31)


def test_a_line_is_straight_and_ends_where_it_should() -> None:
    line = Line()
    goal = line.p0 + [0.05, 0.1, -0.05]
    ended = line.move(PLANNER.linear(HOME, goal, Rotation.from_matrix(line.R0).as_quat(), 0.1))
    off = 0.0
    while not ended:
        line.tick()
        p = line.p
        way = (goal - line.p0) / np.linalg.norm(goal - line.p0)
        off = max(off, float(np.linalg.norm((p - line.p0) - ((p - line.p0) @ way) * way)))
    assert ended == [(1.0, "")] and off < 5e-5
    np.testing.assert_allclose(tool(line.q)[0], goal, atol=1e-8)


def test_a_cancelled_move_stops_on_its_path_and_says_how_far_it_came() -> None:
    line, asked = Line(), [False]
    goal = line.p0 + [0.0, 0.2, 0.0]
    ended = line.move(PLANNER.linear(HOME, goal, Rotation.from_matrix(line.R0).as_quat(), 0.1), lambda: asked[0])
    line.run(0.8)
    asked[0] = True
    line.run(1.0)
    p, _ = tool(line.q)
    assert ended and 0.2 < ended[0][0] < 0.6
    assert np.abs((p - line.p0)[[0, 2]]).max() < 5e-5


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda: PLANNER.joint(HOME, {"joint_9": 0.0}, 0.5), "joint 'joint_9' is not known"),
        (lambda: PLANNER.joint(HOME, {"joint_1": 9.0}, 0.5), "joint_1 would be at 9, its limits are"),
        (lambda: PLANNER.joint(HOME, {"joint_1": 0.0}, 0.0), "speed of a joint move is 0.0"),
        (lambda: PLANNER.joint(HOME, {"ext_rail": 9.0}, 0.5), "ext_rail would be at 9"),
        (lambda: PLANNER.linear(HOME, np.array([9.0, 0, 0]), (0, 0, 0, 1), 0.1), "the line can't be driven"),
        (lambda: PLANNER.linear(HOME, np.array([np.nan, 0, 0]), (0, 0, 0, 1), 0.1), "is no pose"),
        (lambda: PLANNER.linear(HOME, np.array([1e9, 0, 0]), (0, 0, 0, 1), 0.1), "limit 20 m"),
    ],
)  # fmt: skip
def test_a_move_that_cannot_be_carried_out_is_refused_before_anything_moves(ask: Callable[[], Motion], sentence: str) -> None:
    with pytest.raises(MoveError) as error:
        ask()
    assert sentence in str(error.value)


@pytest.mark.parametrize(("stiffness", "seconds"), [(2.5e5, 9.0), (1e6, 3.5), (4e6, 3.0)])
def test_force_control_makes_contact_slowly_and_holds_the_set_point_on_soft_and_stiff_surfaces(
    stiffness: float, seconds: float
) -> None:
    line = Line(stiffness)
    line.robot.switch(True, (0.0, 0.0, -900.0), line.now)
    fastest, before, most = 0.0, 0.0, 0.0
    for _ in range(round(seconds / TICK)):
        line.tick((0.0, 0.0, -900.0))
        fastest, before = max(fastest, (line.depth - before) / TICK), line.depth
        most = min(most, float(line.force[2]))
    assert fastest < 5.1e-3
    np.testing.assert_allclose(line.force, [0, 0, -900.0], atol=5.0)
    assert most > -950.0, "no overshoot to speak of"
    line.run(seconds, (60.0, -30.0, -900.0))
    np.testing.assert_allclose(line.force, [60.0, -30.0, -900.0], atol=10.0)


def test_a_switch_to_position_control_freezes_the_robot_where_it_is() -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -500.0), line.now)
    line.run(4.0, (0.0, 0.0, -500.0))
    before = line.q.copy()
    line.robot.switch(False, (0.0, 0.0, 0.0), line.now)
    line.run(1.0)
    np.testing.assert_allclose(line.q, before, atol=1e-9)
    assert line.robot.mode == POSITION


def test_a_set_point_that_is_not_renewed_runs_out_and_the_robot_leaves_the_contact_by_itself() -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -500.0), line.now)
    line.run(4.0, (0.0, 0.0, -500.0))
    at = line.depth
    line.run(0.45)
    assert line.robot.mode == FORCE and not line.robot.retreating
    line.run(0.2)
    assert line.robot.retreating and line.robot.expired == 1
    with pytest.raises(MoveError, match="leaving the contact by itself"):
        line.robot.refuse_unless_free()
    line.run(2.0)
    assert line.robot.mode == POSITION and not line.robot.retreating and "no force set point came" in line.robot.message
    assert at - line.depth == pytest.approx(0.02, abs=3e-3) and not line.force.any()


def test_a_robot_left_in_contact_after_force_control_leaves_it_by_itself() -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -500.0), line.now)
    line.run(4.0, (0.0, 0.0, -500.0))
    at = line.depth
    line.robot.switch(False, (0.0, 0.0, 0.0), line.now)
    line.run(1.0)
    line.robot.switch(False, (0.0, 0.0, 0.0), line.now)  # asked again: changes nothing
    line.run(0.9)
    assert not line.robot.retreating and line.depth == at
    line.run(0.2)
    assert line.robot.retreating and line.robot.expired == 1
    line.run(1.5)
    assert not line.robot.retreating and "no move came for 2 s" in line.robot.message
    assert at - line.depth == pytest.approx(0.02, abs=1e-4) and not line.force.any()


@pytest.mark.parametrize("sensor", [True, False])
def test_a_move_that_ends_in_the_contact_begins_the_time_anew(sensor: bool) -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -500.0), line.now)
    line.run(4.0, (0.0, 0.0, -500.0))
    line.sensor = sensor  # a force that is not known is taken for contact
    line.robot.switch(False, (0.0, 0.0, 0.0), line.now)
    line.run(1.5)
    target = line.p - 1e-4 * line.R0[:, 2]
    line.move(PLANNER.linear(line.robot.commanded, target, Rotation.from_matrix(line.R0).as_quat(), 1e-3))
    line.run(1.8)
    assert line.force[2] < -100.0 and not line.robot.retreating
    line.run(3.0)
    assert line.robot.expired == 1 and not line.force.any()


def test_a_robot_out_of_the_contact_stays_where_its_moves_have_led() -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -500.0), line.now)
    line.run(4.0, (0.0, 0.0, -500.0))
    line.robot.switch(False, (0.0, 0.0, 0.0), line.now)
    line.move(PLANNER.linear(line.robot.commanded, line.p0, Rotation.from_matrix(line.R0).as_quat(), 0.05))
    line.run(6.0)
    np.testing.assert_allclose(line.p, line.p0, atol=1e-6)
    assert line.robot.expired == 0 and not line.robot.message


def test_a_set_point_within_the_ramp_takes_the_force_up_again() -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -500.0), line.now)
    line.run(4.0, (0.0, 0.0, -500.0))
    line.run(0.6)
    assert line.robot.retreating
    line.run(3.0, (0.0, 0.0, -500.0))
    assert line.robot.mode == FORCE and line.force[2] == pytest.approx(-500.0, abs=5.0)


def test_without_a_wrench_the_robot_does_not_advance() -> None:
    line = Line()
    line.sensor = False
    line.robot.switch(True, (0.0, 0.0, -500.0), line.now)
    line.run(0.4, (0.0, 0.0, -500.0))
    np.testing.assert_allclose(line.q, HOME, atol=1e-12)


def test_an_offset_is_cut_to_its_limit_faded_in_held_and_faded_out() -> None:
    line = Line()
    biggest, before = 0.0, line.p
    for _ in range(100):
        line.robot.set_offset((0.0, 0.1, 0.0), (0.0, 0.0, 0.0), line.now)
        line.tick()
        biggest, before = max(biggest, float(np.linalg.norm(line.p - before))), line.p
    np.testing.assert_allclose(tool(line.q)[0] - line.p0, [0, 0.005, 0], atol=2e-5)
    line.run(0.05)
    assert line.robot.offset[1] == pytest.approx(0.005) and line.robot.late_offsets == 1
    for _ in range(80):
        line.tick()
        biggest, before = max(biggest, float(np.linalg.norm(line.p - before))), line.p
    assert not line.robot.offset.any() and biggest < 1.5e-4, "5 mm within 0.5 s, at 100 Hz"
    np.testing.assert_allclose(line.q, HOME, atol=1e-9)


def test_offsets_of_two_senders_are_held_and_faded_and_one_is_followed_again_only_from_zero() -> None:
    line = Line()
    largest, before = 0.0, line.p

    def run(ticks: int, offset: float, contested: bool = False) -> None:
        nonlocal largest, before
        for _ in range(ticks):
            if contested:
                line.robot.fade_offset()
            else:
                line.robot.set_offset((0.0, offset, 0.0), (0.0, 0.0, 0.0), line.now)
            line.tick()
            largest, before = max(largest, float(np.linalg.norm(line.p - before))), line.p

    run(100, 5e-4)
    assert line.robot.offset[1] == pytest.approx(5e-4)
    run(10, 0.0, contested=True)
    assert 0.0 < line.robot.offset[1] < 5e-4
    run(20, 0.0)  # the other one is left, and sends something else
    assert 0.0 < line.robot.offset[1]
    run(100, -5e-4)
    assert line.robot.offset[1] == pytest.approx(-5e-4)
    assert largest < 1.5e-5, "0.5 mm within 0.5 s, at 100 Hz"


def test_an_offset_that_comes_again_while_the_last_one_fades_makes_no_step() -> None:
    line = Line()
    for _ in range(100):
        line.robot.set_offset((0.0, 5e-4, 0.0), (0.0, 0.0, 0.0), line.now)
        line.tick()
    line.run(0.3)
    largest, before = 0.0, line.p
    for _ in range(100):
        line.robot.set_offset((0.0, -5e-4, 0.0), (0.0, 0.0, 0.0), line.now)
        line.tick()
        largest, before = max(largest, float(np.linalg.norm(line.p - before))), line.p
    assert line.robot.offset[1] == pytest.approx(-5e-4) and largest < 1.5e-5


def test_a_robot_that_does_not_follow_is_in_fault_until_somebody_clears_it() -> None:
    line = Line()
    ended = line.move(PLANNER.joint(HOME, {"joint_1": 0.5}, 0.5))
    for _ in range(200):
        line.now += TICK
        line.robot.report(line.now, line.now, HOME)
        line.robot.tick(line.now, None)  # the controller is not active: nothing moves
    assert line.robot.mode == FAULT and "is its trajectory controller active?" in line.robot.message
    assert ended and "does not follow" in ended[0][1]
    assert line.robot.tick(line.now, None) is None
    with pytest.raises(MoveError, match="does not follow"):
        line.robot.switch(True, (0, 0, -10.0), line.now)
    line.robot.clear_fault()
    line.q = HOME
    line.run(0.6)
    np.testing.assert_allclose(line.robot.commanded, HOME)


def test_a_set_point_that_is_no_number_is_refused() -> None:
    line = Line()
    with pytest.raises(MoveError, match="finite numbers"):
        line.robot.switch(True, (0.0, float("nan"), -10.0), line.now)
    assert line.robot.mode == POSITION


@pytest.mark.parametrize("ticks", [1, 10, 20])
def test_a_robot_that_is_late_is_pressed_on_without_overshoot(ticks: int) -> None:
    line, on_the_way = Line(), deque([HOME] * ticks)
    line.robot.switch(True, (0.0, 0.0, -1000.0), line.now)
    largest = 0.0
    for _ in range(1000):
        line.now += TICK
        line.robot.set_force((0.0, 0.0, -1000.0), line.now)
        out = reported(line, line.q, line.force)
        assert out is not None, line.robot.message
        on_the_way.append(out)
        line.q = on_the_way.popleft()
        line.p = tool(line.q)[0]
        largest = max(largest, -float(line.force[2]))
    assert largest < 1150.0
    assert line.force[2] == pytest.approx(-1000.0, abs=30.0)


def test_old_states_that_come_in_a_burst_do_not_drive_the_robot_into_the_surface() -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -1000.0), line.now)
    stood, out = line.q, line.q
    for _ in range(100):  # this process was held up for a second, the robot stood meanwhile and read no force
        line.now += TICK
        line.robot.set_force((0.0, 0.0, -1000.0), line.now)
        sent = reported(line, stood, np.zeros(3))
        assert sent is not None
        out = sent
    assert np.linalg.norm(tool(out)[0] - tool(stood)[0]) < 0.25e-3


def test_a_servo_that_gives_way_under_the_load_is_pressed_on_all_the_same() -> None:
    line = Line()
    line.robot.switch(True, (0.0, 0.0, -1000.0), line.now)
    R = line.R0
    for _ in range(1500):
        line.now += TICK
        line.robot.set_force((0.0, 0.0, -1000.0), line.now)
        out = reported(line, line.q, line.force)
        assert out is not None, line.robot.message
        J = PLANNER.chain.forward(out[None, :6])[2][0, :3]
        behind = out.copy()  # 0.3 mm at 1000 N
        behind[:6] += np.linalg.pinv(J) @ (R @ np.array([0.0, 0.0, 3e-7 * line.force[2]]))
        line.q, line.p = behind, tool(behind)[0]
    assert line.force[2] == pytest.approx(-1000.0, abs=30.0)
