# SPDX-License-Identifier: Apache-2.0
"""A station or a reflector that was knocked within a pose and is as before in the next one: no cause, and its rows say nothing.

In the differences of a loaded session such a step shows in one pose only. It is larger than most causes; as long as its rows are
weighed, what steps or drifts with time is tried before what the other poses show.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..identification.bad_rows import BadRow, mm
from ..identification.observe import Observation
from ..typing import Array
from .accidents import lasts_from
from .explanation import Explanation, in_one_pose
from .ground import Ground
from .settings import SETTINGS

ONE_STEP = 0.9  # of the squares of a pose's residual that one displacement from some row on explains; a law of the load does less
FEWEST = 3  # rows of a pose after the step: fewer may be alike by chance


def without_knocked(one: Explanation) -> Observation | None:
    """The observation without the rows of poses that stand out by one step, whatever the load, which readings of later poses do
    not have; None where there are none."""
    study, observation = one.study, one.study.observation
    if study.ready.kind != "loaded" or study.session.contact is not None or not np.isfinite(study.session.stamp).all():
        return None
    if any(in_one_pose(one, i) for i in one.ids):
        return None
    keep, bad = np.ones(len(observation.rows), dtype=bool), []
    key = observation.scene.reference[observation.rows]
    residual, evidence = _beside_bad_rows(one)
    for k in np.unique(key[[i for i, nats in enumerate(evidence) if nats >= SETTINGS.nats_of_accident]]):
        here = np.flatnonzero(key == k)
        by_time = here[np.argsort(study.session.stamp[observation.rows[here]], kind="stable")]
        step = _step(residual[by_time])
        if step is None:
            continue
        after, moved = by_time[step[0] :], step[1]
        rows = observation.rows[after]
        if lasts_from(study, rows, moved) <= SETTINGS.nats_to_prefer:
            keep[after] = False
            size = float(np.linalg.norm(moved))
            text = f"pose {study.session.pose[rows[0]]}: from some load case on all are moved by {mm(size)}"
            looks = f"{text}; looks like a reflector or station that was knocked"
            bad.append(BadRow("moved", tuple(int(r) for r in rows), size, looks))
    return None if keep.all() else replace(observation.only(keep), bad=(*observation.bad, *bad))


def _beside_bad_rows(one: Explanation) -> tuple[Array, Array]:
    """What a model and its remainder leave without bad readings, (m, 3), m; evidence that each reading is one, (m,), nats."""
    study, block = one.study, one.remainder.block
    x = study.bench.posterior(block).x
    left, evidence = Ground(study.bench, block).residual.copy(), np.zeros(len(study.observation.rows))
    for part, own in one.remainder.columns:
        if part.structure.is_bad_row:
            left += block.A[:, own] @ x[own]
            evidence[np.isin(study.observation.rows, part.structure.rows)] += part.log_evidence
    return study.observation.whiten.undo(left.reshape(-1, 3)), evidence


def _step(residual: Array) -> tuple[int, Array] | None:
    """From which row of a pose on, in time, all are moved alike, and by how much, (3,), m; None where this does not explain them.

    From its second row on: where all are moved, the load of this pose may do it, by a law that is missing.
    """
    n, whole = len(residual), max(float((residual**2).sum()), 1e-300)
    explained = [float((residual[k:].sum(axis=0) ** 2).sum()) / (n - k) / whole for k in range(n - FEWEST + 1)]
    k = int(np.argmax(explained)) if explained else 0
    if k == 0 or explained[k] < ONE_STEP:
        return None
    return k, residual[k:].mean(axis=0)
