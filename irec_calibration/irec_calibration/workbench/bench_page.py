# SPDX-License-Identifier: Apache-2.0
"""The page of one room: model on the left, cell in the middle, where and which on the right, ladder and samples below."""

from __future__ import annotations

from collections.abc import Coroutine
from html import escape
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

from ..errors import Cancelled, IrecError
from .app import Settings
from .bottom_panel import BottomPanel
from .figures import Look
from .left_panel import LeftPanel
from .middle_panel import MiddlePanel
from .redrawn import Redrawn
from .right_panel import RightPanel
from .room import Room

FOLLOW_SECONDS = 3.0
FOCUS = (Path(__file__).parent / "focus.js").read_text(encoding="utf-8")
KEYS = "k keep · Esc throw away · Ctrl+Z undo · Ctrl+Y redo · [ and ] previous and next sample · a all samples · d diagnose"


class BenchPage:
    """One browser tab on a room."""

    def __init__(self, room: Room, settings: Settings) -> None:
        self.room = room
        self.settings = settings
        self.look = Look()
        self.redrawn = Redrawn()
        self.following = settings.follow
        self._seen = -1
        self._behind = False  # the recording has grown since growth of accuracy and diagnosis were computed

    def build(self) -> None:
        """Lay the page out and start what has to run."""
        ui.add_body_html(f"<script>{FOCUS}</script>")
        self.dark = ui.dark_mode(None)
        with ui.element("main").classes("wb"):
            with ui.element("header").classes("top panel"):
                self._header()
            with ui.element("section").classes("left panel").props('aria-label="The model"'):
                self.left = LeftPanel(self)
                self.left.build()
            with ui.element("section").classes("middle panel plot").props('aria-label="The cell"'):
                self.middle = MiddlePanel(self)
                self.middle.build()
            with ui.element("section").classes("right panel").props('aria-label="Where and which"'):
                self.right = RightPanel(self)
                self.right.build()
            with ui.element("section").classes("bottom").props('aria-label="Ladder and samples"'):
                self.bottom = BottomPanel(self)
                self.bottom.build()
        ui.keyboard(on_key=self._key, ignore=["input", "select", "textarea"])
        ui.timer(0.25, self._tick)
        ui.timer(FOLLOW_SECONDS, self._follow)
        ui.on("irec_dark", lambda e: self._set_look(bool(e.args)))
        ui.timer(0.3, self._watch_dark, once=True)
        self.room.viewers += 1
        ui.context.client.on_delete(self._left)  # not where the network drops for a moment
        if not self.room.versions.all:
            self.run(self._first())
        else:
            self.refresh()
            if self.room.diagnosis is None and not self.room.long.busy:
                self.run(self.room.diagnose())

    def _left(self) -> None:
        """The tab was closed: stop what nobody waits for any more."""
        self.room.viewers -= 1
        if self.room.viewers <= 0:
            if self.room.diagnosis is None:
                self.room.long.cancel()
            self.room.rest()

    def run(self, work: Coroutine[Any, Any, Any], then: str = "", quiet: bool = False) -> None:
        """Run a computation in the background; errors are shown, the page lives on. `quiet`: what was said last stays."""
        background_tasks.create(self._guarded(work, then, quiet))

    async def _guarded(self, work: Coroutine[Any, Any, Any], then: str, quiet: bool) -> None:
        if not quiet:
            self.say("")
        try:
            await work
            if then:
                self.say(then)
        except Cancelled:
            self.say("Cancelled.")
        except IrecError as error:
            self.say(str(error), bad=True)
        finally:
            self.room.doing = ""
        self.refresh()

    async def _first(self) -> None:
        await self.room.open(self.room.past)
        self.refresh()
        if self.room.past is None or self.room.diagnosis is None:
            await self.room.diagnose()

    def say(self, text: str, bad: bool = False) -> None:
        """One line for the person at the page."""
        self.status.set_text(text)
        self.status.classes(replace="error words" if bad else "words")

    def _header(self) -> None:
        with ui.element("div").classes("rowline"):
            self.title = ui.html("<h1>Reading the session …</h1>", sanitize=False)
            self.subtitle = ui.label("").classes("quiet clip").props('data-testid="subtitle"')
            ui.element("div").classes("grow")
            self.working = ui.label("").classes("quiet clip").props('role="status"')
            self.bar = ui.linear_progress(0.0, show_value=False).props("size=8px").style("width: 8rem")
            self.stop = ui.button("Cancel", on_click=self.room.cancel).props("dense flat no-caps").props('data-testid="cancel"')
            self.follow_switch = ui.switch("follow the recording", value=self.following, on_change=self._set_follow).props(
                'dense data-testid="follow"'
            )
            with ui.button("Save …").props("dense outline no-caps").props('data-testid="save-menu"'), ui.menu():
                ui.menu_item("Model", self._save_model).props('data-testid="save-model"')
                ui.menu_item("Report", self._save_report).props('data-testid="save-report"')
                ui.menu_item("Plan of next measurements", self._save_plan).props('data-testid="save-plan"')
            ui.button("Open another", on_click=lambda: ui.navigate.to("/open")).props("dense flat no-caps")
            ui.button(icon="contrast", on_click=self._toggle_dark).props('dense flat aria-label="light or dark"').props(
                'data-testid="dark"'
            )
            with ui.button(icon="keyboard").props('dense flat aria-label="keys"'):
                ui.tooltip(KEYS)
        self.status = ui.label("").classes("words").props('role="alert"').props('data-testid="status"')

    def clicks(self, plot: ui.plotly) -> None:
        """Let a click on a sample of a figure select it."""
        plot.on(
            "plotly_click",
            lambda e: self._select(e.args),
            js_handler="(e) => emit(e.points.map(p => p.customdata).filter(c => typeof c === 'number'))",
        )

    def refresh(self) -> None:
        """Draw everything anew from the room."""
        room = self.room
        self._seen = room.revision
        if room.view is None or not room.versions.all:
            return
        view, version = room.view, room.current
        self.title.set_content(f"<h1>{escape(view.name)}</h1>")
        self.subtitle.set_text(
            f"{view.kind}, robot {view.serial or 'without serial'}, {len(set(view.pose.tolist()))} poses,"
            f" {len(version.rows)} samples"
        )
        self.left.refresh()
        self.right.refresh()
        self.redraw()

    def redraw(self) -> None:
        """Draw the figures anew, as far as they show something else."""
        view = self.room.view
        if view is not None and self.room.versions.all:
            self.middle.redraw(view)
            self.bottom.redraw(view)

    async def attempt(self, text: str) -> None:
        """Try an effect; draws the quick answer as soon as it is there."""
        await self.room.attempt(text)

    def keep(self) -> None:
        """Keep what is tried, and diagnose the new version."""
        try:
            self.room.keep()
        except IrecError as error:
            self.say(str(error), bad=True)
            return
        n = len(self.room.versions.all)
        self.say(f"Kept as version {n}. The diagnosis of it runs.")
        self.refresh()
        self.focus(f"version-{n}")
        self.diagnose()

    def focus(self, name: str) -> None:
        """Give the focus to a control where the one that had it is gone."""
        ui.run_javascript(f"setTimeout(() => window.irecFocus('{name}'), 50)")

    def diagnose(self) -> None:
        """Diagnose the version in use."""
        self.room.long.cancel()
        self.run(self.room.diagnose())

    def discard(self) -> None:
        """Throw away what is tried."""
        self.room.discard()
        self.say("Thrown away.")
        self.refresh()
        self.focus("formula")

    def undo(self) -> None:
        """Use the version before the last step."""
        self.room.undo()
        self.refresh()

    def redo(self) -> None:
        """Take the last step again."""
        self.room.redo()
        self.refresh()

    def go_to(self, index: int) -> None:
        """Use another version."""
        self.room.go_to(index)
        self.refresh()

    def _select(self, points: Any) -> None:
        if points:
            self.room.select(int(points[0]))
            self.refresh()

    def brush(self, points: Any) -> None:
        """Let the views answer for a group of samples; for all where None."""
        chosen = None if points is None else [int(p) for p in points if isinstance(p, int)]
        self.room.brush(chosen)
        self.refresh()

    def _set_follow(self, event: Any) -> None:
        self.following = bool(event.value)

    def _save_model(self) -> None:
        self._saved(lambda: f"Model written to {self.room.save(str(self.settings.out))}.")

    def _save_plan(self) -> None:
        self._saved(lambda: f"Next measurements written to {self.room.plan(str(self.settings.out))}.")

    def _saved(self, write: Any) -> None:
        try:
            self.say(write())
        except (IrecError, OSError) as error:
            self.say(str(error), bad=True)

    def _save_report(self) -> None:
        async def write() -> None:
            files = await self.room.report(str(self.settings.out))
            self._report = files[0]

        self.run(write(), f"Report written below {self.settings.out}.")

    def _toggle_dark(self) -> None:
        self._set_look(not self.look.dark)
        self.dark.set_value(self.look.dark)

    async def _watch_dark(self) -> None:
        dark = await ui.run_javascript("document.body.classList.contains('body--dark')", timeout=10.0)
        self._set_look(bool(dark))

    def _set_look(self, dark: bool) -> None:
        if dark != self.look.dark:
            self.look = Look(dark)
            self.redraw()

    def _tick(self) -> None:
        room = self.room
        busy = room.quick.busy or room.long.busy
        self.working.set_text((f"{room.doing} …" if room.doing else "working …") if busy else "")
        self.bar.set_value(room.share if busy else 0.0)
        self.bar.set_visibility(busy)
        self.stop.set_visibility(busy)
        if room.revision != self._seen:
            self.refresh()

    async def _follow(self) -> None:
        room = self.room
        if not self.following or room.quick.busy:
            return
        if room.view is None or not room.versions.all:
            self.run(self._first())  # too little was recorded when it was opened
            return
        try:
            if await room.grown():
                self.say(f"The recording has grown: {len(room.current.rows)} samples.")
                self._behind = True
            if self._behind and not room.long.busy:
                self._behind = False
                self.run(self._follow_up())
        except IrecError as error:
            self.say(str(error), bad=True)

    async def _follow_up(self) -> None:
        """Growth of accuracy and diagnosis of what is there now."""
        await self.room.diagnose()
        await self.room.grow()

    def _key(self, event: Any) -> None:
        if not event.action.keydown or event.action.repeat and event.key.name not in ("[", "]"):
            return
        name, control = event.key.name, event.modifiers.ctrl or event.modifiers.meta
        if control and name in ("z", "y"):
            self.undo() if name == "z" else self.redo()
        elif control or event.modifiers.alt:
            return
        elif name == "k" and self.room.tried is not None:
            self.keep()
        elif name == "Escape" and self.room.tried is not None:
            self.discard()
        elif name in ("[", "]"):
            self.room.step(1 if name == "]" else -1)
            self.refresh()
        elif name == "a":
            self.brush(None)
        elif name == "d":
            self.diagnose()
