# SPDX-License-Identifier: Apache-2.0
"""Where and which: what is being tried, the diagnosis worst first, candidates, proposals, one's own formula, the selection."""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Any

from nicegui import ui

from ..lengths import length
from ..report.addition import probability
from . import words
from .formula_box import FormulaBox
from .plain import Tried

if TYPE_CHECKING:
    from .bench_page import BenchPage

CANDIDATES, SENTENCES = 9, 7
STATUS = {
    "adequate": "The model is adequate",
    "missing_effect": "An effect is missing",
    "unexplained": "There is structure that no effect explains",
}


class RightPanel:
    """Right of the page."""

    def __init__(self, page: BenchPage) -> None:
        self.page = page

    def build(self) -> None:
        """Lay it out once: the formula stays as it is typed while the rest is drawn anew."""
        self._trial()
        # built once: a button that is drawn anew while it has the focus would miss the key that is being pressed
        with ui.element("div").classes("rowline") as self.decision:
            self.keep = ui.button("Keep", on_click=self.page.keep).props("dense unelevated no-caps").props('data-testid="keep"')
            ui.button("Throw away", on_click=self.page.discard).props("dense outline no-caps").props('data-testid="discard"')
        self.decision.set_visibility(False)
        self._selection()
        self._diagnosis()
        self.formula = FormulaBox(self.page)
        self.formula.build()

    def refresh(self) -> None:
        """Draw anew what shows something else. What is being typed stays as it is."""
        room, due = self.page.room, self.page.redrawn.due
        ready = room.view is not None and bool(room.versions.all)
        current = room.current if ready else None
        if due("trial", room.tried, room.diagnosis, current):
            self._trial.refresh()
        self.decision.set_visibility(room.tried is not None)
        self.keep.set_enabled(room.tried is not None and room.tried.exact)
        if due("selection", room.view, current, room.residual if ready else None, room.selected, room.group):
            self._selection.refresh()
        if due("diagnosis", room.diagnosis, room.diagnosed, current, room.view):
            self._diagnosis.refresh()
        if room.view is not None:
            self.formula.knows(room.view.variables)

    @ui.refreshable_method
    def _trial(self) -> None:
        tried = self.page.room.tried
        if tried is None:
            return
        self._tried(tried)

    def _tried(self, tried: Tried) -> None:
        room = self.page.room
        state = "supported" if tried.supported else "not" if "not support" in tried.sentence else "undecided"
        ui.html(f"<h2>Tried: {escape(tried.effect)}</h2>", sanitize=False)
        with ui.element("div").classes(f"verdict {state}").props('aria-live="polite"').props('data-testid="trial"'):
            ui.html(
                f"<b>{length(room.current.cv_rms_m)} → {length(tried.cv_rms_m)}</b> on held-out poses. {escape(tried.sentence)}",
                sanitize=False,
            ).classes("words")
            if not tried.exact:
                ui.label("Quick answer; the exact fit is being computed …").classes("quiet")
            values = [words.parameter(p) for p in tried.entry.parameters]
            for r in values[:8]:
                ui.label(f"{r['name']} = {r['value']} {r['se']} {r['unit']}").classes("quiet")
            rivals = self._rivals(tried.effect)
            if rivals:
                ui.label(f"It can't be told from {', '.join(rivals)} on this session.").classes("words")

    def _rivals(self, effect: str) -> list[str]:
        room = self.page.room
        if room.diagnosis is None or room.diagnosed != room.current.model:
            return []
        found = next((c for c in room.diagnosis["candidates"] if c["effect"] == effect), None)
        return list(found["confusable_with"]) if found else []

    @ui.refreshable_method
    def _diagnosis(self) -> None:
        room = self.page.room
        with ui.element("div").classes("rowline"):
            ui.html("<h2>Where the model fails, and which effect is missing</h2>", sanitize=False)
        d = room.diagnosis
        if d is None:
            ui.label("The diagnosis runs: it tries every effect of the catalogue. You can try effects meanwhile.").classes(
                "words"
            )
            self._catalogue()
            return
        v = d["verdict"]
        with ui.element("div").classes(f"verdict {v['status']}").props('data-testid="verdict"'):
            ui.html(f"<b>{STATUS.get(v['status'], v['status'])}.</b> {escape(v['text'])}", sanitize=False).classes("words")
        if room.diagnosed != room.current.model:
            ui.label("This is the diagnosis of another version.").classes("quiet")
        ui.button("Diagnose this version again", on_click=self.page.diagnose).props("dense flat no-caps").props(
            'data-testid="diagnose"'
        )
        sentences = [w["text"] for w in d["where"] if w.get("shows")]
        for text in sentences[:SENTENCES]:
            ui.label(f"• {text}").classes("words")
        if not sentences:
            alone = " alone: see what the verdict says" if v["status"] != "adequate" else ""
            ui.label(f"No view (load case, axis, place, time, ...) shows structure{alone}.").classes("words")
        self._candidates(d)
        self._proposals(d)
        for m in [m for m in d["next_measurements"] if m.get("repeats", 1)][:2]:
            at = f"pose {m['pose']}" if m["pose"] else "a new pose"
            ui.label(
                f"Measure next: {at}, load case {m['load_case']}: separates {' and '.join(m['separates'])}"
                f" by {length(m['difference_m'])}."
            ).classes("words")
        for line in words.noise_lines(room.current, room.view.claimed_noise if room.view else {}, d.get("noise")):
            ui.label(line).classes("quiet")
        self._catalogue()

    def _candidates(self, d: dict[str, Any]) -> None:
        shown = [c for c in d["candidates"] if isinstance(c["cv_rms_m"], float)][:CANDIDATES]
        if not shown:
            return
        ui.html("<h2>Candidates, with the error that each promises</h2>", sanitize=False)
        base = d["model"]["cv_rms_m"] or math.nan
        floor = d["noise_floor_m"] or 0.0
        named = set(d["verdict"]["effects"])
        top = max([base, *(c["cv_rms_m"] for c in shown)])
        first = [c for c in shown if c["effect"] in named or (c["p_value"] or 0.0) < 0.01] or shown[:2]
        for c in first:
            self._candidate(c, base, floor, top, c["effect"] in named)
        rest = [c for c in shown if c not in first]
        if rest:
            with ui.expansion(f"{len(rest)} more that promise little").props("dense dense-toggle").classes("words w-full"):
                for c in rest:
                    self._candidate(c, base, floor, top, False)
        ui.label(
            "Bars: a trial of each effect, error on held-out poses in the linear problem about the model; the mark is the noise."
            " Order and name: by evidence, which also weighs in how many ways an effect was tried."
        ).classes("quiet")

    def _candidate(self, c: dict[str, Any], base: float, floor: float, top: float, named: bool) -> None:
        effect, rms = c["effect"], c["cv_rms_m"]
        with ui.element("div").classes("effect"):
            with ui.element("div").classes("rowline nogap"):
                name = effect + (f" ({', '.join(c['groups'][:3])})" if c["groups"] else "")
                ui.html(f"<b>{escape(name)}</b> {'← named' if named else ''}", sanitize=False).classes("words")
                ui.element("div").classes("grow")
                button = ui.button("Try", on_click=lambda: self._try(effect)).props("dense outline no-caps")
                button.props(f'aria-label="try {effect}" data-testid="try-{effect}"')
            bar = f"<div style='width:{100 * rms / top:.1f}%'></div><i style='left:{100 * floor / top:.1f}%'></i>"
            ui.html(f"<div class=bar>{bar}</div>", sanitize=False).classes("w-full")
            rivals = f"; can't be told from {', '.join(c['confusable_with'])}" if c["confusable_with"] else ""
            odd = "" if c["plausible"] else "; value implausible"
            ui.label(f"{words.candidate(c, base)}{rivals}{odd}").classes("quiet")

    def _proposals(self, d: dict[str, Any]) -> None:
        proposals = d.get("proposals") or []
        if not proposals:
            return
        ui.html("<h2>Proposed formulas for what has no name</h2>", sanitize=False)
        for p in proposals[:3]:
            with ui.element("div").classes("rowline effect"):
                rms = p.get("cv_rms_m")
                ui.label(f"{p['formula']}" + (f": {length(rms)}" if isinstance(rms, float) else "")).classes("words grow")
                ui.button("Try", on_click=lambda _, f=p["formula"]: self.page.run(self.page.attempt(f))).props(
                    "dense outline no-caps"
                )

    def _catalogue(self) -> None:
        room = self.page.room
        if room.view is None or not room.versions.all:
            return
        present = {e.id for e in room.current.effects}
        options = {i: f"{i}: {label}" for i, label in room.view.effects.items() if i not in present}
        with ui.element("div").classes("rowline"):
            choice = (
                ui.select(options, label="any effect of the catalogue", with_input=True)
                .props("dense options-dense")
                .classes("grow")
            )
            choice.props('data-testid="catalogue"')
            ui.button("Try", on_click=lambda: self._try(choice.value)).props(
                'dense outline no-caps aria-label="try the chosen effect"'
            ).props('data-testid="try-catalogue"')

    def _try(self, effect: str | None) -> None:
        if effect:
            self.page.run(self.page.attempt(effect))

    @ui.refreshable_method
    def _selection(self) -> None:
        room = self.page.room
        if room.view is None or not room.versions.all:
            return
        if room.group is not None:
            ui.html("<h2>The group</h2>", sanitize=False)
            with ui.element("div").props('data-testid="group"'):
                for line in words.group(room.view, room.current, room.residual, room.group):
                    ui.label(line).classes("words")
            ui.button("All samples again", on_click=lambda: self.page.brush(None)).props("dense flat no-caps").props(
                'data-testid="all-samples"'
            )
        if room.selected is None:
            if room.group is None:
                ui.label("Click a sample in the cell or below, or press ]. Drag over the samples below to take a group.").classes(
                    "quiet"
                )
            return
        ui.html("<h2>The sample</h2>", sanitize=False)
        rows = "".join(
            f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>"
            for k, v in words.sample(room.view, room.current, room.residual, room.selected)
        )
        with ui.element("div").props('data-testid="sample"').classes("w-full"):
            ui.html(f"<table class=facts>{rows}</table>", sanitize=False)


__all__ = ["RightPanel", "probability"]
