# SPDX-License-Identifier: Apache-2.0
"""The filter of each axis of the force, learnt from training courses driven with the tracker on the tool, without correction and
then with what was learnt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from irec_calibration.cell import read_cell
from irec_calibration.model import Model
from irec_calibration.typing import Array
from irec_correction.course_filter import CourseFilter, DrivenCourse, learn, spread_postures
from irec_correction.course_training import Answers, DrivenPart, driven_course
from irec_correction.deflection import Deflection
from irec_sim.production.runner import Drive
from irec_sim.production.ways import PERIOD

from .corrected import GRAVITY
from .jobs import BRISK, Case, filters_of, stages_before
from .learned import Swept, filtered

BEGIN, END = 0.8, 0.4  # s after touch-down and before lift-off that are not learnt from
POSTURES = 6  # with taps of their own


def learnt_filter(
    case: Case, model: Model, drives: Sequence[tuple[Drive, Array]], swept: Swept
) -> tuple[CourseFilter, Array]:  # fmt: skip
    """Taps, and the postures that they are for, (m, joints), rad; drives: each with the courses of it to learn from."""
    cell = read_cell(case.cell_path)
    deflection = Deflection(model, cell.robot, GRAVITY, cell.payload)
    used = [(drive, i, _used(drive, i)) for drive, rows in drives for i in rows]
    postures = spread_postures(np.concatenate([drive.ways.q[: len(u), i][u] for drive, i, u in used]), POSTURES)
    courses = [_course(case, deflection, drive, i, u, swept, postures) for drive, i, u in used]
    return learn(courses, 1.0 / PERIOD, BRISK.translation.acceleration / 3.0), postures  # so that the limit itself acts rarely


def _used(drive: Drive, i: int) -> Array:
    n = int(drive.ways.driving[:, i].sum())
    inside = np.flatnonzero(drive.counted[:n, i])
    used = np.zeros(n, dtype=bool)
    used[inside[0] + round(BEGIN / PERIOD) : inside[-1] - round(END / PERIOD)] = True
    return used


def _course(
    case: Case, deflection: Deflection, drive: Drive, i: int, used: Array, swept: Swept, postures: Array
) -> DrivenCourse:  # fmt: skip
    n = len(used)
    force = filtered(stages_before(filters_of(case)), drive.reading[:n, i])
    part = DrivenPart(
        drive.ways.q[:n, i], force, drive.measured[:n, i], drive.ways.counts[:n, i], used, float(drive.ways.rail[i]),
        drive.sent[:n, i] if drive.sent.any() else None,
    )  # fmt: skip
    return driven_course(deflection, part, Answers(swept.postures, swept.impulses), postures, PERIOD)
