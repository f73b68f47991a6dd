# SPDX-License-Identifier: Apache-2.0
"""An effect of one's own: a formula with completion of variables, errors under the cursor, names that are asked about."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from nicegui import ui

from . import formula

if TYPE_CHECKING:
    from .bench_page import BenchPage


class FormulaBox:
    """Where a formula is typed; built once, so that what is typed stays while the rest of the page is drawn anew."""

    def __init__(self, page: BenchPage) -> None:
        self.page = page
        self.declared: set[str] = set()
        self._cursor = 0

    def build(self) -> None:
        """Lay it out once."""
        ui.html("<h2>An effect of your own</h2>", sanitize=False)
        self.text = (
            ui.input(placeholder="axis 3: c * tau**3")
            .classes("formula w-full")
            .props('dense aria-label="formula of an effect" autocomplete=off spellcheck=false')
            .props('data-testid="formula"')
        )
        self.text.on(
            "keyup", self._typed, js_handler="(e) => emit([e.target.value, e.target.selectionStart, e.key])", throttle=0.05
        )
        self.pointer = ui.label("").classes("pointer").props('aria-hidden="true"')
        self.message = ui.label("").classes("words").props('role="status"').props('data-testid="formula-message"')
        self._suggestions([])
        self._doubts(())
        with ui.element("div").classes("rowline"):
            self.try_button = (
                ui.button("Try the formula", on_click=self._try_formula)
                .props("dense outline no-caps")
                .props('data-testid="try-formula"')
            )
            with ui.expansion("what a formula may use").props("dense dense-toggle").classes("words"):
                self.variables = ui.label("").classes("quiet")

    def knows(self, variables: tuple[str, ...]) -> None:
        """Say which variables a formula may use here."""
        known = ", ".join(v for v in variables if not v[-1].isdigit() or v.endswith("_1"))
        self.variables.set_text(f"{known} (and the other axes); sin cos tan tanh exp log sqrt abs sign min max; pi")

    def _typed(self, event: Any) -> None:
        text, cursor, key = event.args
        self._cursor = int(cursor or 0)
        if key == "Enter":
            self._try_formula()
            return
        self._check(text)

    def _check(self, text: str) -> formula.Checked:
        view = self.page.room.view
        variables = view.variables if view is not None else ()
        self._suggestions.refresh(formula.complete(text, self._cursor, variables) if text else [])
        if not text.strip() or not formula.is_formula(text):
            self.pointer.set_text("")
            self.message.set_text(
                "Begin with 'axis 3:' (an angle about an axis), 'tool z:' or 'base x:' (a displacement)." if text else ""
            )
            self.message.classes(replace="quiet")
            self._doubts.refresh(())
            return formula.Checked("not a formula yet")
        found = formula.check(text, variables, self.declared)
        self.pointer.set_text(" " * found.at + "^" if found.error and found.at >= 0 else "")
        self.message.classes(replace="error words" if found.error else "words")
        self.message.set_text(found.error or f"identified: {', '.join(found.parameters)}")
        self._doubts.refresh(() if found.error else found.doubtful)
        return found

    @ui.refreshable_method
    def _suggestions(self, choices: list[str]) -> None:
        with ui.element("div").classes("rowline nogap").style("min-height: 1.7rem"):
            for choice in choices:
                ui.button(choice, on_click=lambda _, c=choice: self._complete(c)).props("dense flat no-caps size=sm").props(
                    'data-testid="suggestion"'
                )

    def _complete(self, choice: str) -> None:
        text = formula.completed(self.text.value or "", self._cursor, choice)
        self._cursor += len(text) - len(self.text.value or "")
        self.text.set_value(text)
        self.text.run_method("focus")
        self._check(text)

    @ui.refreshable_method
    def _doubts(self, doubtful: tuple[tuple[str, str], ...]) -> None:
        for name, meant in doubtful:
            with ui.element("div").classes("rowline"):
                ui.label(f"'{name}' is no variable here." + (f" Did you mean {meant}?" if meant else "")).classes("words error")
                if meant:
                    ui.button(f"Use {meant}", on_click=lambda _, n=name, m=meant: self._replace(n, m)).props(
                        "dense outline no-caps"
                    ).props('data-testid="use-meant"')
                ui.button("It is a parameter", on_click=lambda _, n=name: self._declare(n)).props("dense outline no-caps").props(
                    'data-testid="declare"'
                )

    def _replace(self, name: str, meant: str) -> None:
        text = re.sub(rf"\b{re.escape(name)}\b", meant, self.text.value or "")
        self.text.set_value(text)
        self._check(text)

    def _declare(self, name: str) -> None:
        self.declared.add(name)
        self._check(self.text.value or "")

    def _try_formula(self) -> None:
        text = (self.text.value or "").strip()
        found = self._check(text)
        if found.error or found.doubtful:
            self.page.say(found.error or "Say first whether these names are parameters.", bad=True)
            return
        self.page.run(self.page.attempt(text))
