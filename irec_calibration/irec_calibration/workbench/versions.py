# SPDX-License-Identifier: Apache-2.0
"""The versions of a model that were kept, with undo and redo; remembered in a folder so that a killed server loses nothing."""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import IrecError
from .plain import Version

STATE = "versions.json"
FORMAT = "irec-workbench/1"


@dataclass(frozen=True)
class Past:
    """Work on a session that can be taken up again; versions: (name, model file)."""

    session: str
    folder: Path
    versions: tuple[tuple[str, str], ...]
    current: int
    when: float


class Versions:
    """All versions in the order in which they were made, the one in use, and the way back and forth between them."""

    def __init__(self, session: str, folder: Path) -> None:
        self.session = session
        self.folder = folder
        self.all: list[Version] = []
        self.index = -1
        self._back: list[int] = []
        self._forth: list[int] = []
        self._inferred_m: float | None = None

    @property
    def current(self) -> Version:
        return self.all[self.index]

    @property
    def can_undo(self) -> bool:
        return bool(self._back)

    @property
    def can_redo(self) -> bool:
        return bool(self._forth)

    def keep(self, version: Version) -> None:
        """Make a version the one in use."""
        self.all.append(self._scaled(version))
        self._move(len(self.all) - 1)

    def go_to(self, index: int) -> None:
        """Use an earlier (or later) version again; can be undone too."""
        if not 0 <= index < len(self.all):
            raise IrecError(f"there is no version {index + 1}; there are {len(self.all)}")
        if index != self.index:
            self._move(index)

    def undo(self) -> None:
        """Back to the version that was in use before."""
        if self._back:
            self._forth.append(self.index)
            self.index = self._back.pop()
            self._write()

    def redo(self) -> None:
        """Take an undo back."""
        if self._forth:
            self._back.append(self.index)
            self.index = self._forth.pop()
            self._write()

    def replace_all(self, versions: list[Version], index: int) -> None:
        """The same versions on a session that has grown, or those of earlier work."""
        self.all, self.index = [self._scaled(v) for v in versions], index
        self._write()

    def learn_noise(self, inferred_m: float) -> None:
        """Show the noise of a sample that the data bear out, m, instead of the one that the session claims."""
        if inferred_m != self._inferred_m:
            self._inferred_m = inferred_m
            self.all = [self._scaled(v) for v in self.all]

    def _scaled(self, version: Version) -> Version:
        if self._inferred_m is None or version.noise_m <= 0.0 or version.noise_m == self._inferred_m:
            return version
        return replace(version, sigma=self._inferred_m / version.noise_m * version.sigma, noise_m=self._inferred_m)

    def _move(self, index: int) -> None:
        if self.index >= 0:
            self._back.append(self.index)
        self._forth.clear()
        self.index = index
        self._write()

    def _write(self) -> None:
        data = {
            "format": FORMAT,
            "session": self.session,
            "current": self.index,
            "when": time.time(),
            "versions": [{"name": v.name, "model": v.model} for v in self.all],
        }
        part = self.folder / (STATE + ".part")
        part.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
        os.replace(part, self.folder / STATE)


def state_folder() -> Path:
    """Where the workbench keeps versions that nobody saved yet."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "irec" / "workbench"


def new_folder(root: Path, session: str) -> Path:
    """A folder of its own for work on a session."""
    stem = "".join(c if c.isalnum() or c in "-_." else "-" for c in Path(session).name) or "session"
    root.mkdir(parents=True, exist_ok=True, mode=0o700)
    for n in range(1, 10000):
        folder = root / f"{stem}-{time.strftime('%Y%m%d-%H%M%S')}-{n}"
        try:
            folder.mkdir(mode=0o700)
        except FileExistsError:
            continue
        return folder
    raise IrecError(f"{root}: no free folder name")


def past_work(root: Path, at_most: int = 8) -> list[Past]:
    """Earlier work with more than its first version, newest first; what can't be read is passed over."""
    found = []
    for file in root.glob(f"*/{STATE}"):
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            versions = tuple((str(v["name"]), str(v["model"])) for v in data["versions"])
            past = Past(str(data["session"]), file.parent, versions, int(data["current"]), float(data["when"]))
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            continue
        if data.get("format") == FORMAT and len(versions) > 1 and all(Path(m).is_file() for _, m in versions):
            found.append(past)
    return [replace(p) for p in sorted(found, key=lambda p: -p.when)[:at_most]]
