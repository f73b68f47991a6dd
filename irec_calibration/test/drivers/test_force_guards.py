# SPDX-License-Identifier: Apache-2.0
"""A force sensor that does not measure any more, and a driver that is asked to end, must not leave the tool pressing."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from irec_calibration.cell import read_cell
from irec_calibration.drivers.moves import MoveError, Planner
from irec_calibration.drivers.position_robot import FORCE, POSITION, Order, PositionRobot
from irec_calibration.drivers.sensor import RawReadings
from irec_calibration.drivers.settings import Settings
from irec_calibration.errors import IrecError
from irec_calibration.procedure.axes import read_axes
from scipy.spatial.transform import Rotation

CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
PLANNER = Planner(CELL, read_axes(CELL), 0.5)
HOME = np.array([*CELL.home, 0.1])
TICK = 0.01


class Press:
    """A robot that follows at once before a plane, and a sensor of which the reading can be made to stay where it is."""

    def __init__(self, stiffness: float = 1e6, distance: float = 0.003, **settings: float) -> None:
        self.robot, self.stiffness, self.distance = PositionRobot(PLANNER, Settings(**settings)), stiffness, distance
        self.q, self.now = HOME.copy(), 0.0
        p, R, _ = PLANNER.chain.forward(HOME[None, :6])
        self.p0, self.R = p[0], R[0]
        self.noise = np.random.default_rng(1)
        self.held: np.ndarray | None = None
        self.hose, self.creep, self.largest = 0.0, 0.0, 0.0
        self.run(0.6, None)

    @property
    def way(self) -> np.ndarray:
        """From the begin, in the tool (3,), m."""
        p = PLANNER.chain.forward(self.q[None, :6])[0][0]
        return np.asarray(self.R.T @ (p - self.p0))

    @property
    def force(self) -> np.ndarray:
        x, y, z = self.way
        normal = self.stiffness * max(z - self.creep - self.distance, 0.0)
        side = -np.clip(0.5 * self.stiffness * np.array([x, y]), -0.4 * normal, 0.4 * normal)  # it slides
        return np.array([*side, -normal - self.hose * z])

    def tick(self, asked: tuple[float, float, float] | None) -> None:
        self.now += TICK
        if asked is not None and self.robot.mode == FORCE:
            self.robot.set_force(asked, self.now)
        self.robot.report(self.now, self.now, self.q)
        true = self.force
        self.largest = max(self.largest, float(np.linalg.norm(true)))
        read = (true if self.held is None else self.held) + self.noise.normal(0.0, 0.5, 3)
        out = self.robot.tick(self.now, (self.now, read))
        self.q = self.q if out is None else out

    def run(self, seconds: float, asked: tuple[float, float, float] | None) -> None:
        for _ in range(round(seconds / TICK)):
            self.tick(asked)

    def press(self, asked: tuple[float, float, float], seconds: float = 4.0) -> None:
        self.robot.switch(True, asked, self.now)
        self.run(seconds, asked)


@pytest.mark.parametrize(("stiffness", "limit"), [(2.5e5, 700.0), (1e6, 1500.0)])
def test_a_lively_reading_that_stays_at_first_contact_ends_in_a_retreat_within_a_millimetre(
    stiffness: float, limit: float
) -> None:
    press = Press(stiffness)
    press.robot.switch(True, (0.0, 0.0, -1100.0), press.now)
    while press.force[2] > -8.0:
        press.tick((0.0, 0.0, -1100.0))
    press.held = np.array([0.0, 0.0, -8.0])
    press.run(4.0, (0.0, 0.0, -1100.0))
    assert press.largest < limit and not press.force.any()
    assert press.robot.mode == POSITION and press.robot.expired == 1
    assert "mm in contact and the force has risen by" in press.robot.message


def test_a_reading_that_stays_below_the_set_point_in_contact_ends_in_a_retreat() -> None:
    press = Press()
    press.press((0.0, 0.0, -1000.0))
    press.held = press.force + [0.0, 0.0, 100.0]
    press.run(8.0, (0.0, 0.0, -1000.0))
    assert press.largest < 2300.0 and not press.force.any()
    assert "does the force sensor still measure?" in press.robot.message


def test_a_sensor_that_is_zeroed_in_contact_ends_in_a_retreat() -> None:
    press = Press()
    press.press((0.0, 0.0, -1000.0))
    press.held = np.zeros(3)
    press.run(3.0, (0.0, 0.0, -1000.0))
    assert press.largest < 1200.0 and not press.force.any()
    assert "or was the force sensor zeroed?" in press.robot.message


def test_a_surface_that_is_not_there_is_not_looked_for_for_ever() -> None:
    press = Press(distance=1.0)
    press.press((0.0, 0.0, -1000.0), 10.0)
    assert "without contact, limit 30 mm" in press.robot.message and press.robot.mode == POSITION
    assert press.way[2] == pytest.approx(0.01, abs=1e-3)


@pytest.mark.parametrize("stiffness", [2.5e5, 4e6])
def test_an_approach_with_a_hose_creep_and_sliding_at_the_set_point_are_no_reason_to_leave(stiffness: float) -> None:
    press = Press(stiffness, distance=0.02)
    press.hose = 200.0  # N/m: 4 N on the way
    press.press((0.0, 0.0, -1100.0), 16.0 if stiffness < 1e6 else 10.0)
    assert press.force[2] == pytest.approx(-1100.0, rel=0.02)
    for load in ((280.0, 0.0, -1100.0), (0.0, 280.0, -1100.0), (-600.0, 0.0, -1100.0), (0.0, 0.0, -300.0), (0.0, 0.0, -1100.0)):
        for _ in range(300):
            press.creep += 5e-7  # 0.15 mm in each load case
            press.tick(load)
    assert not press.robot.message and press.robot.mode == FORCE


@pytest.mark.parametrize("seconds", [0.3, 4.0])
def test_a_single_reading_that_is_wrong_is_no_reason_to_leave(seconds: float) -> None:
    press = Press()
    press.press((0.0, 0.0, -500.0), seconds)
    for wrong in ([0.0, 0.0, -1200.0], [0.0, 0.0, 0.0]):
        press.held = np.array(wrong)
        press.tick((0.0, 0.0, -500.0))
        press.held = None
        press.run(2.0, (0.0, 0.0, -500.0))
    assert not press.robot.message and press.robot.mode == FORCE


def test_without_a_new_wrench_the_robot_leaves_the_contact() -> None:
    press = Press()
    press.press((0.0, 0.0, -500.0))
    since, wrench = press.now, (press.now, press.force)
    for _ in range(200):
        press.now += TICK
        if press.robot.mode == FORCE:
            press.robot.set_force((0.0, 0.0, -500.0), press.now)
        press.robot.report(press.now, press.now, press.q)
        out = press.robot.tick(press.now, wrench, "it repeats")
        press.q = press.q if out is None else out
        if press.now - since < 0.45:
            assert press.robot.mode == FORCE
    assert press.robot.mode == POSITION and press.robot.message == "it repeats" and not press.force.any()


def test_a_driver_that_ends_in_force_control_leaves_the_contact_first_and_takes_nothing_any_more() -> None:
    press = Press()
    press.press((0.0, 0.0, -1100.0))
    press.robot.end(press.now)
    ticks = 0
    while not press.robot.at_rest:
        press.tick(None)
        ticks += 1
        with pytest.raises(MoveError, match="the driver is ending"):
            press.robot.set_force((0.0, 0.0, -1100.0), press.now)
        with pytest.raises(MoveError, match="the driver is ending"):
            press.robot.switch(False, (0.0, 0.0, 0.0), press.now)
    assert not press.force.any() and ticks * TICK < 2.0 and press.largest < 1150.0
    assert "the driver is ending" in press.robot.message


def test_a_driver_that_ends_in_position_control_in_contact_leaves_it_and_else_moves_nothing() -> None:
    press = Press()
    press.robot.end(press.now)
    assert press.robot.at_rest
    press = Press()
    press.press((0.0, 0.0, -1100.0))
    press.robot.switch(False, (0.0, 0.0, 0.0), press.now)
    press.robot.end(press.now)
    press.run(1.5, None)
    assert press.robot.at_rest and not press.force.any()


def test_a_driver_that_ends_in_a_move_stops_it_on_its_way() -> None:
    press, ended = Press(), list[tuple[float, str]]()
    goal = press.p0 - 0.2 * press.R[:, 2]
    motion = PLANNER.linear(press.robot.commanded, goal, Rotation.from_matrix(press.R).as_quat().tolist(), 0.1)
    press.robot.begin(Order(motion, lambda: False, lambda _: None, lambda f, why: ended.append((f, why))), press.now)
    press.run(0.8, None)
    press.robot.end(press.now)
    press.run(0.6, None)
    assert press.robot.at_rest and 0.2 < ended[0][0] < 0.6 and ended[0][1] == "the driver is ending"


@pytest.mark.parametrize(
    ("lease", "sentence"),
    [(30.0, "30 s, limit 2 s"), (math.nan, "lease of the robot is nan"), (-1.0, "lease of the robot is -1"), (math.inf, "inf")],
)
def test_a_lease_that_is_too_long_or_no_number_is_refused(lease: float, sentence: str) -> None:
    with pytest.raises(IrecError) as error:
        Settings(lease=lease)
    assert sentence in str(error.value)


class Readings:
    """A sensor in its own frame, read at 250 Hz."""

    def __init__(self) -> None:
        self.raw, self.now = RawReadings("ft_sensor", {"ft_sensor", "flange", "tool0"}), 50.0

    def take(self, values: np.ndarray, frame: str = "ft_sensor", ahead: float = 0.0) -> bool:
        self.now += 0.004
        return self.raw.take(self.now, self.now, self.now + ahead, frame, values)

    @property
    def age(self) -> float:
        return math.inf if self.raw.at is None else self.now - self.raw.at


def test_a_raw_reading_that_is_repeated_is_no_new_one_and_then_not_passed_on() -> None:
    sensor, values = Readings(), np.arange(6.0)
    assert sensor.take(values)
    assert all(sensor.take(values) for _ in range(3)) and sensor.age < 1e-9, "a broadcaster may be quicker than its sensor"
    passed_on = sum(sensor.take(values) for _ in range(500))
    assert sensor.age > 1.9 and 100 < passed_on < 150 and "repeats one reading to the last bit" in sensor.raw.problem
    assert sensor.take(values + 1e-9) and sensor.age < 1e-9 and not sensor.raw.problem


def test_a_frame_that_changes_and_a_frame_of_another_link_are_refused() -> None:
    sensor, values = Readings(), np.arange(6.0)
    assert sensor.take(values)
    assert not sensor.take(values + 1.0, frame="world") and "were in 'ft_sensor'" in sensor.raw.problem
    assert not Readings().take(values, frame="flange")
    assert Readings().take(values, frame="some_name_of_the_broadcaster")


@pytest.mark.parametrize("values", [np.full(6, np.nan), np.full(6, 1e6)])
def test_readings_that_cannot_be_are_refused(values: np.ndarray) -> None:
    sensor = Readings()
    assert not sensor.take(values) and sensor.raw.at is None and sensor.raw.problem


def test_readings_that_are_not_newer_or_of_the_future_are_refused() -> None:
    sensor, values = Readings(), np.arange(6.0)
    assert sensor.take(values)
    assert not sensor.take(values + 1.0, ahead=-0.1) and "came after that of" in sensor.raw.problem
    assert not sensor.take(values + 2.0, ahead=1.5) and "ahead of the clock" in sensor.raw.problem
