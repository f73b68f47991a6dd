# SPDX-License-Identifier: Apache-2.0
"""The page for the person at the cell, with gloves: four large buttons and what to do now."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine
from html import escape
from pathlib import Path
from typing import Any

from nicegui import background_tasks, ui

from ..cell import Cell
from ..errors import IrecError
from ..recertification.preconditions import FAILS
from ..recertification.store import Store
from .cell_logic import CONFIRM, FULL, GO_ON, GREEN, GREY, Light, calibrations, how_far, light_of, may_start

COLOURS = {"green": "#00734f", "amber": "#9a6200", "red": "#b3261e", "grey": "#596270"}
SIGNS = {"green": "✓", "amber": "!", "red": "✗", "grey": "?"}
BIG = "font-size: 1.6rem; min-height: 6rem; font-weight: 650; width: 100%"
LARGE = "font-size: 1.25rem; min-height: 4rem"


class CellPage:
    """One browser tab on the cell.

    Args:
        link: what talks to the nodes, None where ROS is not there; why: the reason.
        cell: None where no cell file was named; folder: of calibrations, as of calibration_node.
    """

    def __init__(self, link: Any, why: str, cell: Cell | None, folder: Path) -> None:
        self.link = link
        self.why = why
        self.cell = cell
        self.folder = folder
        self.certificate = ""

    def build(self) -> None:
        """Lay the page out."""
        ui.dark_mode(None)
        with ui.element("main").style("max-width: 60rem; margin: 0 auto; padding: 1rem; width: 100%"):
            name = escape(self.cell.name if self.cell else "Cell")
            ui.html(f"<h1 style='font-size: 1.4rem; font-weight: 650; line-height: 1.4'>{name}</h1>", sanitize=False)
            with ui.element("div").props('role="status" aria-live="polite" data-testid="light"').style("width: 100%"):
                self._show(self._first())
            self.told: list[str] = []
            with ui.element("div").props('data-testid="preconditions"').style("width: 100%"):
                self._show_preconditions()
            self.far = ui.label("").style("font-size: 1.2rem").props('data-testid="far"')
            self.bar = ui.linear_progress(0.0, show_value=False).props("size=24px")
            columns = "display: grid; gap: .8rem; width: 100%; margin-top: .8rem; grid-template-columns: repeat"
            with ui.element("div").style(f"{columns}(3, 1fr)") as self.during:
                self._button_of_run("Pause", "pause", lambda: self.link.pause())
                self._button_of_run("Resume", "resume", lambda: self.link.resume())
                self._button_of_run("Stop", "stop", lambda: self.link.stop())
            with ui.element("div").style(f"{columns}(2, 1fr)"):
                ready = self.link is not None
                self._large("Check", "check", lambda: self._ask("The robot will check a few poses.", check_only=True), ready)
                self._large("Recalibrate", "recalibrate", lambda: self._ask("The robot will move and press."), ready)
                self._large("Go back", "go-back", self._go_back, ready)
                self._large("Certificate", "certificate", self._download, self.cell is not None)
        ui.timer(0.5, self._tick)
        self._tick()

    def _large(self, text: str, name: str, action: Any, enabled: bool) -> None:
        button = ui.button(text, on_click=action).props(f'no-caps unelevated data-testid="{name}"').style(BIG)
        button.set_enabled(enabled)

    def _first(self) -> Light:
        if self.link is None:
            return Light(GREY, self.why, "Do this now: start this page in a shell where the cell's ROS is set up.")
        return Light(GREY, "Not checked yet.", "Do this now: press Check.")

    @ui.refreshable_method
    def _show(self, light: Light) -> None:
        colour = COLOURS[light.colour]
        frame = f"border-left: 1.2rem solid {colour}; padding: .6rem 1rem; width: 100%; margin-bottom: .6rem"
        with ui.element("div").style(frame):
            ui.label(f"{SIGNS[light.colour]} {light.word}").style(f"font-size: 1.6rem; font-weight: 650; color: {colour}")
            ui.label(light.sentence).style("font-size: 1.1rem")
            ui.label(light.now).style("font-size: 1.3rem; font-weight: 650").props('data-testid="now"')

    @ui.refreshable_method
    def _show_preconditions(self) -> None:
        if self.told:
            ui.label("Looked at before anything moves:").style("font-size: 1.1rem; font-weight: 650")
        for line in self.told:
            failed = f"; font-weight: 650; color: {COLOURS['red']}" if line.startswith(FAILS) else ""
            ui.label(line).style(f"font-size: 1.1rem{failed}")

    def _tick(self) -> None:
        told = list(self.link.preconditions) if self.link is not None else []
        if told != self.told:
            self.told = told
            self._show_preconditions.refresh()
        running = self.link is not None and self.link.running
        share, words = how_far(self.link.progress if running else None)
        self.far.set_text(words)
        self.bar.set_value(share)
        self.bar.set_visibility(running)
        self.during.set_visibility(running)

    def _ask(self, what: str, check_only: bool = False) -> None:
        """What only a person can see, and a name; then go: the robot moves."""
        with ui.dialog() as dialog, ui.card().style("min-width: min(42rem, 95vw)"):
            ui.label(what).style("font-size: 1.3rem; font-weight: 650")
            boxes = {}
            for key, text in CONFIRM.items():
                boxes[key] = ui.checkbox(text).style("font-size: 1.1rem").props(f'size=lg data-testid="tick-{key}"')
            resume = full = None
            if not check_only:
                resume = ui.checkbox(GO_ON).props('size=lg data-testid="go-on"')
                full = ui.checkbox(FULL).props('size=lg data-testid="full"')
            name = ui.input("your name").style("font-size: 1.2rem; width: 100%").props('data-testid="name"')
            missing = ui.label("").style("color: #b3261e; font-weight: 650").props('role="alert" data-testid="missing"')

            def go() -> None:
                try:
                    confirmed = may_start(name.value or "", {k: bool(b.value) for k, b in boxes.items()})
                except IrecError as error:
                    missing.set_text(str(error))
                    return
                dialog.close()
                wanted = {"check_only": check_only, "full": bool(full and full.value), "resume": bool(resume and resume.value)}
                self._run(self._measure(str(name.value), confirmed, wanted))

            with ui.row():
                ui.button("Start", on_click=go).props('no-caps unelevated data-testid="start"').style(LARGE)
                ui.button("Leave it", on_click=dialog.close).props("no-caps outline").style(LARGE)
        dialog.open()

    async def _measure(self, who: str, confirmed: list[str], wanted: dict[str, bool]) -> None:
        self._show.refresh(Light(GREY, "The run is under way.", "Do this now: stay outside the area of the robot."))
        result = await self.link.recertify(who, confirmed, **wanted)
        self.certificate = str(result.get("certificate_path") or "")
        self._show.refresh(light_of(result))

    def _button_of_run(self, text: str, name: str, ask: Callable[[], Awaitable[str]]) -> None:
        """A button for a run that is under way."""
        button = ui.button(text, on_click=lambda: self._run(self._request(ask))).style(LARGE)
        button.props(f'no-caps outline data-testid="{name}"')

    async def _request(self, ask: Callable[[], Awaitable[str]]) -> None:
        words = await ask()
        self._show.refresh(Light(GREY, words, "Do this now: stay outside the area of the robot."))

    def _go_back(self) -> None:
        past = []
        try:
            if self.cell is not None:
                store = Store(self.folder, self.cell.serial)
                entry = store.in_force_entry()
                past = calibrations(store.entries(), entry.calibration if entry else "")
        except IrecError as error:
            self._show.refresh(Light(GREY, str(error), "Do this now: call the person in charge."))
            return
        with ui.dialog() as dialog, ui.card().style("min-width: min(42rem, 95vw)"):
            title = "Go back to a calibration that was in force. The robot does not move."
            ui.label(title).style("font-size: 1.2rem; font-weight: 650")
            name = ui.input("your name").style("font-size: 1.2rem; width: 100%").props('data-testid="back-name"')
            missing = ui.label("").style("color: #b3261e; font-weight: 650").props('role="alert"')

            def choose(calibration: str) -> None:
                if not (name.value or "").strip():
                    missing.set_text("Enter your name first: somebody has to answer for it.")
                    return
                dialog.close()
                self._run(self._put_back(calibration, str(name.value)))

            choices = [(p.calibration, f"{p.calibration}: {p.at}, {p.by}", p.current) for p in past]
            for number, text, current in choices or [("", "the one that was in force before", False)]:
                button = ui.button(text + (" (in force now)" if current else ""), on_click=lambda _, n=number: choose(n))
                button.props('no-caps outline data-testid="past"').style(LARGE + "; width: 100%")
                button.set_enabled(not current)
            ui.button("Leave it", on_click=dialog.close).props("no-caps flat").style(LARGE)
        dialog.open()

    async def _put_back(self, calibration: str, who: str) -> None:
        words = await self.link.put_in_force(who, calibration)
        self._show.refresh(Light(GREEN, words, "Do this now: check one part at reduced speed."))

    def _download(self) -> None:
        """The certificate of the last run of this page, else the newest one in the store."""
        path = Path(self.certificate) if self.certificate else self._stored_certificate()
        if path is None or not path.is_file():
            self._show.refresh(Light(GREY, "There is no certificate yet.", "Do this now: press Check or Recalibrate."))
            return
        pdf = path.with_suffix(".pdf")
        ui.download(pdf if pdf.is_file() else path)

    def _stored_certificate(self) -> Path | None:
        if self.cell is None:
            return None
        try:
            return Store(self.folder, self.cell.serial).last_certificate()
        except IrecError:
            return None

    def _run(self, work: Coroutine[Any, Any, Any]) -> None:
        async def guarded() -> None:
            try:
                await work
            except IrecError as error:
                self._show.refresh(Light(GREY, str(error), "Do this now: mend what it says, then try again."))

        background_tasks.create(guarded())
