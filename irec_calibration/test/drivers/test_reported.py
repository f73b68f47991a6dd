# SPDX-License-Identifier: Apache-2.0
"""Joint states are believed as far as axes can have moved, and nothing is sent before somebody has asked for something."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import read_cell
from irec_calibration.drivers.moves import MoveError, Planner
from irec_calibration.drivers.position_robot import FAULT, POSITION, Order, PositionRobot
from irec_calibration.procedure.axes import read_axes

CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
PLANNER = Planner(CELL, read_axes(CELL), 0.5)
HOME = np.array([*CELL.home, 0.1])
ZERO = np.zeros(len(HOME))
PERIOD = 0.004


class Heard:
    """A robot, what it is told, and what it sends."""

    def __init__(self) -> None:
        self.robot, self.now = PositionRobot(PLANNER), 100.0
        self.sent: list[np.ndarray] = []

    def state(self, q: np.ndarray, late: float = 0.0) -> None:
        self.now += PERIOD
        self.robot.report(self.now, self.now - late, q)
        out = self.robot.tick(self.now, None)
        if out is not None:
            self.sent.append(out)

    def states(self, q: np.ndarray, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.state(q)

    def move(self) -> None:
        motion = PLANNER.joint(self.robot.commanded, {"joint_1": 0.2}, 0.2)
        self.robot.begin(Order(motion, lambda: False, lambda _: None, lambda _, __: None), self.now)


def test_nothing_is_sent_before_somebody_has_asked_for_something() -> None:
    heard = Heard()
    heard.states(HOME, 2.0)
    heard.robot.switch(False, (0.0, 0.0, 0.0), heard.now)
    heard.robot.set_offset((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), heard.now)
    heard.states(HOME, 0.1)
    assert not heard.sent and heard.robot.mode == POSITION


@pytest.mark.parametrize("zeros", [1, 30, 100])
def test_positions_before_the_hardware_was_read_move_nothing(zeros: int) -> None:
    heard = Heard()
    heard.states(ZERO, zeros * PERIOD)
    heard.states(HOME, 1.0)
    assert not heard.sent and heard.robot.mode == FAULT
    assert "joint_2 has moved from 0 to -1.9 rad" in heard.robot.message


def test_a_second_publisher_is_a_fault_also_after_it_was_cleared() -> None:
    heard = Heard()
    for _ in range(8):
        for _ in range(10):
            heard.states(HOME, 0.1)
            heard.state(ZERO)
        assert heard.robot.mode == FAULT and "two nodes publish joint_states" in heard.robot.message
        heard.robot.clear_fault()
        with pytest.raises(MoveError, match="has not reported its joints yet"):
            heard.move()
    assert not heard.sent


def test_a_jump_in_a_move_holds_the_robot_at_the_last_good_command() -> None:
    heard = Heard()
    heard.states(HOME, 0.6)
    heard.move()
    for _ in range(100):
        heard.state(heard.sent[-1] if heard.sent else HOME)
    good = heard.sent[-1]
    heard.states(ZERO, 0.5)
    assert heard.robot.mode == FAULT
    np.testing.assert_array_equal(heard.sent[-1], good)


def test_after_a_fault_the_robot_is_moved_from_where_states_say_for_some_time_that_it_stands() -> None:
    heard = Heard()
    heard.states(HOME, 0.6)
    heard.states(ZERO, 0.1)
    heard.robot.clear_fault()
    heard.states(ZERO, 0.3)
    with pytest.raises(MoveError, match="0.5 s of joint_states without a jump are needed"):
        heard.move()
    there = HOME + 0.01
    heard.robot.fault("somebody else")
    heard.robot.clear_fault()
    heard.states(there, 0.6)
    heard.move()
    heard.state(there)
    np.testing.assert_allclose(heard.sent[0], there, atol=1e-3)


def test_a_robot_that_another_program_moves_is_not_held_where_it_was() -> None:
    heard = Heard()
    q = HOME.copy()
    for _ in range(200):
        q = q + 1e-4
        heard.state(q)
    with pytest.raises(MoveError, match="the robot does not stand: .* has moved by"):
        heard.move()
    assert not heard.sent


def test_stale_stamps_are_left_out_and_some_of_them_are_a_fault() -> None:
    heard = Heard()
    heard.states(HOME, 0.6)
    heard.state(ZERO, late=3.0)
    assert heard.robot.mode == POSITION and "3.0 s behind the clock, limit 1 s" in heard.robot.left_out
    for _ in range(4):
        heard.state(HOME, late=3.0)
    assert heard.robot.mode == FAULT and "5 states within 1 s were left out" in heard.robot.message


def test_states_that_come_in_another_order_than_they_were_taken_are_a_fault_and_the_same_state_again_is_none() -> None:
    heard = Heard()
    heard.states(HOME, 0.6)
    for _ in range(20):
        heard.robot.report(heard.now, heard.now, HOME)
    assert heard.robot.mode == POSITION
    for _ in range(5):
        heard.robot.report(heard.now, heard.now - 0.1, HOME + 1e-3)
    assert heard.robot.mode == FAULT and "came after that of" in heard.robot.message


@pytest.mark.parametrize(
    ("axis", "value", "sentence"),
    [
        (0, 90.0, "joint_1 is at 90 rad, its limits are -3.229 and 3.229 rad; is it in degrees?"),
        (6, 100.0, "ext_rail is at 100 m, its limits are -1.5 and 1.5 m; is it in mm?"),
        (2, float("nan"), "finite numbers are needed"),
    ],
)
def test_positions_that_cannot_be_are_a_fault_with_the_reason(axis: int, value: float, sentence: str) -> None:
    heard, q = Heard(), HOME.copy()
    q[axis] = value
    heard.states(HOME, 0.1)
    heard.state(q)
    assert heard.robot.mode == FAULT and sentence in heard.robot.message


def test_a_leap_is_never_sent() -> None:
    heard = Heard()
    heard.states(HOME, 0.6)
    heard.move()
    heard.state(HOME)
    heard.robot._base = None  # whatever the reason may be
    heard.robot._order.motion.positions[:] += 0.5  # type: ignore[union-attr]
    heard.state(HOME)
    assert len(heard.sent) == 1 and heard.robot.mode == FAULT and "apart is the limit" in heard.robot.message
