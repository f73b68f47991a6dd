# SPDX-License-Identifier: Apache-2.0
"""Files are read as data: bounded, without surprises, with everything that is wrong said at once and in its place."""

from __future__ import annotations

import os
import socket
import tracemalloc
from pathlib import Path

import pytest
from irec_calibration.errors import CellError, IrecError, RobotError
from irec_calibration.files import parse_yaml, read_bytes, read_document
from irec_calibration.files.schema import format_names, schema_of
from irec_calibration.files.yaml_text import YamlProblem
from irec_calibration.robot import Robot

BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 10)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def test_numbers_without_a_point_are_numbers_and_dates_and_clock_times_are_text():
    data, _ = parse_yaml("a: 7e-6\nb: 2024-03-01\nc: 1:30\nd: 0x1f\ne: yes\nf: .5\ng: 'on'\n3: x\n")
    assert data == {"a": 7e-6, "b": "2024-03-01", "c": "1:30", "d": "0x1f", "e": "yes", "f": 0.5, "g": "on", 3: "x"}


def test_each_value_knows_its_line():
    _, lines = parse_yaml("a: 1\nb:\n  - x\n  - {c: 2,\n     d: 3}\n")
    assert lines[("b", 1, "d")] == 5
    assert lines[("b", 0)] == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOMB, "more than"),
        ("a: &a [*a]", "names nothing that is complete"),
        ("a: 1\na: 2", "occurs twice"),
        ("a: !!python/object/apply:os.system [ls]", "tag .* is not read"),
        ("[" * 50 + "]" * 50, "nested deeper"),
        ("[" * 100_000, "nested deeper|not YAML"),
        ("a: " + "9" * 5000, "characters"),
        ("a: 1e999", "too large"),
        ("a: {b: {<<: {c: 1}}}", "merge keys"),
        ("? [a]\n: 1", "can't be a key"),
        ("a: 1\n---\nb: 2", "second document"),
        ("a: [1", "not YAML"),
        ("a: \x00", "not YAML"),
    ],
)
def test_what_could_harm_is_refused(text, said):
    with pytest.raises(YamlProblem, match=said):
        parse_yaml(text)


def test_an_alias_stands_for_what_it_names():
    assert parse_yaml("a: &x {b: 1}\nc: *x")[0] == {"a": {"b": 1}, "c": {"b": 1}}


def test_devices_pipes_sockets_and_folders_are_no_files(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as s:
        s.bind(str(tmp_path / "socket"))
        for path in ("/dev/zero", tmp_path / "pipe", tmp_path / "socket", tmp_path):
            with pytest.raises(IrecError, match="a regular file is needed|can't read"):
                read_bytes(path, "file")


def test_a_robot_description_that_is_a_device_is_refused():
    with pytest.raises(RobotError, match="/dev/zero: the robot description is a device"):
        Robot.from_urdf("/dev/zero")


def test_a_small_file_takes_no_more_memory_than_its_size_whatever_the_limit(tmp_path):
    (tmp_path / "small").write_bytes(b"x" * 1000)
    tracemalloc.start()
    try:
        assert len(read_bytes(tmp_path / "small", "file", limit=500_000_000)) == 1000
        assert tracemalloc.get_traced_memory()[1] < 200_000
    finally:
        tracemalloc.stop()


def test_a_file_whose_size_nobody_knows_is_read_to_its_end():
    assert Path("/proc/self/status").stat().st_size == 0
    assert b"VmRSS" in read_bytes("/proc/self/status", "file")


def test_a_file_beyond_the_limit_is_not_read(tmp_path):
    (tmp_path / "long").write_bytes(b"x" * 11)
    with pytest.raises(IrecError, match="has 11 bytes, at most 10"):
        read_bytes(tmp_path / "long", "file", limit=10)


def test_everything_that_is_wrong_is_said_at_once_with_line_key_value_and_limit(tmp_path):
    path = tmp_path / "cell.yaml"
    path.write_text(
        "format: irec-cell/1\nname: c\nrobot: {urdf: r.urdf, serial: s, home: [a], arm_radius: 200}\n"
        "tool: {}\nlod_cases: {}\nstations: [{name: A, xyz: [0, 0, .nan], quat_xyzw: [0, 0, 0, 1]}]\n"
    )
    with pytest.raises(CellError) as caught:
        read_document(path, "irec-cell/1", "cell file", CellError)
    problems = "\n".join(caught.value.problems)
    assert "cell.yaml:3: robot.home[0] is 'a', must be a number" in problems
    assert "cell.yaml:3: robot.arm_radius is 200 m, must lie between 0 and 2 m" in problems
    assert "cell.yaml:5: lod_cases is not known here; write load_cases" in problems
    assert "load_cases is missing" not in problems
    assert "cell.yaml:6: stations[0].xyz[2] is not a finite number" in problems
    assert "surface is missing: The tooling" in problems
    assert "\n" not in str(caught.value)
    assert f"and {len(caught.value.problems) - 1} more" in str(caught.value)


@pytest.mark.parametrize("name", format_names())
def test_every_schema_is_a_schema_and_describes_every_key(name):
    jsonschema = pytest.importorskip("jsonschema")
    schema = schema_of(name)
    jsonschema.Draft202012Validator.check_schema(schema)
    for key, value in schema["properties"].items():
        assert value.get("description"), key
