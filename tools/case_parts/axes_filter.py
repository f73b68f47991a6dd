# SPDX-License-Identifier: Apache-2.0
"""The filter of each axis of the force, learnt from training courses driven with the tracker on the tool, without correction and
then with what was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from irec_calibration.cell import read_cell
from irec_calibration.model import Model
from irec_calibration.typing import Array
from irec_correction.course_filter import CourseFilter, DrivenCourse, learn, spread_postures
from irec_correction.course_training import Answers, DrivenPart, Known, driven_course, known_along
from irec_correction.deflection import Deflection
from irec_correction.preview import ForceProfile, Preview
from irec_sim.production.runner import Drive
from irec_sim.production.ways import PERIOD

from .corrected import GRAVITY
from .jobs import BRISK, Case, filters_of, stages_before
from .learned import Swept, filtered

BEGIN, END = 0.8, 0.4  # s after touch-down and before lift-off that are not learnt from
POSTURES = 6  # with taps of their own
# Each axis from all axes, and for what the force profile does not tell: decided on folds of the training courses. In fibre
# placement crossed taps made the maximum grow at the touch-down, which is not learnt from (there 850 N come within 0.35 s), and
# nothing was gained beside the profile.
CROSSED = {"afp": False, "machining": True}
BESIDE_PROFILE = {"afp": False, "machining": True}


@dataclass(frozen=True)
class Expected:
    """Force profile of each course by its name, (n, 3), N in tool0; lead, slack: s, as the correction will have them."""

    forces: dict[str, Array]
    lead: float
    slack: float


@dataclass(frozen=True)
class Teaching:
    """Courses to learn from, and the postures (m, joints), rad, that get taps of their own; crossed: as `learn`."""

    courses: tuple[DrivenCourse, ...]
    postures: Array
    crossed: bool

    def learnt(self) -> CourseFilter:
        """Taps for them."""
        allowed = BRISK.translation.acceleration / 3.0  # so that the limit itself acts rarely
        return learn(self.courses, 1.0 / PERIOD, allowed, crossed=self.crossed)


def teaching(
    case: Case, model: Model, drives: Sequence[tuple[Drive, Array]], swept: Swept, expected: Expected,
    before: Teaching | None = None,
) -> Teaching:  # fmt: skip
    """drives: each with the courses of it to learn from; before: more of the same courses, the postures of which stay."""
    cell = read_cell(case.cell_path)
    deflection = Deflection(model, cell.robot, GRAVITY, cell.payload)
    used = [(drive, i, _used(drive, i)) for drive, rows in drives for i in rows]
    if before is None:
        where = np.concatenate([drive.ways.q[: len(u), i][u] for drive, i, u in used])
        before = Teaching((), spread_postures(where, POSTURES), CROSSED[case.name])
    courses = (_course(case, deflection, drive, i, u, swept, expected, before.postures) for drive, i, u in used)
    return replace(before, courses=(*before.courses, *courses))


def _used(drive: Drive, i: int) -> Array:
    n = int(drive.ways.driving[:, i].sum())
    inside = np.flatnonzero(drive.counted[:n, i])
    used = np.zeros(n, dtype=bool)
    used[inside[0] + round(BEGIN / PERIOD) : inside[-1] - round(END / PERIOD)] = True
    return used


def _course(
    case: Case, deflection: Deflection, drive: Drive, i: int, used: Array, swept: Swept, expected: Expected, postures: Array
) -> DrivenCourse:  # fmt: skip
    n = len(used)
    force = filtered(stages_before(filters_of(case)), drive.reading[:n, i])
    part = DrivenPart(
        drive.ways.q[:n, i], force, drive.measured[:n, i], drive.ways.counts[:n, i], used, float(drive.ways.rail[i]),
        drive.sent[:n, i] if drive.sent.any() else None,
        _known(case, drive, i, n, expected) if BESIDE_PROFILE[case.name] else None,
    )  # fmt: skip
    return driven_course(deflection, part, Answers(swept.postures, swept.impulses), postures, PERIOD)


def _known(case: Case, drive: Drive, i: int, n: int, expected: Expected) -> Known:
    """As the correction knows it: the profile followed along the course, moved in time to where the readings have it."""
    wrench = np.zeros((n, 6))
    wrench[:, :3] = expected.forces[drive.ways.names[i]][:n]
    preview = Preview(ForceProfile(drive.ways.q[:n, i], wrench), expected.lead, slack=expected.slack)
    return known_along(preview, drive.ways.q[:n, i], drive.reading[:n, i], stages_before(filters_of(case)))
