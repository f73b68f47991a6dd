# SPDX-License-Identifier: Apache-2.0
"""Readings that are accidents for certain, before any cause is weighed.

One reading a millimetre off bends what is fitted beside it, and a step in that pose would pass for whatever the bent fit lacks.
So a single row or reference that stands out by far from everything, with what has structure taken off, is given noise of its
own from the start, unless it seems to be a station that was bumped: that moves all later readings too.
"""

from __future__ import annotations

import numpy as np

from ..effects import Evidence, known_effects
from ..identification.observe import beyond_controller
from ..model import Estimate, Term, total_displacement
from ..session.data import Session
from ..typing import Array, IntArray
from .directions import TYPICAL_DISPLACEMENT
from .ground import Ground
from .lasting import lasts
from .remainder import Part, Remainder
from .settings import SETTINGS, Settings
from .study import Study


def accidents(study: Study, remainder: Remainder, settings: Settings) -> tuple[Part, ...]:
    """The rows that stand out of a model and its remainder and are accidents for certain.

    Args:
        study: of the model without anything added.
    """
    if study.ready.kind != "loaded":
        return ()
    ground = Ground(study.bench, remainder.block)
    left = study.observation.whiten.undo(ground.residual.reshape(-1, 3))
    x, out = study.bench.posterior(remainder.block).x, []
    for part, own in remainder.columns:
        if not part.structure.is_bad_row or part.log_evidence < settings.nats_of_accident or own.stop - own.start != 3:
            continue
        here = np.isin(study.observation.rows, part.structure.rows)
        moved = x[own] * TYPICAL_DISPLACEMENT
        others = np.linalg.norm(left[~here], axis=1).max(initial=0.0)
        stands_out = np.linalg.norm(moved) > settings.accident_size * others
        if stands_out and lasts_from(study, study.observation.rows[here], moved) <= settings.nats_to_prefer:
            out.append(part)
    return tuple(out)


def steps_left_out(study: Study, settings: Settings = SETTINGS) -> tuple[int, ...]:
    """Session rows that were left out as plainly wrong although the readings of later poses have the step that begins there."""
    bad = [b for b in study.observation.bad if b.is_left_out and b.kind in ("jump", "moved")]
    if not bad or study.ready.kind != "loaded":
        return ()
    session, scene = study.session, study.observation.scene
    seen = beyond_controller(session, scene) - total_displacement(study.terms, scene)
    out: list[int] = []
    for b in bad:
        rows = np.array(b.rows)
        others = np.setdiff1d(_pose_of(session, rows), rows)
        if len(others):
            moved = np.median(seen[rows], axis=0) - np.median(seen[others], axis=0)
            if np.isfinite(moved).all() and lasts_from(study, rows, moved) > settings.nats_to_name:
                out += b.rows
    return tuple(out)


def lasts_from(study: Study, rows: IntArray, moved: Array) -> float:
    """Log odds that a step that begins at some session rows of one pose lasts, natural; -inf where it can be none.

    Args:
        moved: displacement of the step in base_link, (3,), m.
    """
    stamp, pose = study.session.stamp, _pose_of(study.session, rows)
    shift = next((e for e in known_effects().values() if e.evidence is Evidence.ONE_POSE), None)
    if shift is None or not np.isfinite(stamp[pose]).all():
        return -np.inf
    begin = stamp[rows].min()
    before = stamp[pose][stamp[pose] < begin]
    if not len(before) or not set(pose[stamp[pose] >= begin]) <= set(rows):
        return -np.inf  # what came after it in its pose is where it was
    values = {f"d_{a}": Estimate(float(v), unit="m") for a, v in zip("xyz", moved, strict=True)}
    moment = Estimate(float(0.5 * (before.max() + begin)), unit="s")
    return lasts(study, Term(shift, {**values, "t_shift": moment}))


def _pose_of(session: Session, rows: IntArray) -> IntArray:
    """Session rows of the pose, repeat and marker of some rows: other markers of the pose tell of a step by their own rows."""
    same = (session.pose == session.pose[rows[0]]) & (session.repeat == session.repeat[rows[0]])
    return np.flatnonzero(same & np.isin(session.marker, session.marker[rows]))
