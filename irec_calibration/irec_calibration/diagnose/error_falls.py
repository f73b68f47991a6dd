# SPDX-License-Identifier: Apache-2.0
"""By how much the error falls with what was missing: a sentence."""

from __future__ import annotations

import numpy as np

from ..effects import Evidence, find_effect
from ..identification.validation import rms
from ..lengths import length
from ..model import total_displacement
from ..typing import IntArray
from .assessment import Assessment
from .shown import Shown


def how_the_error_falls(assessment: Assessment, shown: Shown) -> str:
    """From what to what the error falls with all that was added, without readings that stand out where there are any.

    What breaks one pose is no help for predicting that pose from others: there the residual says what it does.
    """
    asked, after = shown.asked, shown.after
    broken, by_one = _broken(assessment, shown)
    aside = [*(r for p in assessment.stand_out for r in p.structure.rows), *broken]
    good = np.setdiff1d(np.intersect1d(asked.study.observation.rows, after.study.observation.rows), aside)
    whole = [m.held_out.rms_m for m in (asked, after)]
    of_good = [m.held_out.rms_of(np.isin(m.study.observation.rows, good)) for m in (asked, after)] if len(good) else whole
    goes = "falls" if of_good[1] < of_good[0] else "goes"
    figures, usual = ([f"{length(v)}" for v in values] for values in (whole, of_good))
    begin = f"Added{', with what every robot has' if assessment.usual else ''}, the error on held-out poses {goes} from"
    if by_one:
        stand_out = " and the readings that stand out" if assessment.stand_out else ""
        return f"{by_one} {begin} {usual[0]} to {usual[1]} without that pose{stand_out}."
    if usual == figures:
        return f"{begin} {figures[0]} to {figures[1]}."
    return f"{begin} {usual[0]} to {usual[1]} without the readings that stand out, from {figures[0]} to {figures[1]} with them."


def _broken(assessment: Assessment, shown: Shown) -> tuple[IntArray, str]:
    """Session rows that a named effect moves which breaks one pose, and a sentence on these; none where there is none."""
    one_pose = [i for i in assessment.names if find_effect(i).evidence is Evidence.ONE_POSE]
    study = shown.after.study
    moves = [t for t in study.terms if t.effect.id in one_pose] if one_pose and assessment.study.ready.kind == "loaded" else []
    if not moves:
        return np.empty(0, dtype=int), ""
    observation = study.observation
    moved = observation.rows[np.any(observation.of(total_displacement(moves, observation.scene)) != 0.0, axis=1)]
    before, now = (rms(m.study.fit.residual[np.isin(m.study.observation.rows, moved)]) for m in (shown.asked, shown.after))
    label = " and ".join(t.effect.label for t in moves)
    poses = ", ".join(str(p) for p in np.unique(study.session.pose[moved]))
    return moved, (
        f"{label[0].upper()}{label[1:]} breaks pose {poses}, which no other pose predicts: there the residual falls from"
        f" {length(before)} to {length(now)}."
    )
