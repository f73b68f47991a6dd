# SPDX-License-Identifier: Apache-2.0
"""The store of calibrations: append-only, whole after a power cut, one writer at a time."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest
import synthetic
from irec_calibration.errors import ModelError
from irec_calibration.identification.identify import identify
from irec_calibration.identification.provenance import model_of
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.model.file import save_model
from irec_calibration.recertification.store import Store

KILLS = 50


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished calibration, ready to be stored."""
    folder = tmp_path_factory.mktemp("calibration")
    save_model(model_of(identify(synthetic.session(12), blank_model(EIGHTEEN_DOF))), folder / "model.yaml")
    return folder


@pytest.fixture
def store(tmp_path: Path, files: Path) -> Store:
    """Two calibrations, the second in force."""
    store = Store(tmp_path, "KR-1")
    for _ in range(2):
        store.put_in_force(store.add(files, "recalibrated", "M. Muster").calibration, "M. Muster")
    return store


def in_force(store: Store) -> str:
    found = store.in_force()
    return "" if found is None else found[0].calibration


def test_every_calibration_is_kept_and_the_last_put_in_force_counts(store: Store) -> None:
    assert in_force(store) == "0002"
    assert [e.event for e in store.entries()] == ["added", "put_in_force"] * 2
    assert store.model_path("0001").is_file()
    assert Store(store.folder.parent, "KR-2").in_force() is None


def test_rolling_back_puts_the_former_calibration_in_force_and_is_recorded(store: Store) -> None:
    store.roll_back("B. Beispiel")
    assert in_force(store) == "0001"
    assert (store.entries()[-1].event, store.entries()[-1].by) == ("rolled_back", "B. Beispiel")
    store.roll_back("B. Beispiel")
    assert in_force(store) == "0002"


def test_there_is_nothing_to_roll_back_to_after_the_first(tmp_path: Path, files: Path) -> None:
    store = Store(tmp_path, "KR-1")
    store.put_in_force(store.add(files, "recalibrated", "M").calibration, "M")
    with pytest.raises(ModelError, match="nothing to go back to"):
        store.roll_back("M")


def test_a_model_that_was_changed_since_is_not_trusted(store: Store) -> None:
    path = store.model_path("0002")
    path.write_text(path.read_text() + "\n")
    with pytest.raises(ModelError, match="changed since"):
        store.in_force()
    with pytest.raises(ModelError, match="changed since"):
        store.put_in_force("0002", "M")


@pytest.mark.parametrize("what", [".", "KR-1", "KR-1/journal.jsonl", "KR-1/0002", "KR-1/0002/model.yaml"])
def test_what_everybody_can_write_is_not_trusted_with_what_comes_into_force(store: Store, tmp_path: Path, what: str) -> None:
    path = tmp_path / what
    mode = path.stat().st_mode
    path.chmod(mode | 0o002)
    with pytest.raises(ModelError, match=r"everybody on this machine can write it .* chmod o-w"):
        store.in_force()
    with pytest.raises(ModelError, match="everybody on this machine can write it"):
        store.put_in_force("0002", "M. Muster")
    path.chmod(mode)
    assert in_force(store) == "0002"


def test_an_unknown_calibration_is_refused_with_those_that_there_are(store: Store) -> None:
    with pytest.raises(ModelError, match="0001, 0002"):
        store.put_in_force("0007", "M")


def test_a_journal_that_was_edited_is_refused_with_the_line(store: Store) -> None:
    store.journal.write_text(store.journal.read_text().replace("M. Muster", "N. Niemand", 1))
    with pytest.raises(ModelError, match=r"journal.jsonl, line 1: was changed by hand"):
        store.in_force()


@pytest.mark.parametrize(
    "line",
    [
        {"event": "put_in_force", "calibration": "../../elsewhere"}, {"event": "put_in_force", "calibration": 1},
        {"event": "erased", "calibration": "0001"}, {"event": "checked", "calibration": "", "figures": {"run": "../secret"}},
        {"event": "checked", "calibration": "", "figures": [1]}, [1], 5,
    ],
)  # fmt: skip
def test_a_line_of_the_journal_that_leads_elsewhere_or_is_none_is_refused_with_its_number(tmp_path: Path, line: object) -> None:
    store = Store(tmp_path, "S")
    store.folder.mkdir(parents=True)
    store.journal.write_text(json.dumps(line) + "\n")
    with pytest.raises(ModelError, match="line 1: is not an entry"):
        store.entries()


