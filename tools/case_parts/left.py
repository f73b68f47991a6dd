# SPDX-License-Identifier: Apache-2.0
"""What is left on the last row of the ladder, and of what: causes taken away one after the other, nothing learnt anew."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from irec_calibration.report.page import Section, Table
from irec_calibration.typing import Array
from irec_sim.production.runner import Drive
from irec_sim.production.ways import PERIOD
from scipy import ndimage

from .jobs import Case, Job, load
from .table import Figures, figures

FORCE = "unsteady process force"
ENDS, FADED, SMOOTH = 1.0, 0.2, 0.016  # s at either end that are compared, of these faded, and standard deviation of smoothing


@dataclass(frozen=True)
class Left:
    """Figures of the last row, mm: as measured, as it truly is, and truly with a process force that holds no surprise."""

    measured: Figures
    true: Figures
    steady: Figures
    own: Figures  # as measured, less what the other courses leave at the same time after the begin of contact and before the end

    @property
    def parts(self) -> dict[str, tuple[float, float]]:
        """What goes with each cause of mean and maximum, mm."""
        rows = {
            "the tracker's own noise": (self.measured, self.true),
            "the unsteady part of the process force": (self.true, self.steady),
        }
        parts = {name: (a.mean - b.mean, a.max - b.max) for name, (a, b) in rows.items()}
        return {**parts, "the rest: model, begin and end of contact, sensor": (self.steady.mean, self.steady.max)}


def steady_job(last: Job) -> Job:
    """The last row without what no filter can foresee."""
    return replace(last, name="ladder_steady", off=(FORCE,))


def what_is_left(case: Case, last: Job, tolerance: float) -> Left:
    """From the drives of both."""
    drive, steady = (load(case, job)[0] for job in (last, steady_job(last)))
    true, calm = (replace(d, measured=d.deviation) for d in (drive, steady))
    own = replace(drive, measured=drive.measured - common(drive)[:, :, None] * drive.ways.counts)
    return Left(*(figures(d, tolerance) for d in (drive, true, calm, own)))


def common(drive: Drive) -> Array:
    """What the other courses leave in the mean at the same time after touch-down and before the end, (steps, courses), m."""
    error, out, n = drive.error, np.zeros(drive.error.shape), round(ENDS / PERIOD)
    parts = [np.flatnonzero(c) for c in drive.counted.T]
    fade = np.clip((n - np.arange(n)) / round(FADED / PERIOD), 0.0, 1.0)
    for i, inside in enumerate(parts):
        others = [j for j, p in enumerate(parts) if j != i and len(p) > 2 * n]
        if not others or len(inside) <= 2 * n:
            continue
        head, tail = (
            ndimage.gaussian_filter1d(np.mean([error[parts[j], j][part] for j in others], axis=0), SMOOTH / PERIOD)
            for part in (slice(0, n), slice(-n, None))
        )
        out[inside[:n], i], out[inside[-n:], i] = head * fade, tail * fade[::-1]
    return out


def section(left: Left, before: Figures) -> Section:
    """Table of the parts."""
    rows: list[list[object]] = [
        [name, f"{1e3 * a:.1f}", f"{1e3 * b:.1f}", f"{100 * a / before.mean:.1f} %", f"{100 * b / before.max:.1f} %"]
        for name, (a, b) in left.parts.items()
    ]
    header = ["", "mean [um]", "maximum [um]", "of the mean without correction", "of the maximum"]
    text = [
        "The last row of the ladder once more, in its first draw: freed of the noise of the tracker that judges it, then driven "
        "without the part of the process force that differs from course to course, with the same model, profile and filter. "
        "What goes is what each costs. The unsteady force is read some 40 ms before an offset can answer it, and no filter "
        "foresees all of it.",
        "What comes again: less what the other courses leave in the mean at the same time after the begin of contact and before "
        f"the end, mean and maximum would be {1e3 * left.own.mean:.1f} and {1e3 * left.own.max:.0f} um in place of "
        f"{1e3 * left.measured.mean:.1f} and {1e3 * left.measured.max:.0f} um. That is what an offset could gain that is learnt "
        "by place from what earlier courses have left.",
    ]
    return Section("What is left, and of what", text, tables=[Table(header, rows)])
