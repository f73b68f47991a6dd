# SPDX-License-Identifier: Apache-2.0
"""Below the cell: how the error fell, and the samples one by one, against a variable, and with growing numbers of poses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nicegui import ui

from . import figures

if TYPE_CHECKING:
    from .bench_page import BenchPage
    from .plain import SessionView

POINTS = "(e) => emit(e?.points ? e.points.map(p => p.customdata).filter(c => typeof c === 'number') : null)"
# plotly says "selected" with no point by itself when it draws new data under an old rectangle: that is not the person
TAKEN = "(e) => { const c = e?.points?.map(p => p.customdata).filter(c => typeof c === 'number'); if (c?.length) emit(c) }"


class BottomPanel:
    """Bottom of the page."""

    def __init__(self, page: BenchPage) -> None:
        self.page = page
        self.against = ""

    def build(self) -> None:
        """Lay it out once."""
        empty = {"data": [], "layout": {}, "config": figures.CONFIG}
        with ui.element("div").classes("panel plot"):
            ui.html("<h2 style='padding: 6px 10px 0'>How the error fell: on poses left out of the fit</h2>", sanitize=False)
            self.ladder_plot = ui.plotly(empty).props('data-testid="ladder"')
            self.ladder_plot.on("plotly_click", lambda e: self._go_to(e.args), js_handler=POINTS)
        with ui.element("div").classes("panel plot"):
            with ui.tabs(on_change=lambda: self.page.redraw()).props("dense align=left no-caps inline-label") as self.tabs:
                samples = ui.tab("Samples").props('data-testid="tab-samples"')
                against = ui.tab("Residual against …").props('data-testid="tab-against"')
                growth = ui.tab("Growth of accuracy").props('data-testid="tab-growth"')
                course = ui.tab("Process course").props('data-testid="tab-course"')
            course.set_visibility(bool(self.page.room.cell))
            with ui.tab_panels(self.tabs, value=samples, animated=False).classes("grow").style("min-height: 0; background: none"):
                with ui.tab_panel(samples).classes("plot panel").style("height: 100%; border: 0"):
                    self.norms_plot = ui.plotly(empty).props('data-testid="norms"')
                    self.page.clicks(self.norms_plot)
                    self.norms_plot.on("plotly_selected", lambda e: self.page.brush(e.args), js_handler=TAKEN)
                    self.norms_plot.on("plotly_deselect", lambda _: self.page.brush(None), js_handler="() => emit(null)")
                with ui.tab_panel(against).classes("plot panel").style("height: 100%; border: 0"):
                    self.against_select = ui.select([], label="against", on_change=self._set_against).props("dense options-dense")
                    self.against_select.style("width: 12rem; margin-left: 10px").props('data-testid="against"')
                    self.against_plot = ui.plotly(empty).props('data-testid="against-plot"')
                    self.page.clicks(self.against_plot)
                with ui.tab_panel(growth).classes("plot panel").style("height: 100%; border: 0"):
                    with ui.element("div").classes("rowline").style("padding: 2px 10px"):
                        ui.button(
                            "Compute for the first version and the one in use",
                            on_click=lambda: self.page.run(self.page.room.grow()),
                        ).props("dense outline no-caps").props('data-testid="grow"')
                    self.growth_plot = ui.plotly(empty).props('data-testid="growth"')
                with ui.tab_panel(course).classes("plot panel").style("height: 100%; border: 0"):
                    self.course_text = ui.label("").classes("words").style("padding: 2px 10px").props('data-testid="course-text"')
                    self.course_plot = ui.plotly(empty).props('data-testid="course"')

    def redraw(self, view: SessionView) -> None:
        """Draw those figures anew that show something else."""
        page, room = self.page, self.page.room
        version, look, due = room.current, page.look, page.redrawn.due
        variables = list(view.columns)
        if self.against_select.options != variables:
            torque = next((c for c in variables if c.startswith("tau")), variables[0] if variables else "")
            self.against = self.against if self.against in variables else torque
            self.against_select.set_options(variables, value=self.against or None)
        if due("ladder", *room.versions.all, room.versions.index, room.tried, room.group, look):
            self.ladder_plot.update_figure(figures.ladder(room.versions.all, room.versions.index, room.tried, look, room.group))
        if due("norms", view, version, room.residual, room.ghost, room.group, look):
            self.norms_plot.update_figure(figures.norms(view, version, room.residual, room.ghost, room.group, look))
        if self.against and due("against", view, version, room.residual, room.group, self.against, look):
            self.against_plot.update_figure(figures.against(view, version, room.residual, self.against, room.group, look))
        if due("growth", room.codecs, look):
            self.growth_plot.update_figure(figures.growth(room.codecs, look))
        if due("course", room.course, look):
            self.course_text.set_text(room.course.text if room.course else "")
            self.course_plot.update_figure(figures.course(room.course, look))
        if room.cell and due("drive", version):
            self.page.run(room.drive(), quiet=True)

    def _go_to(self, points: Any) -> None:
        if points and isinstance(points[0], int):
            self.page.go_to(points[0])

    def _set_against(self, event: Any) -> None:
        self.against = event.value or ""
        self.page.redraw()