def test_a_journal_that_never_ends_or_nests_for_ever_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path, "S")
    store.folder.mkdir(parents=True)
    store.journal.write_text(100_000 * "[" + "\n")
    with pytest.raises(ModelError, match="line 1: is not an entry"):
        store.entries()
    store.journal.unlink()
    store.journal.symlink_to("/dev/zero")
    with pytest.raises(ModelError, match="a regular file is needed"):
        store.entries()


@pytest.mark.parametrize("torn", [1, 20, 150])
def test_a_line_that_a_power_cut_has_torn_off_is_passed_over(store: Store, torn: int) -> None:
    whole = store.journal.read_bytes()
    store.roll_back("M")
    assert in_force(store) == "0001"
    longer = store.journal.read_bytes()
    store.journal.write_bytes(longer[:-torn])
    assert in_force(store) == "0002"
    store.record_check("pass", "M")
    assert store.journal.read_bytes().startswith(whole)
    assert store.entries()[-1].event == "checked"


def test_serials_that_differ_only_in_signs_have_folders_of_their_own(tmp_path: Path) -> None:
    names = ["KR/1", "KR 1", "KR:1", "../KR1", ".."]
    folders = {Store(tmp_path, name).folder for name in names}
    assert len(folders) == len(names)
    assert all(f.parent == tmp_path for f in folders)


def test_a_robot_without_a_serial_is_refused() -> None:
    with pytest.raises(ModelError, match=r"robot\.serial"):
        Store("x", "")


def add_some(folder: str, files: str, count: int) -> None:
    store = Store(folder, "KR-1")
    for _ in range(count):
        store.put_in_force(store.add(Path(files), "recalibrated", str(os.getpid())).calibration, "M")


def test_two_processes_that_write_at_once_leave_a_whole_journal(tmp_path: Path, files: Path) -> None:
    spawn = multiprocessing.get_context("spawn")
    writers = [spawn.Process(target=add_some, args=(str(tmp_path), str(files), 6)) for _ in range(2)]
    for w in writers:
        w.start()
    for w in writers:
        w.join(120)
    store = Store(tmp_path, "KR-1")
    assert sorted(e.calibration for e in store.entries() if e.event == "added") == [f"{i:04d}" for i in range(1, 13)]
    assert in_force(store)


def write_for_ever(folder: Path, files: Path, begun: Connection) -> None:
    store = Store(folder, "KR-1")
    begun.send(True)
    while True:
        store.put_in_force(store.add(files, "recalibrated", "M").calibration, "M")


def test_a_writer_killed_fifty_times_at_any_moment_leaves_a_calibration_in_force(tmp_path: Path, files: Path) -> None:
    store = Store(tmp_path, "KR-1")
    store.put_in_force(store.add(files, "recalibrated", "M").calibration, "M")
    begun = time.monotonic()
    store.put_in_force(store.add(files, "recalibrated", "M").calibration, "M")
    takes = time.monotonic() - begun
    known, in_the_middle = 4, 0
    rng = random.Random(1)
    fork = multiprocessing.get_context("fork")
    for _ in range(KILLS):
        here, there = fork.Pipe()
        writer = fork.Process(target=write_for_ever, args=(tmp_path, files, there), daemon=True)
        writer.start()
        assert here.poll(60)
        time.sleep(rng.uniform(0.0, 2.0 * takes))
        os.kill(writer.pid, signal.SIGKILL)  # type: ignore[arg-type]
        writer.join(60)
        entries = store.entries()
        assert len(entries) >= known
        known = len(entries)
        in_the_middle += entries[-1].event == "added" or bool(list(store.folder.glob(".*.part")))
        last = next(e.calibration for e in reversed(entries) if e.event == "put_in_force")
        assert in_force(store) == last
    assert in_the_middle > 0, "no kill has hit a write: the test shows nothing"
    store.put_in_force(store.add(files, "recalibrated", "M").calibration, "M")
    assert not list(store.folder.glob(".*.part"))


def test_a_journal_cut_at_any_byte_has_a_calibration_in_force_or_none_yet(store: Store) -> None:
    whole = store.journal.read_bytes()
    ends = [i + 1 for i, byte in enumerate(whole) if byte == 10]
    for cut in range(0, len(whole), max(len(whole) // KILLS, 1)):
        store.journal.write_bytes(whole[:cut])
        lines = sum(end <= cut for end in ends)
        assert in_force(store) == ("" if lines < 2 else "0001" if lines < 4 else "0002")
