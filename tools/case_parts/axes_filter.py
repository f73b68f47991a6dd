# SPDX-License-Identifier: Apache-2.0
"""The filter of each axis of the force, learnt from training courses driven without correction with the tracker on the tool."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from irec_calibration.cell import read_cell
from irec_calibration.model import Model
from irec_calibration.typing import Array
from irec_correction.course_filter import CourseFilter, DrivenCourse, learn, moved_by, spread_postures
from irec_correction.deflection import Deflection
from irec_correction.fir import nearness
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
    q, counts, rail = drive.ways.q[:n, i], drive.ways.counts[:n, i], float(drive.ways.rail[i])
    force = filtered(stages_before(filters_of(case)), drive.reading[:n, i])
    sent = _by_axis(deflection, q, force, rail)
    near, impulses = nearness(swept.postures, q), list(swept.impulses)
    moved = np.stack([(moved_by(impulses, near, sent[:, a]) * counts).sum(axis=1) for a in range(3)], axis=1)
    # what the springs' curves make of the force beyond the sum over its axes passes whatever the taps are
    beyond = moved_by(impulses, near, _predicted(deflection, q, force, rail) - sent.sum(axis=1))
    deviation = ((drive.measured[:n, i] - beyond) * counts).sum(axis=1)
    return DrivenCourse(moved, deviation, sent, nearness(postures, q), used)


def _predicted(deflection: Deflection, q: Array, force: Array, rail: float) -> Array:
    """Predicted deflection along a course, (n, 3), m."""
    deflection.reset()
    still = np.zeros(3)
    return np.array([deflection(a, f, still, PERIOD, rail)[0].copy() for a, f in zip(q, force, strict=True)])


def _by_axis(deflection: Deflection, q: Array, force: Array, rail: float, apart: int = 50) -> Array:
    """Predicted deflection by each axis of the force alone, about the force that there is, (n, 3 axes, 3), m."""
    at = np.unique(np.r_[np.arange(0, len(q), apart), len(q) - 1])
    slope = np.empty((len(at), 3, 3))
    still, step = np.zeros(3), 30.0  # N
    deflection.reset()
    for j, k in enumerate(at):
        about = force[max(0, k - apart) : k + apart].mean(axis=0)
        for a in range(3):
            d = step * np.eye(3)[a]
            up = deflection(q[k], about + d, still, 0.0, rail)[0].copy()
            slope[j, a] = (up - deflection(q[k], about - d, still, 0.0, rail)[0]) / (2.0 * step)
    t = np.arange(len(q))
    C = np.stack([np.interp(t, at, slope[:, a, p]) for a in range(3) for p in range(3)], axis=1).reshape(-1, 3, 3)
    return np.asarray(C * force[:, :, None])
