# SPDX-License-Identifier: Apache-2.0
"""What can't be written is said in one line, and nothing that is half written is left behind."""

from __future__ import annotations

import contextlib
import errno
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from irec_calibration.cli import main
from irec_calibration.commands import effects
from irec_calibration.errors import IrecError, RecordingError
from irec_calibration.files import all_or_none, write_file
from irec_calibration.session import read_session
from irec_calibration.session.mcap_io import write_mcap
from workbench_server import write_hidden


@contextlib.contextmanager
def files_of_at_most(size):
    """The system refuses to let a file grow beyond this many bytes, as a disk does that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    table = write_hidden(folder / "table")
    assert main(["solve", str(table), "--dof", "6", "-o", str(folder / "model.yaml")]) == 0
    return folder


def test_what_was_there_stays_whole_where_the_new_content_does_not_fit(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("before")
    with files_of_at_most(100), pytest.raises(IrecError, match=r"p.csv: can't be written: File too large"):
        write_file(path, b"x" * 1000)
    assert list(tmp_path.iterdir()) == [path] and path.read_text() == "before"


def test_folders_that_were_made_for_it_are_gone_again(tmp_path):
    with files_of_at_most(100), pytest.raises(RecordingError, match="the table can't be written"):
        write_file(tmp_path / "a" / "b" / "p.csv", "x" * 1000, "the table", RecordingError)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("inside", ["file/p.csv", "file/a/p.csv"])
def test_a_file_is_no_folder_to_write_to(tmp_path, inside):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(IrecError, match="p.csv: can't be written: Not a directory"):
        write_file(tmp_path / inside, "x")
    assert (tmp_path / "file").read_text() == "mine"


def test_of_files_that_belong_together_all_are_left_or_none(tmp_path):
    new, there = tmp_path / "new", tmp_path / "there"
    there.mkdir()
    (there / "old.csv").write_text("before")
    with files_of_at_most(100), pytest.raises(IrecError, match="large.csv: can't be written"), all_or_none():
        write_file(new / "first.csv", "x")
        write_file(there / "second.csv", "x")
        write_file(there / "old.csv", "after")
        (there / "of_others.csv").write_text("theirs")
        write_file(new / "large.csv", "x" * 1000)
    assert not new.exists()
    assert sorted(p.name for p in there.iterdir()) == ["of_others.csv", "old.csv"]
    with all_or_none():
        write_file(new / "first.csv", "x")
    assert (new / "first.csv").read_text() == "x"


def test_a_folder_in_which_others_have_put_something_stays(tmp_path):
    with pytest.raises(RuntimeError), all_or_none():
        write_file(tmp_path / "new" / "mine.csv", "x")
        (tmp_path / "new" / "theirs.csv").write_text("x")
        raise RuntimeError
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["theirs.csv"]


def refused(arguments, size, place, capsys):
    """The command ends with code 2 and one line, and has left nothing."""
    capsys.readouterr()
    before = sorted(place.rglob("*"))
    with files_of_at_most(size):
        assert main([str(a) for a in arguments]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith(f"irec {arguments[0]}: error: {place}") and said.endswith("can't be written: File too large")
    assert sorted(place.rglob("*")) == before
    return said


def test_a_table_of_predictions_that_does_not_fit(measured, tmp_path, capsys):
    refused(["predict", measured / "model.yaml", measured / "table", "-o", tmp_path / "p.csv"], 500, tmp_path, capsys)


def test_a_session_of_which_one_file_does_not_fit(measured, tmp_path, capsys):
    size = (measured / "table" / "samples.csv").stat().st_size - 1000  # the other two are smaller
    said = refused(["export", measured / "table", "-o", tmp_path / "e"], size, tmp_path, capsys)
    assert "e/samples.csv" in said


def test_a_recording_that_does_not_fit_is_named_and_not_its_part(measured, tmp_path, capsys):
    said = refused(["import", measured / "table", "-o", tmp_path / "s.mcap"], 2000, tmp_path, capsys)
    assert "s.mcap: can't" in said
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match=r"s.mcap: can't be written: "):
        write_mcap(read_session(measured / "table"), tmp_path / "file" / "s.mcap")


def test_a_scene_that_does_not_fit(measured, tmp_path, capsys):
    refused(["scene", measured / "table", "-o", tmp_path / "s.mcap"], 500, tmp_path, capsys)


def test_a_report_of_which_a_figure_does_not_fit(measured, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    main(["compare", str(measured / "model.yaml"), str(measured / "table"), "-o", str(tmp_path / "c")])
    sizes = {p.name: p.stat().st_size for p in (tmp_path / "c").iterdir()}
    size = max(s for n, s in sizes.items() if n.endswith(".png")) - 1
    assert size > sizes["residuals.csv"]  # the first file fits
    said = refused(["compare", measured / "model.yaml", measured / "table", "-o", tmp_path / "d"], size, tmp_path, capsys)
    assert said.split(": ")[2].endswith(".png")


def test_the_controllers_side_is_whole_or_not_there(tmp_path, capsys):
    in_the_way = tmp_path / "rsi" / "README.txt"  # the last of three
    in_the_way.mkdir(parents=True)
    assert main(["rsi-config", "--address", "192.168.1.10", "-o", str(tmp_path / "rsi")]) == 2
    assert capsys.readouterr() == ("", f"irec rsi-config: error: {in_the_way}: can't be written: Is a directory\n")
    assert list((tmp_path / "rsi").iterdir()) == [in_the_way]


def test_a_cell_file_is_not_left_without_its_robot(tmp_path, capsys):
    urdf = Path(__file__).parents[3] / "config" / "robots" / "ur10.urdf"
    arguments = ["init-cell", "-o", tmp_path / "i" / "mine.yaml", "--urdf", urdf, "--serial", "Z", "--surface", "block", "0.6",
                 "0.6", "0.2", "--surface-xyz", "0.85", "0", "0.1", "--station", "A", "0.3", "-2.5", "1.8", "--sensor-range",
                 "500", "--payload", "10"]  # fmt: skip
    refused(arguments, 1000, tmp_path, capsys)


def test_standard_output_that_is_full_is_said(tmp_path):
    command = [sys.executable, "-m", "irec_calibration.cli", "effects"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "irec effects: error: standard output can't be written: No space left on device\n"


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.ENOSPC])
def test_what_a_disk_refuses_elsewhere_is_said_in_one_line(monkeypatch, capsys, number):
    def run(args):
        raise OSError(number, "not today", "/x/y.csv")

    monkeypatch.setattr(effects, "run", run)
    assert main(["effects"]) == 2
    assert capsys.readouterr().err == "irec effects: error: /x/y.csv: can't be read or written: not today\n"


def test_a_mistake_of_the_program_is_not_taken_for_the_disks(monkeypatch):
    def run(args):
        raise FileNotFoundError(errno.ENOENT, "No such file", "/x/y.csv")

    monkeypatch.setattr(effects, "run", run)
    with pytest.raises(FileNotFoundError):
        main(["effects"])
