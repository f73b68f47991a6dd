# SPDX-License-Identifier: Apache-2.0
"""Poses in which the load cases turn the torque of an axis round: nowhere else does play of its gear show.

Gravity presses the teeth of a gear to one side, a process force to the same or to the other. Play is crossed only where the
total torque changes its sign between the rows of a pose, and shows the better the farther it goes to either side. Axes that
carry the arm are turned in few places of a tooling, which a choice by distance or by observability of springs may miss.
"""

from __future__ import annotations

import numpy as np

from ..cell import Cell
from ..effects.joint_backlash import TAKEN_UP_OVER
from ..robot.ratings import rated_torque
from ..typing import Array, IntArray

SHARE = sorted(TAKEN_UP_OVER)[1]  # of the rated torque; less than that to either side hardly shows play


def turned(cell: Cell, q: Array) -> Array:
    """How far the load cases of a cell turn the torque of each axis, (n, k), in shares of the rated torque.

    The smaller of the largest torques to either side over reference and load cases, gravity included; 0 or less: not turned.

    Args:
        q: joint angles at contact, (n, k), rad.
    """
    kin = cell.robot.kinematics(q)
    force = np.einsum("nij,mj->nmi", kin.R_tool, cell.forces_in_tool)
    gravity = cell.robot.gravity_torque(q, payload=cell.payload)
    total = gravity[:, None] + np.einsum("nik,nmi->nmk", kin.jacobian(kin.p_tcp), force)
    rows = np.concatenate([gravity[:, None], total], axis=1)
    return np.asarray(np.minimum(rows.max(axis=1), -rows.min(axis=1)) / rated_torque(cell.robot))


def wanted(far: Array, chosen: IntArray, each: int) -> IntArray:
    """Indices of candidates that turn the axes which a choice turns in fewer than `each` poses though the tooling lets them turn.

    Those of the choice are among them; the others are those that turn the axis farthest. Empty where the choice lacks none.

    Args:
        far: of `turned` at all candidates, (n, k). chosen: indices.
    """
    out: list[int] = []
    for axis in np.flatnonzero((far > SHARE).any(axis=0)):
        best = np.argsort(-far[:, axis])
        best = best[far[best, axis] > SHARE].tolist()
        have = [i for i in best if i in chosen or i in out]
        if len(have) < min(each, len(best)):
            others = [i for i in best if i not in have]
            out += [i for i in (*have, *others[: each - len(have)]) if i not in out]
    return np.array(out, dtype=np.int64)


def exchanged(points: Array, chosen: IntArray, needed: IntArray) -> IntArray:
    """The choice with each needed candidate that it lacks in the place of the chosen one that is nearest to it.

    points: (n, 3), m. chosen, needed: indices; no more needed than chosen.
    """
    out = chosen.copy()
    for i in needed[~np.isin(needed, chosen)].tolist():
        gap = np.linalg.norm(points[out] - points[i], axis=1)
        gap[np.isin(out, needed)] = np.inf
        out[int(np.argmin(gap))] = i
    return out
