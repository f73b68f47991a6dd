# SPDX-License-Identifier: Apache-2.0
"""The cell in 3D in the middle of the page, and what one can set of it."""

from __future__ import annotations

from math import log10
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import ui

from . import figures

if TYPE_CHECKING:
    from .bench_page import BenchPage
    from .plain import SessionView


class MiddlePanel:
    """Middle of the page."""

    def __init__(self, page: BenchPage) -> None:
        self.page = page
        self.by = figures.BY_RESIDUAL
        self.magnify = 0.0
        self.numbers, self.robot = True, True

    def build(self) -> None:
        """Lay it out once."""
        with ui.element("div").classes("rowline").style("padding: 4px 8px 0"):
            ui.label("Residuals drawn").classes("quiet")
            self.slider = ui.slider(min=0.0, max=4.0, step=0.05, value=2.0, on_change=self._set_magnify)
            self.slider.style("width: 9rem").props('aria-label="magnification of residuals" dense').props('data-testid="magnify"')
            self.magnify_label = ui.label("").classes("quiet")
            ui.element("div").classes("grow")
            self.by_select = ui.select([self.by], value=self.by, label="colour", on_change=self._set_by).props(
                "dense options-dense"
            )
            self.by_select.style("min-width: 8.5rem").props('data-testid="colour"')
            ui.checkbox("pose numbers", value=True, on_change=lambda e: self._set("numbers", e.value)).props("dense size=xs")
            ui.checkbox("robot", value=True, on_change=lambda e: self._set("robot", e.value)).props("dense size=xs")
        self.plot = ui.plotly({"data": [], "layout": {}, "config": figures.CONFIG}).props('data-testid="cell-plot"')
        self.page.clicks(self.plot)

    def redraw(self, view: SessionView) -> None:
        """Draw it anew where it shows something else."""
        page, room = self.page, self.page.room
        version = room.current
        columns = [figures.BY_RESIDUAL, "residual / noise", *view.columns]
        if self.by_select.options != columns:
            self.by = self.by if self.by in columns else figures.BY_RESIDUAL
            self.by_select.set_options(columns, value=self.by)
        if not self.magnify:
            self.magnify = figures.nice_scale(view, version.residual)
            self.slider.set_value(min(4.0, max(0.0, log10(max(self.magnify, 1.0)))))
        self.magnify_label.set_text(f"{self.magnify:.0f} ×")
        first = room.versions.all[0]
        shows = (view, version, room.residual, room.ghost, room.selected, room.group, first, page.look)
        if not page.redrawn.due("cell", *shows, self.magnify, self.by, self.robot, self.numbers):
            return
        self.plot.update_figure(
            figures.cell(
                view,
                version,
                room.residual,
                magnify=self.magnify,
                by=self.by,
                ghost=room.ghost,
                selected=room.selected,
                group=room.group,
                surface=room.surface,
                robot=self.robot,
                numbers=self.numbers,
                look=page.look,
                top=float(np.linalg.norm(first.residual, axis=1).max()),
            )
        )

    def _set_by(self, event: Any) -> None:
        self.by = event.value or figures.BY_RESIDUAL
        self.page.redraw()

    def _set_magnify(self, event: Any) -> None:
        value = 10.0 ** float(event.value)
        if abs(value - self.magnify) > 0.01 * value:
            self.magnify = float(f"{value:.2g}")
            self.page.redraw()

    def _set(self, name: str, value: bool) -> None:
        setattr(self, name, value)
        self.page.redraw()
