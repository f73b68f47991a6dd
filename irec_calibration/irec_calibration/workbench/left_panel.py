# SPDX-License-Identifier: Apache-2.0
"""The model: effects with switches and values, what is known only in combination, undo and redo, versions."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any

from nicegui import ui

from ..lengths import length
from . import words
from .plain import EffectEntry

if TYPE_CHECKING:
    from .bench_page import BenchPage

SHOWN = 24  # parameters of one effect before the rest is folded away


class LeftPanel:
    """Left of the page."""

    def __init__(self, page: BenchPage) -> None:
        self.page = page

    def build(self) -> None:
        """Lay it out once."""
        # built once: a button that is drawn anew while its key is being pressed does not hear it
        with ui.element("div").classes("rowline"):
            self.title = ui.html("", sanitize=False)
            ui.element("div").classes("grow")
            self.undo = ui.button("Undo", on_click=self._undo).props("dense flat no-caps").props('data-testid="undo"')
            self.redo = ui.button("Redo", on_click=self._redo).props("dense flat no-caps").props('data-testid="redo"')
        self.errors = ui.label("The model is being fitted …").classes("words")
        self._set_steps()
        self._effects()
        self._versions()

    def refresh(self) -> None:
        """Draw anew from the room what shows something else."""
        due, v = self.page.redrawn.due, self.page.room.versions
        if not v.all:
            return
        now = v.current
        self.title.set_content(f"<h2>Model, version {v.index + 1}</h2>")
        self.errors.set_text(
            f"held-out error {length(now.cv_rms_m)} ± {length(now.cv_rms_se_m)}, fit {length(now.fit_rms_m)}, "
            f"noise {length(now.noise_m)}"
        )
        self._set_steps()
        if due("effects", now.effects, now.combinations, *(other.effects for other in v.all)):
            self._effects.refresh()
        if due("versions", v.index, *(text for other in v.all for text in (other.name, other.cv_rms_m))):
            self._versions.refresh()

    def _set_steps(self) -> None:
        versions = self.page.room.versions
        self.undo.set_enabled(versions.can_undo)
        self.redo.set_enabled(versions.can_redo)

    def _undo(self) -> None:
        self.page.undo()
        if not self.page.room.versions.can_undo:
            self.page.focus("redo")

    def _redo(self) -> None:
        self.page.redo()
        if not self.page.room.versions.can_redo:
            self.page.focus("undo")

    @ui.refreshable_method
    def _effects(self) -> None:
        room = self.page.room
        if not room.versions.all:
            return
        v = room.current
        for effect in v.effects:
            self._effect(effect, on=True)
        present = {e.id for e in v.effects}
        gone: dict[str, EffectEntry] = {}
        for other in room.versions.all:
            gone |= {e.id: e for e in other.effects if e.id not in present}
        for effect in gone.values():
            self._effect(effect, on=False)
        if v.combinations:
            with (
                ui.expansion(f"Known only in combination ({len(v.combinations)})")
                .props("dense dense-toggle")
                .classes("words w-full")
            ):
                for text in v.combinations:
                    ui.label(text).classes("quiet")

    @ui.refreshable_method
    def _versions(self) -> None:
        room = self.page.room
        if not room.versions.all:
            return
        ui.html("<h2>Versions</h2>", sanitize=False)
        for i, version in enumerate(room.versions.all):
            text = f"{i + 1}. {version.name}: {length(version.cv_rms_m)}"
            button = ui.button(text, on_click=lambda _, i=i: self.page.go_to(i)).props("dense no-caps align=left")
            button.props("flat" if i != room.versions.index else "unelevated").classes("w-full").props(
                f'data-testid="version-{i + 1}"'
            )
            if i == room.versions.index:
                button.props('aria-current="true"')

    def _effect(self, effect: EffectEntry, on: bool) -> None:
        with ui.element("div").classes("effect"):
            with ui.element("div").classes("rowline nogap"):
                switch = ui.switch(effect.id, value=on, on_change=lambda e: self._switched(effect, bool(e.value)))
                switch.props("dense").props(f'data-testid="switch-{effect.id}"')
                with switch:
                    ui.tooltip(effect.formula or effect.physics).style("max-width: 30rem; font-size: .8rem")
            if not on:
                return
            if effect.formula:
                ui.label(effect.formula).classes("quiet")
            rows = [words.parameter(p) for p in effect.parameters]
            first, rest = rows[:SHOWN], rows[SHOWN:]
            if len(rows) <= 8:
                ui.html(_table(rows), sanitize=False).classes("w-full")
                return
            with ui.expansion(f"{len(rows)} parameters").props("dense dense-toggle").classes("words w-full"):
                ui.html(_table(first), sanitize=False).classes("w-full")
                if rest:
                    ui.label(f"and {len(rest)} more, in the saved model").classes("quiet")

    def _switched(self, effect: EffectEntry, on: bool) -> None:
        if on:
            self.page.run(self.page.attempt(effect.formula and f"{effect.id} = {effect.formula}" or effect.id))
        else:
            self.page.run(self.page.room.switch_off(effect.id))


def _table(rows: list[dict[str, Any]]) -> str:
    cells = []
    for r in rows:
        note = f"<br><span class=quiet>{escape(r['known'])}</span>" if r["known"] else ""
        cells.append(
            f"<tr title='bounds {escape(r['bounds'])} {escape(r['unit'])}'><td>{escape(r['name'])}{note}</td>"
            f"<td class=n>{escape(r['value'])}<br><span class=quiet>{escape(r['se'])}</span></td>"
            f"<td class=quiet>{escape(r['unit'])}<br>{escape(r['bounds'])}</td></tr>"
        )
    return f"<table class=facts>{''.join(cells)}</table>"
