# SPDX-License-Identifier: Apache-2.0
"""Open: name or drop a folder or a recording, see what it holds and lacks, then go to work on it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

from ..errors import IrecError
from .app import Settings
from .desk import Desk
from .versions import Past
from .worker import Stock, Worker

LARGEST_UPLOAD = 2_000_000_000  # bytes
MARKS = {"ok": "✓", "note": "•", "lost": "✗", "bad": "✗"}
WORDS = {"ok": "present", "note": "note", "lost": "lost", "bad": "wrong"}


class OpenPage:
    """The first view where no session was named."""

    def __init__(self, settings: Settings, enter: Callable[..., str], past: list[Past], stock: Stock) -> None:
        self.settings = settings
        self.enter = enter
        self.past = past
        self.stock = stock
        self._dropped: Path | None = None

    def build(self) -> None:
        """Lay the page out."""
        ui.dark_mode(None)
        with ui.element("main").style("max-width: 46rem; margin: 2rem auto; width: 100%; padding: 0 1rem"):
            with ui.element("section").classes("panel wb").style("display: block; height: auto"):
                ui.html("<h1>Open a session</h1>", sanitize=False)
                ui.label("A folder with session.yaml and samples.csv, an MCAP file, or a rosbag2 folder.").classes("words")
                if self.settings.local:
                    with ui.element("div").classes("rowline"):
                        self.path = ui.input("path on this machine").classes("grow").props("dense").props('data-testid="path"')
                        self.path.on("keydown.enter", lambda: self._look(self.path.value or ""))
                        ui.button("Look at it", on_click=lambda: self._look(self.path.value or "")).props(
                            "no-caps outline"
                        ).props('data-testid="look"')
                ui.upload(
                    label="or drop its files here",
                    multiple=True,
                    auto_upload=True,
                    max_total_size=LARGEST_UPLOAD,
                    on_multi_upload=self._received,
                    on_rejected=lambda: self._show([("bad", "too large to be dropped; name its path")], ""),
                ).classes("w-full").props('data-testid="drop"')
                self._list([], "")
            if self.past:
                with ui.element("section").classes("panel wb").style("display: block; height: auto; margin-top: 1rem"):
                    ui.html("<h2>Go on where you stopped</h2>", sanitize=False)
                    for past in self.past:
                        when = time.strftime("%d %b %H:%M", time.localtime(past.when))
                        last = past.versions[past.current][0]
                        text = f"{Path(past.session).name}: {len(past.versions)} versions, last {last} ({when})"
                        ui.button(text, on_click=lambda _, p=past: self._resume(p)).props(
                            "flat no-caps dense align=left"
                        ).classes("w-full").props('data-testid="resume"')

    def _look(self, path: str) -> None:
        if path.strip():
            background_tasks.create(self._inspect(path.strip()))

    async def _inspect(self, path: str) -> None:
        self._show([("note", f"looking at {path} …")], "")
        worker = Worker(self.stock)
        try:
            found: list[tuple[str, str]] = await worker.call(Desk.inspect, path)
        except IrecError as error:
            found = [("bad", str(error))]
        finally:
            worker.rest()
            worker.close()
        self._show(found, "" if any(kind == "bad" for kind, _ in found) else path)

    async def _received(self, event: Any) -> None:
        folder = Path(tempfile.mkdtemp(prefix="irec-dropped-"))
        for file in event.files:
            await file.save(folder / Path(file.name).name)
        names = sorted(p.name for p in folder.iterdir())
        single = [n for n in names if n.endswith(".mcap")]
        await self._inspect(str(folder / single[0] if len(single) == 1 and "metadata.yaml" not in names else folder))

    def _show(self, items: list[tuple[str, str]], ready: str) -> None:
        self._list.refresh(items, ready)

    @ui.refreshable_method
    def _list(self, items: list[tuple[str, str]], ready: str) -> None:
        with (
            ui.element("ul")
            .style("list-style: none; padding: 0; margin: .6rem 0")
            .props('data-testid="checklist"')
            .props('aria-live="polite"')
        ):
            for kind, text in items:
                with ui.element("li").classes("error" if kind in ("lost", "bad") else "words"):
                    ui.label(f"{MARKS[kind]} {text}").classes("words").props(f'title="{WORDS[kind]}"')
        if ready:
            ui.button("Open it", on_click=lambda: self._open(ready)).props("no-caps unelevated").props('data-testid="open"')

    def _open(self, path: str) -> None:
        ui.navigate.to(f"/bench/{self.enter(path)}")

    def _resume(self, past: Past) -> None:
        ui.navigate.to(f"/bench/{self.enter(past.session, '', past)}")
