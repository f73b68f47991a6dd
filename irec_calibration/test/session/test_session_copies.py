# SPDX-License-Identifier: Apache-2.0
"""Rows that were measured once and stand twice are refused, and readings that are none."""

from __future__ import annotations

from dataclasses import replace

import absolute_sessions
import numpy as np
import pytest
import synthetic
from irec_calibration.errors import SessionError
from irec_calibration.session import Noise
from irec_calibration.session.copies import check_copies

LOADED = synthetic.session(8)


def where(row: int) -> str:
    return f"line {row + 2}"


def twice(session, **changed):
    rows = np.r_[np.arange(len(session)), np.arange(len(session))]
    both = session.select(rows)
    second = np.arange(len(rows)) >= len(session)
    return replace(both, **{name: getattr(both, name) + step * second for name, step in changed.items()})


@pytest.mark.parametrize(
    ("session", "words"),
    [
        (twice(LOADED, pose=100, stamp=1e3), "line 50: pose 101 is a copy of pose 1 (line 2)"),
        (twice(LOADED, repeat=1, stamp=1e3), "line 50: this row of pose 1 is a copy of another (line 2)"),
        (twice(absolute_sessions.session(noise=Noise(tracker_m=1e-5), poses=20), pose=50), "pose 51 is a copy of pose 1"),
    ],
)
def test_copied_rows_are_refused_with_both_places(session, words):
    with pytest.raises(SessionError) as refused:
        check_copies(session, where)
    assert words in str(refused.value)


def test_a_rehearsal_in_which_every_pose_reads_the_same_is_read():
    one = LOADED.select(np.tile(np.arange(6), 7))
    check_copies(replace(one, pose=np.repeat(np.arange(1, 8), 6)), where)


def test_a_reading_that_is_the_same_by_chance_is_no_copy():
    coarse = twice(LOADED, repeat=1)
    check_copies(replace(coarse, p_marker_in_station=np.round(coarse.p_marker_in_station, 4)), where)
    rounded = np.round(LOADED.force_in_tool)
    check_copies(replace(LOADED, force_in_tool=rounded, q=np.round(LOADED.q, 3)), where)
    check_copies(replace(coarse, noise=Noise(0.0)), where)


@pytest.mark.parametrize("value", [0.0, -999.0])
def test_a_number_that_stands_for_no_marker_is_refused_with_what_to_write(value):
    p = LOADED.p_marker_in_station.copy()
    p[3::7] = value
    with pytest.raises(SessionError, match="line 5: marker_.* in 7 rows.*leave the three fields empty"):
        check_copies(replace(LOADED, p_marker_in_station=p), where)


def test_one_row_with_such_a_number_is_left_to_the_diagnosis():
    p = LOADED.p_marker_in_station.copy()
    p[3] = 0.0
    check_copies(replace(LOADED, p_marker_in_station=p), where)


def test_a_marker_on_the_base_may_read_the_same_in_every_pose():
    base = replace(LOADED, markers=(replace(LOADED.markers[0], link="base_link"),))
    p = np.tile([1.0, 0.5, 0.25], (len(base), 1))
    p[::2] += 1e-5
    check_copies(replace(base, p_marker_in_station=p), where)
