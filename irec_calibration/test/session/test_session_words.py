# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the text of a table is said with what was meant."""

from __future__ import annotations

import pytest
from irec_calibration.errors import SessionError
from irec_calibration.session import read_session, write_table
from synthetic import session


@pytest.fixture
def folder(tmp_path):
    return write_table(session(2), tmp_path / "s")


def text(folder, change):
    path = folder / "samples.csv"
    data = change(path.read_text())
    path.write_bytes(data if isinstance(data, bytes) else data.encode())


def first_line(change):
    def of_text(t):
        head, rest = t.split("\n", 1)
        return f"{change(head)}\n{rest}"

    return of_text


WRONG = {
    "semicolons": (lambda t: t.replace(",", ";"), "separated by ';'"),
    "tabulators": (lambda t: t.replace(",", "\t"), "separated by tabulators"),
    "spaces": (lambda t: t.replace(",", " "), "separated by spaces"),
    "a header in capitals": (first_line(str.upper), "'POSE' is there"),
    "units in the header": (
        first_line(lambda h: h.replace("joint_1", "joint_1 [rad]")), r"'joint_1 \[rad\]' is there: write joint_1"
    ),
    "joints by another name": (first_line(lambda h: h.replace("joint_1", "A1")), "'A1' is there: write joint_1"),
    "no header": (lambda t: t.split("\n", 1)[1], "holds numbers; a header line"),
    "a comment first": (lambda t: "# made by hand\n" + t, "is a comment"),
    "the line of a spreadsheet that tells the separator": (lambda t: "sep=,\n" + t, "csv:1: .*leave out the line sep=,:"),
    "the same of another table": (lambda t: '"sep=;"\n' + t.replace(",", ";"), 'leave out the line "sep=;":'),
    "a line of units": (lambda t: t.replace("\n", "\nm" + ",m" * t.split("\n")[0].count(",") + "\n", 1), "line of units"),
    "decimal commas": (lambda t: t.replace(".", ","), "decimal marks"),
    "a comma at each end": (lambda t: t.replace("\n", ",\n").replace(",\n", "\n", 1), "comma at the end of the line"),
    "cut short": (lambda t: t[:-60], "end within the line"),
    "a spreadsheet": (lambda t: b"PK\x03\x04" + bytes(range(256)), "spreadsheet"),
    "UTF-16": (lambda t: t.encode("utf-16"), "UTF-16"),
    "another minus": (lambda t: t.replace(",-", ",\u2212"), "minus is another character"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_table_in_another_form_is_refused_in_plain_words(name, folder):
    change, words = WRONG[name]
    text(folder, change)
    with pytest.raises(SessionError, match=words):
        read_session(folder)


@pytest.mark.parametrize(
    "change",
    [lambda t: "\u200b" + t, lambda t: "\ufeff" + t, lambda t: t + "\n\n,,,\n", first_line(lambda h: h + ","), lambda t: t],
)
def test_what_nobody_sees_or_means_is_read_over(change, folder):
    def whole(t):
        t = change(t)
        columns = t.split("\n")[0].count(",") + 1
        lines = [
            line + "," * (columns - 1 - line.count(",")) if line and not line.startswith(",,") else line for line in t.split("\n")
        ]
        return "\n".join(lines)

    text(folder, whole)
    assert len(read_session(folder)) == 12


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        (15, "1e300", "no measured value.*leave it empty"), (15, "3.4028235e38", "no measured value"),
        (15, "1_000.5", "digits are not separated"), (0, "1e30", "no measured value"), (0, "3e9", "not an integer"),
    ],
)  # fmt: skip
def test_a_number_that_is_none_is_named_with_line_and_column(column, value, words, folder):
    def change(t):
        lines = t.split("\n")
        fields = lines[3].split(",")
        fields[column] = value
        lines[3] = ",".join(fields)
        return "\n".join(lines)

    text(folder, change)
    with pytest.raises(SessionError, match=f"samples.csv:4: column.*{words}"):
        read_session(folder)


LONG = "9" * 5000
BEGINNING = "9" * 30 + "... (5000 characters)"


def field(column, value):
    """Puts a value into the first row of a column."""

    def change(t):
        lines = t.split("\n")
        row = lines[1].split(",")
        row[lines[0].split(",").index(column)] = value
        return "\n".join([lines[0], ",".join(row), *lines[2:]])

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (field("joint_1", LONG), f"column 'joint_1': {BEGINNING} is not a finite number"),
        (field("joint_1", LONG + "x"), f"column 'joint_1': '{BEGINNING.replace('5000', '5001')}' is not a number"),
        (field("joint_1", "\u2212" + LONG), "as in -99999"),
        (field("joint_1", "9_" * 2500), "(5000 characters)' is not a number"),
        (field("joint_1", "0" * 4980 + "9" * 20), "(5000 characters) is no measured value"),
        (field("station", LONG), f"column 'station': '{BEGINNING}' is not declared"),
        (first_line(lambda h: h.replace("joint_1", f"joint_1 [{LONG}]")), "(5010 characters)' is there: write joint_1"),
        (first_line(lambda h: h.replace("joint_1", LONG).replace("joint_2", LONG)), f"column '{BEGINNING}' appears more"),
    ],
)  # fmt: skip
def test_a_long_field_is_told_by_its_beginning_and_its_length(change, words, folder):
    text(folder, change)
    with pytest.raises(SessionError) as told:
        read_session(folder)
    assert words in str(told.value) and len(str(told.value)) < len(str(folder)) + 400


def test_so_is_the_name_of_a_column_that_is_not_read(folder):
    text(folder, lambda t: f",{LONG}\n".join(t.split("\n", 1)).replace("\n", ",1\n").replace(f"{LONG},1", LONG))
    assert f"columns ignored: {BEGINNING}" in read_session(folder).notes
