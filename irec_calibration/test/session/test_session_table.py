# SPDX-License-Identifier: Apache-2.0
"""Reading, checking and writing the table form of a session."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
import yaml
from irec_calibration.errors import SessionError
from irec_calibration.session import read_session, write_table
from synthetic import session


@pytest.fixture()
def folder(tmp_path):
    return write_table(session(3), tmp_path / "s")


def _edit(folder, change):
    """Change the rows of samples.csv (list of dicts) in place."""
    text = (folder / "samples.csv").read_text()
    rows = list(csv.DictReader(io.StringIO(text)))
    rows = change(rows) or rows
    with (folder / "samples.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _header(folder, change):
    data = yaml.safe_load((folder / "session.yaml").read_text())
    change(data)
    (folder / "session.yaml").write_text(yaml.safe_dump(data))


def test_a_session_written_and_read_again_is_the_same_to_the_last_bit(folder):
    before, after = session(3), read_session(folder)
    for name in ("pose", "load_case", "repeat", "stamp", "q", "p_tcp_in_base", "p_marker_in_station", "force_in_tool"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name), err_msg=name)
    assert after.noise == before.noise and after.serial == before.serial


@pytest.mark.parametrize(("begin", "shifted"), [(1.76e9, True), (7.2e4, True), (30.0, False)])
def test_stamps_that_do_not_begin_with_the_session_are_counted_from_its_first_row(folder, begin, shifted):
    before = session(3).stamp
    _edit(folder, lambda rows: [{**r, "stamp": repr(float(r["stamp"]) + begin)} for r in rows])
    after = read_session(folder)
    np.testing.assert_allclose(after.stamp, before if shifted else before + begin, atol=1e-6)
    assert any("counted from the first row" in note for note in after.notes) == shifted


def test_a_missing_column_is_named(folder):
    _edit(folder, lambda rows: [{k: v for k, v in r.items() if k != "force_z"} for r in rows])
    with pytest.raises(SessionError, match=r"samples.csv:1: required column 'force_z' is missing"):
        read_session(folder)


@pytest.mark.parametrize(
    ("value", "complaint"), [("nan", "finite"), ("inf", "finite"), ("1,5", "not a number"), ("", "is empty")]
)
def test_a_bad_number_is_named_with_line_and_column(folder, value, complaint):
    _edit(folder, lambda rows: rows[3].update(joint_2=value))
    with pytest.raises(SessionError, match=rf"samples.csv:5: column 'joint_2'.*{complaint}"):
        read_session(folder)


def test_a_loaded_row_without_its_reference_is_refused(folder):
    _edit(folder, lambda rows: [r for r in rows if (r["pose"], r["load_case"]) != ("2", "0")])
    with pytest.raises(SessionError, match="pose 2, load_case 1, repeat 0.* without its reference row"):
        read_session(folder)


def test_a_duplicated_row_is_refused_with_both_lines(folder):
    _edit(folder, lambda rows: [*rows, rows[4]])
    with pytest.raises(SessionError, match=r"samples.csv:20.*is there already.*samples.csv:6"):
        read_session(folder)


def test_degrees_instead_of_radians_are_noticed(folder):
    _edit(folder, lambda rows: rows[0].update(joint_1="45.0"))
    with pytest.raises(SessionError, match="outside the limits of the robot description.*degrees"):
        read_session(folder)


def test_a_marker_that_was_not_seen_is_a_missing_value(folder):
    _edit(folder, lambda rows: rows[2].update(marker_x="", marker_y="", marker_z=""))
    assert read_session(folder).marker_seen.tolist().count(False) == 1


def test_half_a_marker_is_an_error(folder):
    _edit(folder, lambda rows: rows[2].update(marker_x=""))
    with pytest.raises(SessionError, match="all three or none"):
        read_session(folder)


def test_unknown_columns_are_ignored_and_named_once(folder):
    _edit(folder, lambda rows: [{**r, "operator": "x"} for r in rows])
    assert read_session(folder).notes == ("columns ignored: operator",)


def test_a_later_format_is_refused(folder):
    _header(folder, lambda d: d.update(format="irec-session/2"))
    with pytest.raises(SessionError, match="this program reads irec-session/1"):
        read_session(folder)


def test_a_missing_key_of_the_header_is_named(folder):
    _header(folder, lambda d: d.pop("noise"))
    with pytest.raises(SessionError, match="noise is missing"):
        read_session(folder)


def test_a_quaternion_that_is_none_is_refused(folder):
    _header(folder, lambda d: d["stations"][0].update(quat_xyzw=[1, 1, 0, 0]))
    with pytest.raises(SessionError, match="quat_xyzw.*length 1.41"):
        read_session(folder)


def test_nothing_at_the_path_is_said(tmp_path):
    with pytest.raises(SessionError, match="no such file or folder"):
        read_session(tmp_path / "nothing")
