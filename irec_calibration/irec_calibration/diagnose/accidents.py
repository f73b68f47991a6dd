# SPDX-License-Identifier: Apache-2.0
"""Readings that are accidents for certain, before any cause is weighed.

One reading a millimetre off bends what is fitted beside it, and a step in that pose would pass for whatever the bent fit lacks.
So a single row or reference that stands out by far from everything, with what has structure taken off, is given noise of its
own from the start, unless it seems to be a station that was bumped: that moves all later readings too.
"""

from __future__ import annotations

import numpy as np

from ..effects import Evidence, known_effects
from ..model import Estimate, Term
from ..typing import Array, BoolArray
from .directions import TYPICAL_DISPLACEMENT
from .evidence import Ground
from .lasting import lasts
from .remainder import Part, Remainder
from .settings import Settings
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
    x, at, out = study.bench.posterior(remainder.block).x, study.base.A.shape[1], []
    for part in remainder.parts:
        own = slice(at, at + part.structure.columns.stop - part.structure.columns.start)
        at = own.stop
        if not part.structure.is_bad_row or part.log_evidence < settings.nats_of_accident or own.stop - own.start != 3:
            continue
        here = np.isin(study.observation.rows, part.structure.rows)
        moved = x[own] * TYPICAL_DISPLACEMENT
        others = np.linalg.norm(left[~here], axis=1).max(initial=0.0)
        if np.linalg.norm(moved) > settings.accident_size * others and not _may_last(study, here, moved, settings):
            out.append(part)
    return tuple(out)


def _may_last(study: Study, here: BoolArray, moved: Array, settings: Settings) -> bool:
    """Whether a step that begins at a bad reading is rather one of the station: the readings of later poses have it too.

    Args:
        here: rows of the observation, (m,) bool; moved: by how much, (3,), m.
    """
    session, rows = study.session, study.observation.rows
    first = rows[np.flatnonzero(here)]
    pose = (session.pose == session.pose[first[0]]) & (session.repeat == session.repeat[first[0]])
    stamp = session.stamp
    begin = stamp[first].min()
    if not np.isfinite(stamp[pose]).all():
        return False  # no effect of time can act on the session
    if not set(np.flatnonzero(pose & (stamp >= begin))) <= set(first.tolist()):
        return False  # what came after it in its pose is where it was
    shift = next((e for e in known_effects().values() if e.evidence is Evidence.ONE_POSE), None)
    before = stamp[pose & (stamp < begin)]
    if shift is None or not len(before):
        return False
    values = {f"d_{a}": Estimate(float(v), unit="m") for a, v in zip("xyz", moved, strict=True)}
    moment = Estimate(float(0.5 * (before.max() + begin)), unit="s")
    return lasts(study, Term(shift, {**values, "t_shift": moment})) > settings.nats_to_prefer
