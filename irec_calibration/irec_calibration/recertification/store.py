# SPDX-License-Identifier: Apache-2.0
"""All calibrations of the robots of a cell, and which one is in force: append-only, hashed, locked, safe against a power cut.

    <folder>/<serial>/journal.jsonl          one line per event (irec-journal/1); each carries the SHA-256 of the line before
    <folder>/<serial>/0003/model.yaml        a calibration: never changed and never removed
    <folder>/<serial>/0003/session/          the session it was made from, as a table
    <folder>/<serial>/0003/...               certificate and diagnosis

An event is in force only when its line is whole: a line that a power cut has torn off is passed over, and the one before counts.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import hashlib
import json
import math
import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from ..errors import ModelError
from ..model import Model
from ..model.file import file_sha256, load_model
from ..typing import Json
from .journal import Entry, Journal, read_journal

JOURNAL = "journal.jsonl"
BASIS = ("model.yaml", "poses.yaml", "session/")  # what a check of the calibration rests on
CALIBRATIONS = "calibrations"  # beside the cell file, where nothing else is said


def calibration_folder(cell_file: str | Path, stated: str = "") -> Path:
    """Folder of the calibrations of a cell: the one stated, else `calibrations`; relative to the folder of the cell file.

    It doesn't depend on where a program was started, so that all programs find the same one.
    """
    return Path(cell_file).absolute().parent / (stated or CALIBRATIONS)


def changed_file(path: Path, sha256: str) -> str:
    """Says which file of a calibration is missing or was changed since it came into the store; empty: it is as it was."""
    if not path.is_file():
        return f"{path}: is missing, the calibration can't be trusted"
    return "" if file_sha256(path) == sha256 else f"{path}: was changed since it came into the store"


def refuse_what_anybody_writes(paths: Iterable[Path]) -> None:
    """Raises ModelError where one of the files or folders that are there can be written by every user of the machine.

    The hashes of a journal show what was changed by mistake; whoever can write the folder can write hashes that fit too.
    """
    for path in paths:
        try:
            mode = stat.S_IMODE(path.stat().st_mode)
        except OSError:
            continue
        if mode & stat.S_IWOTH:
            raise ModelError(
                f"{path}: everybody on this machine can write it (mode {mode:o}), so what lies there can't be trusted to come"
                f" into force; take that away: chmod o-w '{path}'"
            )


def changed_files(journal: Path) -> tuple[Journal, list[str]]:
    """A journal, and which files of its calibrations are missing or were changed. ModelError: as `read_journal`."""
    if not journal.is_file():
        raise ModelError(f"{journal}: no such file")
    read = read_journal(journal)
    added = [line.entry for line in read.lines if line.entry.event == "added"]
    found = [changed_file(journal.parent / e.calibration / name, sha) for e in added for name, sha in e.files.items()]
    return read, [f"{text}; restore it from a backup" for text in found if text]


class Store:
    """Calibrations of one robot.

    Args:
        folder: of all robots; made when something is written. serial: of the robot.
    """

    def __init__(self, folder: str | Path, serial: str) -> None:
        if not serial:
            raise ModelError("the robot has no serial number; state robot.serial in the cell file: a calibration belongs to one")
        safe = "".join(c if c.isalnum() or c in "-_." else "_" for c in serial).lstrip(".") or "_"
        if safe != serial:
            safe += "_" + hashlib.sha256(serial.encode()).hexdigest()[:8]
        self.serial = serial
        self.folder = Path(folder).absolute() / safe

    @property
    def journal(self) -> Path:
        return self.folder / JOURNAL

    def entries(self) -> list[Entry]:
        """All events, oldest first.

        Raises:
            ModelError: the journal was changed by hand: a line does not follow from the one before.
        """
        return [line.entry for line in read_journal(self.journal).lines]

    def in_force(self) -> tuple[Entry, Path, Model] | None:
        """The entry, path and model in force; None where none is.

        Raises:
            ModelError: its file is missing or was changed since, or everybody can write it.
        """
        refuse_what_anybody_writes((self.folder.parent, self.folder, self.journal))
        entry = self.in_force_entry()
        return None if entry is None else (entry, *self._checked(entry))

    def calibration(self, number: str) -> tuple[Entry, Path, Model]:
        """Entry, path and model of a stored calibration, as `in_force`. ModelError: not stored, missing or changed since."""
        entry = self._added(number)
        return (entry, *self._checked(entry))

    def in_force_entry(self) -> Entry | None:
        """The event that put the present calibration in force, whatever has become of its file; None where none is."""
        return next((e for e in reversed(self.entries()) if e.event in ("put_in_force", "rolled_back")), None)

    def _checked(self, entry: Entry) -> tuple[Path, Model]:
        path = self.model_path(entry.calibration)
        refuse_what_anybody_writes((self.folder.parent, self.folder, self.journal, path.parent, path))
        stored = self._added(entry.calibration).files
        basis = {name: sha for name, sha in stored.items() if name.startswith(BASIS)}  # a check rests on them too
        for name, sha in {path.name: entry.model_sha256, **basis}.items():
            changed = changed_file(path.parent / name, sha)
            if changed:
                raise ModelError(f"{changed}; restore it from a backup, or roll back to another calibration")
        return path, load_model(path)

    def model_path(self, calibration: str) -> Path:
        """Path of the model of a calibration."""
        return self.folder / calibration / "model.yaml"

    def session_path(self, calibration: str) -> Path | None:
        """Table of the session that a calibration was made from; None where it was not kept."""
        path = self.folder / calibration / "session"
        return path if (path / "session.yaml").is_file() else None

    def last_certificate(self) -> Path | None:
        """The newest certificate (HTML) of a run that the journal knows; None where there is none."""
        for entry in reversed(self.entries()):
            path = self.folder / "runs" / str(entry.figures.get("run", "")) / "certificate.html"
            if entry.figures.get("run") and path.is_file():
                return path
        return None

    def add(self, files: Path, verdict: str, by: str, figures: Json | None = None) -> Entry:
        """Take a finished calibration into the store without putting it in force.

        Args:
            files: folder with `model.yaml` and what belongs to it; moved in one step.

        Raises:
            ModelError: no model there, or the store can't be written.
        """
        load_model(files / "model.yaml")
        with self._locked():
            taken = [int(p.name) for p in self.folder.iterdir() if p.is_dir() and p.name.isdigit()]
            number = f"{max(taken, default=0) + 1:04d}"
            part = self.folder / f".{number}.{os.getpid()}.part"
            try:
                shutil.copytree(files, part)
                _sync_tree(part)
                part.rename(self.folder / number)
            except OSError as error:
                shutil.rmtree(part, ignore_errors=True)
                raise ModelError(f"{self.folder}: the calibration can't be stored: {error.strerror}") from error
            kept = self.folder / number
            hashes = {p.relative_to(kept).as_posix(): file_sha256(p) for p in sorted(kept.rglob("*")) if p.is_file()}
            return self._append(Entry("added", number, hashes["model.yaml"], verdict, by, figures=figures or {}, files=hashes))

    def checked_path(self, calibration: str) -> Path:
        """Model of a stored calibration, unchanged since it came into the store.

        Raises:
            ModelError: it is not in the store, or was changed since.
        """
        return self.calibration(calibration)[1]

    def _added(self, calibration: str) -> Entry:
        stored = [e for e in self.entries() if e.event == "added"]
        for entry in reversed(stored):
            if entry.calibration == calibration:
                return entry
        known = ", ".join(e.calibration for e in stored) or "none"
        raise ModelError(f"{self.folder}: there is no calibration {calibration!r}; there are: {known}")

    def of_run(self, run: str, event: str) -> Entry | None:
        """The event that a run (name of its folder) has left in the journal already; None where it has not."""
        return next((e for e in self.entries() if e.event == event and e.figures.get("run") == run), None)

    def former(self) -> str:
        """Number of the calibration that was in force before the present one. ModelError: there was none."""
        forced = [e for e in self.entries() if e.event in ("put_in_force", "rolled_back")]
        before = [e.calibration for e in forced[:-1] if e.calibration != forced[-1].calibration]
        if not before:
            raise ModelError(f"{self.folder}: no other calibration was in force before; there is nothing to go back to")
        return before[-1]

    def put_in_force(self, calibration: str, by: str, *, event: str = "put_in_force", verdict: str = "") -> Entry:
        """Put a stored calibration in force. Raises ModelError where it is not in the store, or was changed since."""
        with self._locked():
            path = self.checked_path(calibration)
            return self._append(Entry(event, calibration, file_sha256(path), verdict, by))

    def roll_back(self, by: str, calibration: str = "") -> Entry:
        """Put a former calibration in force again: the one named, or the one that was in force before the present one."""
        return self.put_in_force(calibration or self.former(), by, event="rolled_back", verdict="rolled back")

    def record_check(self, verdict: str, by: str, figures: Json | None = None) -> Entry:
        """Record a check after which nothing was changed."""
        now = self.in_force()
        with self._locked():
            number, sha = ("", "") if now is None else (now[0].calibration, now[0].model_sha256)
            return self._append(Entry("checked", number, sha, verdict, by, figures=figures or {}))

    def _append(self, entry: Entry) -> Entry:
        written = read_journal(self.journal)
        at = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        previous = written.lines[-1].sha256 if written.lines else ""
        entry = replace(entry, figures=_finite(entry.figures), at=entry.at or at, previous=previous)
        entry = replace(entry, entry_sha256=entry.digest())
        line = json.dumps(asdict(entry), ensure_ascii=False, sort_keys=True) + "\n"
        try:
            with open(self.journal, "r+b" if self.journal.exists() else "x+b") as file:
                file.truncate(written.end)  # what a power cut left of a line
                file.seek(written.end)
                file.write(line.encode())
                file.flush()
                os.fsync(file.fileno())
            sync(self.folder)
        except OSError as error:
            raise ModelError(f"{self.journal}: can't be written: {error.strerror}; what was in force stays in force") from error
        return entry

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = open(self.folder / ".lock", "w")
        except OSError as error:
            raise ModelError(f"{self.folder}: can't be written: {error.strerror}; choose another calibration folder") from error
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            for part in self.folder.glob(".*.part"):  # left by a process that was killed; nobody else writes now
                shutil.rmtree(part, ignore_errors=True)
            yield


def _finite(value: Any) -> Any:
    """JSON knows no NaN: what is not known is null."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk before going on."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _sync_tree(folder: Path) -> None:
    for path in [*folder.rglob("*"), folder]:
        sync(path)
