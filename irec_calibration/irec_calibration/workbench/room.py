# SPDX-License-Identifier: Apache-2.0
"""One person's work on one session: versions, what is being tried, the diagnosis, what is selected. No page in it.

Two workers: one answers at once, the other runs what takes long (diagnosis, growth of accuracy, report).
"""

from __future__ import annotations

import asyncio
import hashlib
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Cancelled, IrecError
from ..files import parse_yaml, read_text
from ..files.yaml_text import YamlProblem
from ..typing import Array, BoolArray, IntArray
from .desk import Desk, changed
from .free_names import free_folder, free_path
from .plain import Codecs, CourseView, SessionView, Tried, Version
from .versions import Past, Versions
from .worker import Stock, Worker

MOST_DIAGNOSES = 24


@dataclass
class Shared:
    """What the rooms of a server share: processes, and diagnoses of the same model on the same data."""

    stock: Stock
    diagnoses: dict[str, dict[str, Any]] = field(default_factory=dict)

    def remember(self, key: str, diagnosis: dict[str, Any]) -> None:
        """Keep a diagnosis, and forget the oldest of too many."""
        while len(self.diagnoses) >= MOST_DIAGNOSES:
            self.diagnoses.pop(next(iter(self.diagnoses)))
        self.diagnoses[key] = diagnosis


def fingerprint(session: str, model: str) -> str:
    """What a diagnosis rests on: the session's files as they are now, and a model without its history. Raises IrecError."""
    text = read_text(model, "model")
    try:
        data, _ = parse_yaml(text)
    except YamlProblem as problem:
        raise IrecError(f"{model}:{problem.line}: {problem.text}") from None
    what = {k: v for k, v in data.items() if k not in ("made", "history")} if isinstance(data, dict) else text
    return hashlib.sha256(f"{session} {changed(Path(session))} {what}".encode()).hexdigest()


