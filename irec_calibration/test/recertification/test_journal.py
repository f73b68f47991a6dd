# SPDX-License-Identifier: Apache-2.0
"""The journal of a robot: each line is checked, and `irec check` says what of the store is not as it was."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import synthetic
from irec_calibration.cli import main
from irec_calibration.errors import ModelError
from irec_calibration.identification.identify import identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.model.file import save_model
from irec_calibration.recertification.journal import Entry, read_journal
from irec_calibration.recertification.store import Store, calibration_folder
from irec_calibration.session import write_table


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished calibration with its session."""
    folder = tmp_path_factory.mktemp("calibration")
    session = synthetic.session(12)
    save_model(model_of(identify(session, blank_model(EIGHTEEN_DOF))), folder / "model.yaml")
    write_table(session, folder / "session")
    (folder / "diagnosis").mkdir()
    (folder / "diagnosis" / "report.html").write_text("<p>")
    return folder


@pytest.fixture
def store(tmp_path: Path, files: Path) -> Store:
    """Two calibrations, the second in force."""
    store = Store(tmp_path, "KR-1")
    for _ in range(2):
        store.put_in_force(store.add(files, "recalibrated", "M. Muster", {"error_m": float("nan")}).calibration, "M. Muster")
    return store


def rewritten(journal: Path, line: int, **changed: object) -> None:
    """Change keys of one line."""
    lines = journal.read_text().splitlines()
    lines[line] = json.dumps(json.loads(lines[line]) | changed)
    journal.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("line", [0, 1, 3])
def test_a_line_that_was_changed_is_refused_by_its_number_also_the_last(store: Store, line: int) -> None:
    rewritten(store.journal, line, by="N. Niemand")
    with pytest.raises(ModelError, match=rf"journal.jsonl, line {line + 1}: was changed by hand"):
        store.in_force()


@pytest.mark.parametrize("line", [0, 1, 2])
def test_a_line_that_was_taken_out_is_missed(store: Store, line: int) -> None:
    lines = store.journal.read_text().splitlines(keepends=True)
    store.journal.write_text("".join(lines[:line] + lines[line + 1 :]))
    with pytest.raises(ModelError, match=rf"line {line + 1}: does not follow"):
        store.in_force()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"calibration": "../../elsewhere"}, "calibration"),
        ({"event": "removed"}, "event"),
        ({"figures": 5}, "figures"),
        ({"format": "irec-journal/2"}, "format"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_what_is_no_entry_is_refused_by_its_key(store: Store, changed: dict[str, object], words: str) -> None:
    rewritten(store.journal, 3, **changed)
    with pytest.raises(ModelError, match=rf"line 4: is not an entry \({words}"):
        store.in_force()


def test_each_line_is_json_for_every_reader_and_says_its_format(store: Store) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    for line in store.journal.read_text().splitlines():
        assert json.loads(line, parse_constant=refuse)["format"] == "irec-journal/1"
    assert store.entries()[0].figures == {"error_m": None}


@pytest.mark.parametrize("name", ["session/samples.csv", "session/session.yaml", "model.yaml"])
def test_a_calibration_whose_session_was_changed_is_not_trusted_either(store: Store, name: str) -> None:
    path = store.folder / "0002" / name
    path.write_text(path.read_text() + "\n")
    with pytest.raises(ModelError, match=f"{name}: was changed since.*roll back"):
        store.in_force()
    assert store.calibration("0001")[0].calibration == "0001"


def test_check_passes_a_store_that_is_as_it_was(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    with open(store.journal, "a") as file:
        file.write('{"event": "ad')
    assert main(["check", str(store.journal)]) == 0
    said = capsys.readouterr().out
    assert "irec-journal/1: nothing wrong" in said and "4 events" in said and "13 bytes" in said


def test_check_says_each_file_that_is_not_as_it_was(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    (store.folder / "0001" / "model.yaml").unlink()
    (store.folder / "0002" / "diagnosis" / "report.html").write_text("<h1>")
    assert main(["check", str(store.journal)]) == 2
    first, second = capsys.readouterr().out.strip().splitlines()[:2]
    assert "0001/model.yaml: is missing" in first and "0002/diagnosis/report.html: was changed" in second


def test_check_names_the_line_of_a_journal_that_was_changed(store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    rewritten(store.journal, 2, verdict="pass")
    assert main(["check", str(store.journal)]) == 2
    assert "line 3: was changed by hand" in capsys.readouterr().out


def test_the_hashes_can_be_made_by_any_program(store: Store) -> None:
    lines = store.journal.read_bytes().splitlines()
    entry = json.loads(lines[1])
    stated = entry.pop("entry_sha256")
    assert hashlib.sha256(json.dumps(entry, sort_keys=True, ensure_ascii=False).encode()).hexdigest() == stated
    assert hashlib.sha256(lines[0]).hexdigest() == entry["previous"]
    read = read_journal(store.journal).lines[1].entry
    assert replace(read, by="else").digest() != read.digest() and Entry(**asdict(read)) == read


def test_where_calibrations_lie_does_not_depend_on_where_a_program_was_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = tmp_path / "cells" / "cell.yaml"
    found = set()
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        found |= {calibration_folder(cell), calibration_folder(cell, "calibrations")}
    assert found == {tmp_path / "cells" / "calibrations"}
    assert calibration_folder(cell, str(tmp_path / "c")) == tmp_path / "c"
