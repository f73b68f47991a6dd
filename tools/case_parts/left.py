# SPDX-License-Identifier: Apache-2.0
"""What is left on the last row of the ladder, and of what: causes taken away one after the other, nothing learnt anew."""

from __future__ import annotations

from dataclasses import dataclass, replace

from irec_calibration.report.page import Section, Table

from .jobs import Case, Job, load
from .table import Figures, figures

FORCE = "unsteady process force"


@dataclass(frozen=True)
class Left:
    """Figures of the last row, mm: as measured, as it truly is, and truly with a process force that holds no surprise."""

    measured: Figures
    true: Figures
    steady: Figures

    @property
    def parts(self) -> dict[str, tuple[float, float]]:
        """What goes with each cause of mean and maximum, mm."""
        rows = {
            "the tracker's own noise": (self.measured, self.true),
            "the unsteady part of the process force": (self.true, self.steady),
        }
        parts = {name: (a.mean - b.mean, a.max - b.max) for name, (a, b) in rows.items()}
        return {**parts, "the rest: model, touch-down and lift-off, sensor": (self.steady.mean, self.steady.max)}


def steady_job(last: Job) -> Job:
    """The last row without what no filter can foresee."""
    return replace(last, name="ladder_steady", off=(FORCE,))


def what_is_left(case: Case, last: Job, tolerance: float) -> Left:
    """From the drives of both."""
    drive, steady = (load(case, job)[0] for job in (last, steady_job(last)))
    true, calm = (replace(d, measured=d.deviation) for d in (drive, steady))
    return Left(figures(drive, tolerance), figures(true, tolerance), figures(calm, tolerance))


def section(left: Left, before: Figures) -> Section:
    """Table of the parts."""
    rows: list[list[object]] = [
        [name, f"{1e3 * a:.1f}", f"{1e3 * b:.1f}", f"{100 * a / before.mean:.1f} %", f"{100 * b / before.max:.1f} %"]
        for name, (a, b) in left.parts.items()
    ]
    header = ["", "mean [um]", "maximum [um]", "of the mean without correction", "of the maximum"]
    text = [
        "The last row of the ladder once more: freed of the noise of the tracker that judges it, then driven without the part of "
        "the process force that differs from course to course, with the same model, profile and filter. What goes is what each "
        "costs. The unsteady force is read some 40 ms before an offset can answer it, and no filter foresees all of it."
    ]
    return Section("What is left, and of what", text, tables=[Table(header, rows)])
