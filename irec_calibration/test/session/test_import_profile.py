# SPDX-License-Identifier: Apache-2.0
"""Foreign tables become sessions by a mapping file; what does not fit is refused with file, line and column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from absolute_sessions import SIX, urdf
from irec_calibration.cli import main
from irec_calibration.errors import SessionError
from irec_calibration.session import read_session
from irec_calibration.session.foreign import import_table

PROFILE = {
    "format": "irec-import/1",
    "table": {"delimiter": ";", "decimal": ","},
    "session": {
        "name": "foreign", "kind": "absolute", "robot": {"urdf": "r.urdf", "serial": "R"}, "noise": {"tracker_m": 1e-5},
        "stations": [{"name": "T"}],
    },
    "columns": {
        "stamp": {"column": "Time", "time": "%Y%m%d%H%M%S"},
        **{f"joint_{k + 1}": {"column": f"a{k + 1}", "unit": "deg"} for k in range(6)},
        "joint_2": {"column": "a2", "unit": "deg", "sign": -1, "offset": 90},
        **{f"marker_{a}": {"column": f"t{a}", "plus": f"d{a}", "unit": "mm"} for a in "xyz"},
        "temp_ambient": {"column": "T", "unit": "degC"},
        "station": {"constant": "T"},
    },
    "missing": {"marker": [0, 0, 0], "text": ["-"]},
    "order_by": "stamp",
}  # fmt: skip
HEADER = "Time;a1;a2;a3;a4;a5;a6;tx;ty;tz;dx;dy;dz;T;remark"
ROWS = [
    "20200714163924;10,0;80,0;30;0;5;0;1000,5;20;-3;0,5;-1;0;23,5;a",
    "20200714163904;20,0;85,5;30;0;5;0;0;0;0;0;0;0;23,4;",
    "20200714163944;30,0;90,0;30;0;5;0;-;-;-;0;0;0;23,6;",
]


def write(folder: Path, rows: list[str] = ROWS, **changes: object) -> tuple[Path, Path]:
    (folder / "r.urdf").write_text(urdf(SIX))
    (folder / "p.yaml").write_text(yaml.safe_dump({**PROFILE, **changes}))
    (folder / "t.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    return folder / "p.yaml", folder / "t.csv"


def test_units_decimal_comma_sign_offset_sums_and_time_order(tmp_path):
    s = import_table(*write(tmp_path), tmp_path / "out")
    np.testing.assert_allclose(s.stamp, (0.0, 20.0, 40.0))
    np.testing.assert_allclose(np.rad2deg(s.q[:, 0]), (20, 10, 30))
    np.testing.assert_allclose(np.rad2deg(s.q[:, 1]), (4.5, 10, 0), atol=1e-12)
    np.testing.assert_allclose(s.p_marker_in_station[1], (1.001, 0.019, -0.003))
    np.testing.assert_allclose(s.temperature["ambient"], (23.4, 23.5, 23.6))
    assert any("not in that order" in n for n in s.notes)


def test_a_marker_written_as_zeros_or_as_text_was_not_seen(tmp_path):
    s = import_table(*write(tmp_path), tmp_path / "out")
    assert s.marker_seen.tolist() == [False, True, False]
    assert any("not seen in 2 of 3" in n for n in s.notes)


def test_zeros_are_a_position_where_the_profile_does_not_say_otherwise(tmp_path):
    s = import_table(*write(tmp_path, missing={"text": ["-"]}), tmp_path / "out")
    assert s.marker_seen.tolist() == [True, True, False]


def test_what_is_written_reads_back_the_same(tmp_path):
    s = import_table(*write(tmp_path), tmp_path / "out")
    again = read_session(tmp_path / "out")
    np.testing.assert_array_equal(s.q, again.q)
    np.testing.assert_array_equal(s.p_marker_in_station, again.p_marker_in_station)


def test_the_command_imports(tmp_path, capsys):
    profile, table = write(tmp_path)
    assert main(["import", "--profile", str(profile), str(table), "-o", str(tmp_path / "out"), "--name", "mine"]) == 0
    assert "3 poses, 3 rows" in capsys.readouterr().out
    assert read_session(tmp_path / "out").name == "mine"


@pytest.mark.parametrize(
    ("rows", "changes", "expected"),
    [
        (["20200714163924;x;80;30;0;5;0;1;1;1;0;0;0;23;"], {}, "t.csv:2: column 'a1': 'x' is not a number with decimal ','"),
        (["20200714163924;1"], {}, "t.csv:2: 2 fields, 15 columns are named"),
        (["yesterday;1;80;30;0;5;0;1;1;1;0;0;0;23;"], {}, "t.csv:2: column 'Time': 'yesterday' is not a time of the form"),
        (["20200714163924;;80;30;0;5;0;1;1;1;0;0;0;23;"], {}, "t.csv:2: joint_1 is empty"),
        (ROWS, {"table": {"delimiter": ","}}, "has no column 'a1'; it has Time;a1"),
        (ROWS, {"order_by": "when"}, "order_by: 'when' is not among the columns"),
        (ROWS, {"colums": {}}, "colums is not known here; write columns"),
        (ROWS, {"columns": {"joint_1": {"column": "a1", "unit": "grad"}}}, "columns.joint_1.unit is 'grad', must be one of"),
        (ROWS, {"columns": {"joint_1": {"column": "a1", "factor": 2}}}, "columns.joint_1.factor is not known here"),
        (ROWS, {"format": "irec-import/2"}, "this program reads irec-import/1"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(tmp_path, rows, changes, expected):
    with pytest.raises(SessionError) as caught:
        import_table(*write(tmp_path, rows, **changes), tmp_path / "out")
    assert expected in str(caught.value)


def test_incomplete_rows_are_left_out_where_the_profile_says_so(tmp_path):
    rows = [*ROWS, "20200714164004;;80;30;0;5;0;1;1;1;0;0;0;23;"]
    s = import_table(*write(tmp_path, rows, drop_incomplete=True), tmp_path / "out")
    assert len(s) == 3 and any("1 rows without joint angles" in n for n in s.notes)


def test_the_line_of_a_spreadsheet_that_tells_the_separator_is_named(tmp_path):
    profile, table = write(tmp_path)
    table.write_text("sep=;\n" + table.read_text())
    with pytest.raises(SessionError, match=r"t.csv:1: is a line for spreadsheets \(sep=\); leave it out, or .*skip_lines: 1"):
        import_table(profile, table, tmp_path / "s")
    again = write_profile_that_skips(tmp_path)
    assert len(import_table(again, table, tmp_path / "s")) == len(ROWS)


def write_profile_that_skips(folder):
    (folder / "skips.yaml").write_text(yaml.safe_dump({**PROFILE, "table": {**PROFILE["table"], "skip_lines": 1}}))
    return folder / "skips.yaml"


def test_a_long_field_of_a_foreign_table_is_told_by_its_beginning_and_its_length(tmp_path):
    profile, table = write(tmp_path, [ROWS[0].replace("10,0", "9" * 5000 + "x")])
    with pytest.raises(SessionError, match=r"column 'a1': '9{30}\.\.\. \(5001 characters\)' is not a number") as told:
        import_table(profile, table, tmp_path / "s")
    assert len(str(told.value)) < len(str(tmp_path)) + 200
