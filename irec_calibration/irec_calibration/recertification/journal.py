# SPDX-License-Identifier: Apache-2.0
"""`journal.jsonl` (`irec-journal/1`): every event in the life of a robot's calibrations, one JSON line each, chained by hashes.

A line that is not ended (a power cut) does not count. A line that was changed is refused with its number.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ..errors import ModelError
from ..files.regular import TABLE_LIMIT, read_bytes
from ..files.schema import violations
from ..typing import Json

FORMAT = "irec-journal/1"
BACKUP = "restore the file from a backup"


@dataclass(frozen=True)
class Entry:
    """One event in the life of a robot's calibration.

    Attributes:
        event: `added`, `put_in_force`, `rolled_back` (a former calibration is in force again) or `checked` (nothing changed).
        calibration: number of the folder, e.g. `0003`; empty for a check without any.
        model_sha256: of its model.yaml at the time of the event.
        verdict: `pass`, `recalibrated`, `investigate: ...`, `failed: ...`, or free text.
        by: name of the operator. at: ISO date and time, UTC.
        figures: numbers for trend and certificate. files: path in the folder of the calibration -> SHA-256 (of `added` only).
        previous: SHA-256 of the line before, empty for the first.
        entry_sha256: of this entry without this key, as `digest` makes it.
    """

    event: str
    calibration: str
    model_sha256: str = ""
    verdict: str = ""
    by: str = ""
    at: str = ""
    figures: Json = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    previous: str = ""
    entry_sha256: str = ""
    format: str = FORMAT

    def digest(self) -> str:
        """SHA-256 of everything in the entry but itself: JSON with sorted keys, UTF-8."""
        content = {k: v for k, v in asdict(self).items() if k != "entry_sha256"}
        return hashlib.sha256(json.dumps(content, ensure_ascii=False, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Line:
    """A whole line: its entry, and the SHA-256 of its bytes, which the next line carries."""

    entry: Entry
    sha256: str


@dataclass(frozen=True)
class Journal:
    """Whole lines, how many bytes they take, and how many bytes follow that a power cut has left of a line."""

    lines: tuple[Line, ...]
    end: int
    torn: int


def read_journal(path: Path) -> Journal:
    """Read a journal; one that is not there has no line.

    Raises:
        ModelError: with file and line: not an entry, changed since it was written, or not the one that follows.
    """
    there = os.path.lexists(path)
    data = read_bytes(path, "journal of the calibrations", ModelError, TABLE_LIMIT) if there else b""
    out: list[Line] = []
    end = data.rfind(b"\n") + 1
    before = ""
    for number, text in enumerate(data[:end].split(b"\n")[:-1], 1):
        where = f"{path}, line {number}"
        entry = _entry(text, where)
        if entry.previous != before:
            raise ModelError(f"{where}: does not follow from the line before: the journal was changed by hand; {BACKUP}")
        if entry.entry_sha256 != entry.digest():
            raise ModelError(f"{where}: was changed by hand since it was written; {BACKUP}")
        before = hashlib.sha256(text).hexdigest()
        out.append(Line(entry, before))
    return Journal(tuple(out), end, len(data) - end)


def _entry(text: bytes, where: str) -> Entry:
    try:
        content = json.loads(text)
        wrong = [f"{'.'.join(map(str, key))} {words}".strip() for key, words in violations(FORMAT, content)]
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{where}: is not an entry ({error}); {BACKUP}") from error
    if wrong:
        raise ModelError(f"{where}: is not an entry ({wrong[0]}); {BACKUP}")
    return Entry(**content)