class Room:
    """State of the page; every method that computes is a coroutine and raises IrecError with what a user can mend."""

    def __init__(self, session: str, folder: Path, first_model: str = "", shared: Shared | None = None) -> None:
        self.session = session
        self.folder = folder
        self.first_model = first_model
        self.shared = shared or Shared(Stock(most=0))
        self.quick, self.long = Worker(self.shared.stock), Worker(self.shared.stock)
        self.versions = Versions(session, folder)
        self.view: SessionView | None = None
        self.tried: Tried | None = None
        self.diagnosis: dict[str, Any] | None = None
        self.diagnosed = ""  # model file that the diagnosis is of
        self.codecs: Codecs | None = None
        self.cell = ""  # cell file, where its course is
        self.course: CourseView | None = None
        self.driven = ""  # model file that the course was predicted with
        self.surface: tuple[Array, IntArray] | None = None
        self.past: Past | None = None
        self.selected: int | None = None
        self.group: BoolArray | None = None
        self.share, self.doing = 0.0, ""
        self.revision = 0
        self.viewers = 0
        self._attempt = 0
        self._tasks: set[asyncio.Task[Any]] = set()

    @property
    def current(self) -> Version:
        return self.versions.current

    @property
    def residual(self) -> Array:
        """Residual on the screen: of what is being tried, else of the version in use, (m, 3), m."""
        return self.tried.residual if self.tried is not None else self.current.residual

    @property
    def ghost(self) -> Array | None:
        """Residual before, where something is being tried."""
        return self.current.residual if self.tried is not None else None

    async def open(self, past: Past | None = None) -> None:
        """Read the session and fit the first version, or take up earlier work."""
        self.view = await self.quick.call(Desk.view, self.session, progress=self._progress)
        if past is not None:
            kept = [await self._described(model, name) for name, model in past.versions]
            self.versions.replace_all(kept, past.current)
        else:
            self.versions.keep(
                await self.quick.call(Desk.start, self.session, self.first_model, str(self.folder), progress=self._progress)
            )
        self._notify()

    async def attempt(self, text: str) -> None:
        """Try an effect or a formula: a quick answer first, then the exact one; `keep` needs the exact one."""
        self._attempt += 1
        mine = self._attempt
        model = self.current.model
        self.doing = f"trying {text}"
        quick = await self.quick.call(Desk.quick, self.session, model, text)
        if mine != self._attempt:
            return
        self.tried = quick
        self._notify()
        exact = await self.quick.call(Desk.exact, self.session, model, text, str(self.folder), progress=self._progress)
        if mine == self._attempt and model == self.current.model:
            self.tried = exact
            self._notify()

    def keep(self) -> None:
        """Make a version of what is being tried."""
        if self.tried is None or self.tried.version is None:
            raise IrecError("nothing is being tried, or its exact fit is not ready yet")
        self.versions.keep(self.tried.version)
        self.discard()

    def discard(self) -> None:
        """Throw away what is being tried."""
        self._attempt += 1
        self.tried = None
        self._notify()

    async def switch_off(self, effect: str) -> None:
        """Take an effect out of the version in use and refit; a new version."""
        version = await self.quick.call(
            Desk.without, self.session, self.current.model, effect, str(self.folder), progress=self._progress
        )
        self.versions.keep(version)
        self.discard()

    def go_to(self, index: int) -> None:
        self.versions.go_to(index)
        self.discard()

    def undo(self) -> None:
        self.versions.undo()
        self.discard()

    def redo(self) -> None:
        self.versions.redo()
        self.discard()

    async def diagnose(self) -> None:
        """Diagnose the version in use; takes its time and can be cancelled."""
        model = self.current.model
        key = fingerprint(self.session, model)
        known = self.shared.diagnoses.get(key)
        if known is None:
            made: dict[str, Any] = await self.long.call(Desk.diagnosis, self.session, model, progress=self._progress)
            self.shared.remember(key, made)
            known = made
        self.diagnosis = known
        self.diagnosed = model
        if known["noise_floor_m"]:
            self.versions.learn_noise(float(known["noise_floor_m"]))
        self.doing = ""
        self._notify()

    async def grow(self) -> None:
        """Growth of accuracy of the first version and the one in use."""
        first, now = self.versions.all[0], self.current
        pair = [(first.name, first.model)] + ([(now.name, now.model)] if now is not first else [])
        self.codecs = await self.long.call(Desk.codec, self.session, pair, progress=self._progress)
        self.doing = ""
        self._notify()

    async def drive(self) -> None:
        """Predict the process course with the version in use, where the cell has one; says why where it can't be predicted."""
        if not self.cell or not self.versions.all:
            return
        first, now = self.versions.all[0].model, self.current.model
        try:
            course = await self.quick.call(Desk.course, self.session, self.cell, first, now)
        except Cancelled:
            return
        except IrecError as error:
            none = np.zeros(0)
            course = CourseView(str(error), none, none, none, none, float("nan"))
        if now == self.current.model:
            self.course, self.driven = course, now
            self._notify()

    async def report(self, folder: str) -> list[str]:
        """Write the report of the version in use into a new folder below `folder`; the page first."""
        target = free_folder(Path(folder), f"report-{Path(self.session).stem}")
        files = await self.long.call(Desk.report, self.session, self.current.model, str(target), progress=self._progress)
        self.doing = ""
        self._notify()
        return list(files) or [str(target)]

    def save(self, folder: str, stem: str = "model") -> Path:
        """Copy the version in use to a file that did not exist before."""
        path = free_path(Path(folder), stem, ".yaml")
        shutil.copyfile(self.current.model, path)
        return path

    def plan(self, folder: str) -> Path:
        """Write what to measure next, as the diagnosis has it, to a file that did not exist before."""
        planned = (self.diagnosis or {}).get("next_measurements") or []
        if not planned:
            raise IrecError("the diagnosis has no measurement to propose; diagnose first")
        path = free_path(Path(folder), "next-measurements", ".csv")
        joints = max(len(m.get("joints", ())) for m in planned)
        lines = ["pose,load_case,separates,difference_m," + ",".join(f"joint_{k + 1}" for k in range(joints))]
        for m in planned:
            values = [str(m["pose"] or "new"), str(m["load_case"]), " / ".join(m["separates"]), f"{m['difference_m']:.3e}"]
            lines.append(",".join(values + [f"{q:.6f}" for q in m.get("joints", ())]))
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    async def grown(self) -> bool:
        """Read the session again where its file has grown, and fit the version in use to it; whether it had.

        False where it was not read yet: `open` comes first.
        """
        if self.view is None:
            return False
        view = await self.quick.call(Desk.view, self.session)
        if len(view.pose) == len(self.view.pose):
            return False
        at = self.versions.index
        kept = [await self._described(v.model, v.name) for v in self.versions.all]
        self.view, self.tried, self.selected, self.group = view, None, None, None
        self.versions.replace_all(kept, at)
        self._notify()
        return True

    def select(self, sample: int | None) -> None:
        """Select one observed sample by its index."""
        self.selected = sample if sample is not None and 0 <= sample < len(self.current.rows) else None
        self._notify()

    def step(self, by: int) -> None:
        """Select the next or the previous sample."""
        n = len(self.current.rows)
        self.select(((self.selected if self.selected is not None else -1 if by > 0 else 0) + by) % n)

    def brush(self, samples: list[int] | None) -> None:
        """Let the views answer for a group of samples; all where None or empty."""
        if not samples:
            self.group = None
        else:
            self.group = np.zeros(len(self.current.rows), dtype=bool)
            self.group[[s for s in samples if 0 <= s < len(self.group)]] = True
        self._notify()

    def cancel(self) -> None:
        """Stop whatever runs."""
        self._attempt += 1
        self.quick.cancel()
        self.long.cancel()

    def rest(self) -> None:
        """Nobody looks: give processes back that do nothing."""
        self.quick.rest()
        self.long.rest()

    def close(self) -> None:
        """End the workers."""
        for task in self._tasks:
            task.cancel()
        self.quick.close()
        self.long.close()

    async def _described(self, model: str, name: str) -> Version:
        version: Version = await self.quick.call(Desk.describe, self.session, model, name, progress=self._progress)
        return version

    def _progress(self, share: float, what: str) -> None:
        self.share, self.doing = share, what

    def _notify(self) -> None:
        self.revision += 1
