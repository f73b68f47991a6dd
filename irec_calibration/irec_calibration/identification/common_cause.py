# SPDX-License-Identifier: Apache-2.0
"""Whether rows that stand out are one cause that many poses have, and no accidents: turns about an axis, play."""

from __future__ import annotations

import numpy as np

from ..typing import Array
from .bad_rows import BadRow
from .neighbours import Neighbours
from .observe import Observation
from .settings import OUTLIERS


def common_cause(observation: Observation, near: Neighbours, bad: list[BadRow]) -> list[BadRow]:
    """Those of the accidents that are one cause: at three poses or more, alike turns about one axis; or play of an axis whose
    torque changes its sign in few rows, and just there."""
    scene = observation.scene
    size = near.scale * float(np.median(observation.whiten.sigma)) * OUTLIERS.common_size
    small = [b for b in bad if b.kind in ("jump", "moved") and b.size_m < size]
    if not small:
        return []
    block_of = {int(observation.rows[i]): block for block in near.blocks for i in block.rows}
    shift = []
    for b in small:
        block = block_of[b.rows[0]]
        shift.append(block.gain(np.isin(observation.rows[block.rows], b.rows).astype(float))[1])
    d, rows = np.array(shift), np.array([b.rows[0] for b in small])
    played = [b for b, along in zip(small, _along_play(observation, d, small), strict=True) if along]
    if len({int(scene.pose[r]) for r in rows}) < OUTLIERS.common_poses:
        return played
    columns = np.concatenate([scene.J[rows], scene.V[rows]], axis=2)
    for c in np.moveaxis(columns, 2, 0):
        length = np.linalg.norm(c, axis=1)
        if length.min() < 0.05 * max(length.max(), 1e-9):
            continue
        along = np.einsum("ni,ni->n", d, c) / length
        angle = np.abs(along) / length
        if (along**2).sum() > OUTLIERS.common * (d**2).sum() and angle.std() < 0.5 * angle.mean():
            return small
    return played


def _along_play(observation: Observation, d: Array, bad: list[BadRow]) -> Array:
    """Whether each displacement is what play of an axis does in poses where its torque has changed its sign, (k,)."""
    scene, rows = observation.scene, np.array([b.rows[0] for b in bad])
    if scene.kind == "absolute":
        return np.zeros(len(rows), dtype=bool)
    sign = np.sign(scene.tau + scene.tau_gravity)
    flips = sign != sign[scene.reference]
    sparse = flips[observation.rows].mean(axis=0) < OUTLIERS.sparse
    beside = np.empty((len(bad), scene.n_joints), dtype=bool)
    for i, b in enumerate(bad):
        mates = observation.rows[scene.reference[observation.rows] == scene.reference[b.rows[0]]]
        among = np.isin(mates, b.rows)
        # of rows that moved together just these must have changed their sign
        together = flips[mates[among]].all(axis=0) & ~flips[mates[~among]].any(axis=0)
        beside[i] = flips[mates].any(axis=0) if b.kind == "jump" else together
    c = scene.J[rows]
    length = np.linalg.norm(d, axis=1)[:, None] * np.linalg.norm(c, axis=1)
    cosine = np.abs(np.einsum("ni,nik->nk", d, c)) / np.maximum(length, 1e-12)
    found: Array = ((cosine > OUTLIERS.along) & beside & sparse).any(axis=1)
    return found
