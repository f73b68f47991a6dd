# SPDX-License-Identifier: Apache-2.0
"""What a driver can get wrong in one message is refused at the boundary and told with its value."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_calibration.cell import read_cell
from irec_calibration.errors import CellError
from irec_calibration.procedure.axes import read_axes
from irec_calibration.procedure.inputs import Inputs, lag_limit
from irec_calibration.procedure.standstill import Streams

CELL = read_cell(Path(__file__).parents[3] / "config" / "cells" / "afp.yaml")
AXES = read_axes(CELL)
NOW = 100.0
NO = (0.0, 0.0, 0.0)
Q = (*CELL.home.tolist(), 0.1)
UP = (0.0, 0.0, 0.0, 1.0)


def inputs() -> Inputs:
    return Inputs(Streams(5.0), AXES, ["A"])


def feed(i: Inputs) -> None:
    assert i.wrench(NOW, NOW, "tool0", (0.0, 0.0, -1100.0), (0.0, 0.0, 0.0))
    assert i.joints(NOW, NOW, AXES.driver, Q)
    assert i.tcp(NOW, NOW, "base_link", (1.9, 0.0, 1.1), UP)
    assert i.marker(NOW, NOW, "A", (3.0, 0.0, 0.1))


def test_good_readings_pass() -> None:
    i = inputs()
    feed(i)
    assert not i.problem and set(i.streams.newest()) == {"force", "joints", "TCP", "marker"}


WRONG: dict[str, tuple[Callable[[Inputs], bool], str]] = {
    "frame of the wrench": (lambda i: i.wrench(NOW, NOW, "base_link", NO, NO), "wrench: header.frame_id is 'base_link'"),
    "no number for a force": (lambda i: i.wrench(NOW, NOW, "tool0", (0, math.nan, 0), NO), "wrench: the force is (0, nan, 0)"),
    "torque without end": (lambda i: i.wrench(NOW, NOW, "tool0", (0, 0, 0), (math.inf, 0, 0)), "the torque is (inf, 0, 0)"),
    "force that can't be": (lambda i: i.wrench(NOW, NOW, "tool0", (0, 0, 1e9), NO), "more than 100000 N"),
    "stamp 0": (lambda i: i.wrench(NOW, 0.0, "tool0", NO, NO), "wrench: the stamp is 0"),
    "stamp of 1970": (lambda i: i.wrench(1.7e9, 12.0, "tool0", NO, NO), "behind the clock"),
    "stamp of tomorrow": (lambda i: i.wrench(NOW, NOW + 86400.0, "tool0", NO, NO), "86400.0 s ahead of the clock"),
    "world": (lambda i: i.tcp(NOW, NOW, "world", (1.9, 0, 1.1), UP), "tcp_pose: header.frame_id is 'world'"),
    "TCP in mm": (lambda i: i.tcp(NOW, NOW, "base_link", (1900.0, 0, 1100.0), UP), "is it in mm?"),
    "no orientation": (lambda i: i.tcp(NOW, NOW, "base_link", (1.9, 0, 1.1), (0, 0, 0, 0)), "a unit quaternion is needed"),
    "station": (lambda i: i.marker(NOW, NOW, "tracker", (3.0, 0, 0)), "is 'tracker'; the stations of the cell file are 'A'"),
    "marker in mm": (lambda i: i.marker(NOW, NOW, "A", (3000.0, 0, 0)), "(3000, 0, 0) m from the station; is it in mm?"),
    "marker at zero": (lambda i: i.marker(NOW, NOW, "A", (0.0, 0.0, 0.0)), "while the line of sight is broken"),
    "three positions": (lambda i: i.joints(NOW, NOW, AXES.driver, Q[:3]), "joint_states: 7 names with 3 positions"),
    "degrees": (lambda i: i.joints(NOW, NOW, AXES.driver, [math.degrees(v) for v in Q]), "joint_2 is at -108.9 rad"),
    "names": (lambda i: i.joints(NOW, NOW, [f"a{k}" for k in range(1, 8)], Q), "there is no 'joint_1' among 'a1', 'a2'"),
    "two places of one joint": (
        lambda i: i.joints(NOW, NOW, (*AXES.driver, "joint_2"), (*Q, 1.5)),
        f"joint_states: 'joint_2' is named 2 times, at {Q[1]:.6g} and at 1.5",
    ),
    "no rail": (lambda i: i.joints(NOW, NOW, AXES.driver[:6], Q[:6]), "there is no 'ext_rail'"),
    "joint that is no number": (lambda i: i.joints(NOW, NOW, AXES.driver, (math.nan, *Q[1:])), "finite numbers are needed"),
}  # fmt: skip


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_message_is_refused_and_told_with_its_value(wrong: str) -> None:
    i = inputs()
    call, message = WRONG[wrong]
    assert not call(i)
    assert message in i.problem
    assert not i.streams.newest()


def test_a_stamp_that_is_ahead_of_a_clock_which_is_heard_late_is_left_out_and_ends_no_run() -> None:
    i = inputs()
    assert not i.joints(NOW, NOW + 2.8, AXES.driver, Q)
    assert not i.problem and "2.8 s ahead of the clock" in i.dropped["joint_states"]
    assert i.joints(NOW + 2.7, NOW + 2.85, AXES.driver, Q)
    assert not i.problem


def test_stamps_that_stay_ahead_of_the_clock_are_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    machine = iter((5.0, 5.3, 5.6))
    monkeypatch.setattr("irec_calibration.procedure.inputs.time.monotonic", lambda: next(machine))
    i = inputs()
    for k in range(2):
        assert not i.joints(NOW + k, NOW + k + 2.8, AXES.driver, Q) and not i.problem
    assert not i.joints(NOW + 2.0, NOW + 4.8, AXES.driver, Q)
    assert "joint_states: the stamp is 2.8 s ahead of the clock, limit 2 s; does the driver use this clock" in i.problem


def points(i: Inputs, lags: list[float], rate: float = 50.0) -> None:
    """Markers with these lags, s, one after the other as they come."""
    for k, lag in enumerate(lags):
        now = NOW + k / rate
        i.marker(now, now - lag, "A", (3.0, 1e-6 * k, 0.1))


def real() -> Inputs:
    """With the limit of a real cell with an averaging window of 0.4 s."""
    return Inputs(Streams(5.0), AXES, ["A"], lag_limit(0.4))


@pytest.mark.parametrize("off", [-1.9, -0.25, 0.25, 1.9])
def test_stamps_of_another_clock_than_the_cells_are_a_fault_either_way(off: float) -> None:
    i = real()
    points(i, [off + 0.001 * (k % 7) for k in range(60)])
    which = "ahead of" if off < 0 else "behind"
    assert f"{which} the clock, limit 200 ms" in i.problem and i.problem.startswith("tracker/point: the stamps of 51 readings")


@pytest.mark.parametrize("lags", [
    [0.19] * 150,
    [-0.15] * 150,
    [0.02 * (24 - k % 25) for k in range(150)],  # 25 at a time, of which the last comes at once
    [-0.25 if k == 20 else 0.01 for k in range(150)],  # one slip
])  # fmt: skip
def test_readings_that_are_late_in_bursts_are_of_the_same_clock(lags: list[float]) -> None:
    i = real()
    for k, lag in enumerate(lags):
        taken = NOW + 0.02 * k
        i.marker(taken + lag, taken, "A", (3.0, 1e-6 * k, 0.1))
    assert not i.problem


def test_the_clock_of_each_source_is_judged_by_itself() -> None:
    i = real()
    for k in range(300):
        now = NOW + 0.004 * k
        i.wrench(now, now + 0.3, "tool0", (1e-6 * k, 0.0, 0.0), NO)
        i.joints(now, now, AXES.driver, Q)
    assert list(i.faults) == ["wrench"] and "are 300 ms ahead of the clock" in i.problem


def test_the_limit_between_clocks_is_half_the_averaging_window_within_bounds() -> None:
    assert [lag_limit(w) for w in (0.05, 0.4, 10.0)] == [0.1, 0.2, 0.3]


def test_a_simulated_clock_may_be_heard_late() -> None:
    i = inputs()
    points(i, [-1.0] * 150)
    assert not i.problem


def test_a_fault_stays_until_the_next_run() -> None:
    i = inputs()
    i.wrench(NOW, NOW, "tool0", (0, math.nan, 0), NO)
    feed(i)
    assert "nan" in i.problem
    i.begin_run(NOW)
    assert not i.problem


def test_a_late_reading_of_before_the_run_neither_judges_nor_feeds_it() -> None:
    i = inputs()
    feed(i)
    i.temperature("base", 21.0)
    begun = NOW + 1.0
    i.begin_run(begun)
    assert not i.streams.newest() and not i.streams.temperature, "what was read before is kept"
    late, now = begun - 0.01, begun + 0.2
    assert not i.wrench(now, late, "base_link", NO, NO)
    assert not i.tcp(now, late, "world", (1.9, 0.0, 1.1), UP)
    assert not i.marker(now, late, "leica", (3.0, 0.0, 0.1))
    assert not i.joints(now, late, ("a1",), (0.0,))
    assert not i.wrench(now, late, "tool0", NO, NO), "a good one of before feeds the run"
    assert not i.problem and not i.streams.newest()
    assert not i.wrench(now, begun, "base_link", NO, NO)
    assert "header.frame_id is 'base_link'" in i.problem, "of the run itself it is a fault"


def test_a_clock_far_behind_is_a_fault_of_the_run_and_not_a_late_reading() -> None:
    i = inputs()
    i.begin_run(NOW)
    i.wrench(NOW + 1.0, NOW - 2.0, "tool0", NO, NO)
    assert "wrench: the stamp is 3.0 s behind the clock" in i.problem


def test_another_driver_is_not_held_against_what_the_one_before_said() -> None:
    i = inputs()
    feed(i)
    i.marker(NOW, NOW + 1.5, "A", (3.0, 0.0, 0.2))  # its clock was ahead
    i.begin_run(NOW + 0.1)
    later = NOW + 0.2
    assert i.joints(later, later, AXES.driver, (*Q[:-1], Q[-1] + 0.3)), "the robot was moved meanwhile"
    assert i.marker(later, later, "A", (3.0, 0.0, 0.1))
    assert not i.problem


def test_a_simulated_clock_that_begins_anew_ends_no_readings() -> None:
    i = inputs()
    i.begin_run(NOW)
    assert i.wrench(1.0, 1.0, "tool0", NO, NO)


def test_each_source_keeps_its_first_fault() -> None:
    i = inputs()
    i.wrench(NOW, NOW, "base_link", NO, NO)
    i.wrench(NOW, 0.0, "tool0", NO, NO)
    i.tcp(NOW, NOW, "world", (1, 0, 1), UP)
    assert len(i.faults) == 2 and "base_link" in i.faults["wrench"]


def test_a_stamp_that_stands_is_a_fault_and_a_single_repetition_is_left_out() -> None:
    i = inputs()
    feed(i)
    assert not i.marker(NOW, NOW, "A", (3.0, 0.0, 0.1)) and not i.problem
    for _ in range(20):
        i.marker(NOW + 0.1, NOW, "A", (3.0, 0.0, 0.1))
    assert "not newer than stamp 100.000 s" in i.problem


def test_a_joint_that_is_named_twice_at_one_place_is_taken() -> None:
    i = inputs()
    assert i.joints(NOW, NOW, (*AXES.driver, "joint_2"), (*Q, Q[1]))
    assert i.joints(NOW + 0.01, NOW + 0.01, ("gripper", "gripper", *AXES.driver), (0.0, 1.0, *Q)), "of another device"


def test_joints_come_in_any_order_and_with_others_beside_them() -> None:
    i = inputs()
    assert i.joints(NOW, NOW, ("gripper", *reversed(AXES.driver)), (7.0, *reversed(Q)))
    assert i.streams.newest_joints is not None and tuple(i.streams.newest_joints) == Q
    assert i.streams.names == AXES.recorded


def test_a_cell_file_states_how_the_driver_names_the_joints(tmp_path: Path) -> None:
    text = CELL.path.read_text().replace("../robots", str(CELL.path.parents[1] / "robots"))
    named = text.replace("  serial:", "  joint_names: [a1, a2, a3, a4, a5, a6]\n  serial:")
    named = named.replace("range: [-1.5, 1.5]}", "range: [-1.5, 1.5], joint_name: e1}")
    (tmp_path / "cell.yaml").write_text(named)
    axes = read_axes(read_cell(tmp_path / "cell.yaml"))
    assert axes.driver == ("a1", "a2", "a3", "a4", "a5", "a6", "e1")
    assert axes.recorded == (*(f"joint_{k}" for k in range(1, 7)), "ext_rail")
    (tmp_path / "cell.yaml").write_text(named.replace("a1, a2", "a1"))
    with pytest.raises(CellError, match="the description has 6 joints"):
        read_cell(tmp_path / "cell.yaml")
    (tmp_path / "cell.yaml").write_text(named.replace("joint_name: e1", "joint_name: a1"))
    with pytest.raises(CellError, match="a name is there twice"):
        read_axes(read_cell(tmp_path / "cell.yaml"))


@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=9), st.lists(st.text(max_size=8), max_size=9),
    st.floats(allow_nan=True, allow_infinity=True), st.text(max_size=8),
)  # fmt: skip
def test_nothing_that_can_be_sent_raises_or_passes_unnoticed(
    values: list[float], names: list[str], stamp: float, frame: str
) -> None:
    i = inputs()
    three, four = (values + [0.0] * 3)[:3], (values + [0.0] * 4)[:4]
    i.joints(NOW, stamp, names, values)
    i.tcp(NOW, stamp, frame, three, four)
    i.marker(NOW, stamp, frame, three)
    i.wrench(NOW, stamp, frame, three, three)
    i.temperature(frame, stamp)
    assert all(math.isfinite(t) for t in i.streams.newest().values())
    assert i.streams.newest_force is None or all(math.isfinite(v) for v in i.streams.newest_force)


def test_a_wrench_repeated_to_the_last_bit_is_refused_after_a_second_and_a_noisy_one_never() -> None:
    i = inputs()
    for k in range(500):
        t = NOW + 0.004 * k
        assert i.wrench(t, t, "tool0", (1e-9 * k, 0.0, -1100.0), NO)
    for k in range(500, 700):
        t = NOW + 0.004 * k
        assert i.wrench(t, t, "tool0", (0.0, 0.0, -1100.0), NO)
    for k in range(700, 800):
        i.wrench(NOW + 0.004 * k, NOW + 0.004 * k, "tool0", (0.0, 0.0, -1100.0), NO)
    assert "wrench: (0, 0, -1100, 0, 0, 0) is repeated to the last bit for 1.0 s" in i.problem


def test_a_point_repeated_to_the_last_bit_is_refused_after_a_second() -> None:
    i = inputs()
    for k in range(120):
        i.marker(NOW + 0.01 * k, NOW + 0.01 * k, "A", (3.0, 0.0, 0.1))
    assert "tracker/point: (3, 0, 0.1) is repeated to the last bit" in i.problem


def test_an_axis_that_moves_further_than_its_speed_allows_is_refused() -> None:
    i = inputs()
    assert i.joints(NOW, NOW, AXES.driver, Q)
    assert not i.joints(NOW + 0.01, NOW + 0.01, AXES.driver, (*Q[:-1], Q[-1] + 0.3))
    assert "ext_rail has moved from 0.1 to 0.4 m in 10 ms" in i.problem
    assert "or the stamps jitter (the last 1 are 10 to 10 ms apart)" in i.problem


def test_an_axis_at_full_speed_is_believed_where_stamps_are_made_on_arrival_after_a_hiccup() -> None:
    """Readings every 12 ms, of which five are held up and stamped 1 ms apart."""
    speed = AXES.velocity[3]
    i = inputs()
    for k in range(200):
        taken = 0.012 * k
        stamp = NOW + (taken if k % 40 > 4 or k < 40 else 0.012 * (k - k % 40) + 0.05 + 0.001 * (k % 40))
        q = [*Q[:3], Q[3] + 0.9 * speed * (taken if taken < 1.2 else 2.4 - taken) - 0.5 * speed, *Q[4:]]
        assert i.joints(stamp, stamp, AXES.driver, q), i.problem


def test_a_jump_is_none_of_jitter_where_stamps_jitter() -> None:
    i = inputs()
    for k in range(50):
        stamp = NOW + 0.012 * k + 0.008 * (k % 2)
        assert i.joints(stamp, stamp, AXES.driver, Q)
    assert not i.joints(NOW + 0.6, NOW + 0.6, AXES.driver, (*Q[:-1], Q[-1] + 0.3))
