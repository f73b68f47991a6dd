# SPDX-License-Identifier: Apache-2.0
"""Stamps that can't be times of the rows are said to be none, and nothing that needs them is judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from irec_calibration.session import read_session, write_table
from irec_calibration.session.stamps import trusted

POSES, ROWS = 8, 6
POSE = np.repeat(np.arange(1, POSES + 1), ROWS)
CASE = np.tile(np.arange(ROWS), POSES)
STAMP = np.arange(POSES * ROWS) * 6.0 + 20.0 * (POSE - 1) + 15.0


def judged(stamp, pose=POSE, case=CASE, clock="time", loaded=True):
    return trusted(clock, np.asarray(stamp, dtype=float), pose, np.zeros_like(pose), case, loaded)


NEXT_DAY = STAMP + 86400.0 * (POSE > 4)
BY_CASE = np.lexsort((POSE, CASE))
REFERENCE_LAST = np.lexsort((CASE == 0, POSE))
LEGITIMATE = {
    "as measured": (STAMP, POSE, CASE),
    "a pause overnight": (NEXT_DAY, POSE, CASE),
    "a second day after a month": (STAMP + 30 * 86400.0 * (POSE > 4), POSE, CASE),
    "sorted by load case": (STAMP[BY_CASE], POSE[BY_CASE], CASE[BY_CASE]),
    "references after their load cases": (STAMP, POSE[REFERENCE_LAST], CASE[REFERENCE_LAST]),
    "references measured last, sorted by pose and load case": (STAMP + np.where(CASE == 0, 36.0, 0.0), POSE, CASE),
    "the newest row first": (STAMP[::-1], POSE[::-1], CASE[::-1]),
    "the second half of the file measured first": (STAMP + 1000.0 * (POSE <= 4), POSE, CASE),
    "one load case of all poses after the other": (STAMP + 1e4 * CASE, POSE, CASE),
    "ten minutes a row": (np.arange(len(POSE)) * 600.0, POSE, CASE),
}


@pytest.mark.parametrize("name", LEGITIMATE)
def test_stamps_that_can_be_are_left_as_they_are(name):
    stamp, pose, case = LEGITIMATE[name]
    clock, after, notes = judged(stamp, pose, case)
    assert (clock, notes) == ("time", [])
    np.testing.assert_array_equal(after, stamp)


WRONG = {
    "all the same": (0.0 * STAMP, "none", "in all 48 rows"),
    "backwards": (STAMP[::-1], "none", "fall from row to row"),
    "references 20 s late": (STAMP + 20.0 * (CASE == 0), "order", "stamps of two clocks"),
    "references since 1970": (STAMP + 1.7e9 * (CASE == 0), "order", "in 8 of 8 poses"),
    "restarted in the middle": (STAMP - (STAMP[24] - 3.0) * (POSE > 4), "order", "restart 1 time(s) (first at row 25)"),
    "ms": (STAMP * 1e3, "order", "ms for s?"),
    "ns since 1970": (STAMP * 1e9 + 1.7e18, "order", "ns for s?"),
    "a gap of years": (STAMP + 3e8 * (POSE > 4), "order", "days"),
}


@pytest.mark.parametrize("name", WRONG)
def test_stamps_that_can_not_be_are_not_judged_on_and_that_is_said(name):
    stamp, wanted, reason = WRONG[name]
    clock, _, (note,) = judged(stamp)
    assert clock == wanted and reason in note and f"clock: {wanted}" in note


def test_the_order_of_the_rows_is_taken_where_stamps_are_of_two_clocks():
    clock, stamp, _ = judged(STAMP + 20.0 * (CASE == 0))
    assert clock == "order" and np.all(np.diff(stamp) > 0.0)


def test_an_absolute_session_with_one_stamp_for_all_has_no_clock():
    assert judged(0.0 * STAMP, np.arange(48), 0 * CASE, loaded=False)[0] == "none"


def test_what_is_written_again_keeps_that_its_stamps_are_no_times(tmp_path):
    made = synthetic.session(8)
    late = np.where(made.load_case == 0, made.stamp + 1.7e9, made.stamp)
    folder = write_table(replace(made, stamp=late), tmp_path / "a")
    once = read_session(folder)
    again = read_session(write_table(once, tmp_path / "b"))
    assert once.clock == again.clock == "order"
