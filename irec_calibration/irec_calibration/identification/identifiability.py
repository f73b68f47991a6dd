# SPDX-License-Identifier: Apache-2.0
"""What a session tells about each parameter: rank, standard errors, and sums of parameters that it can't tell apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model import Combination
from ..typing import Array, BoolArray
from .settings import IDENTIFIABILITY
from .system import System


@dataclass(frozen=True)
class Identifiability:
    """Of the p parameters of a system, errors as the noise of the instruments makes them.

    Attributes:
        rank: numerical rank of the observation matrix.
        condition: largest over smallest singular value of what is observed, columns of unit length.
        se: standard errors in physical units, (p,); NaN where a parameter is not determined by itself.
        alone: whether each parameter is determined by itself, (p,).
        combinations: what is known of those that are not.
    """

    rank: int
    condition: float
    se: Array
    alone: BoolArray
    combinations: tuple[Combination, ...]


def identifiability(system: System, names: list[str], values: Array) -> Identifiability:
    """Rank, standard errors and combinations of a whitened system.

    Args:
        system: linearised about the values.
        names, values: of its parameters, physical units, (p,).
    """
    norm = np.linalg.norm(system.A, axis=0)
    seen = norm > IDENTIFIABILITY.invisible
    _, s, Vt = np.linalg.svd(system.A[:, seen] / norm[seen], full_matrices=False)
    rank = int((s > IDENTIFIABILITY.structural * s[0]).sum()) if len(s) else 0
    known, hidden = Vt[:rank], Vt[rank:]
    variance = np.full(len(names), np.nan)
    loss = np.zeros(len(names))
    variance[seen] = ((known.T / s[:rank]) ** 2).sum(axis=1) / norm[seen] ** 2
    loss[seen] = np.sqrt((hidden**2).sum(axis=0)) if len(hidden) else 0.0
    alone = seen & (loss < IDENTIFIABILITY.alone)
    to_physical = system.scale[seen] / norm[seen]
    covariance = (known.T / s[:rank] ** 2) @ known * np.outer(to_physical, to_physical)
    return Identifiability(
        rank=rank,
        condition=float(s[0] / s[rank - 1]) if rank else np.inf,
        se=np.where(alone, np.sqrt(variance) * system.scale, np.nan),
        alone=alone,
        combinations=_combinations(hidden * to_physical, loss[seen], np.array(names)[seen], values[seen], covariance),
    )


def _combinations(hidden: Array, loss: Array, names: Array, values: Array, covariance: Array) -> tuple[Combination, ...]:
    """Sums that stay the same along every direction that is not observed.

    Args:
        hidden: unobserved directions in physical units, (d, p).
        loss: share of each parameter that lies along them, (p,).
        covariance: of the observed part, in physical units, (p, p).
    """
    members = np.flatnonzero(loss >= IDENTIFIABILITY.alone)
    if not len(members):
        return ()
    # reduced row echelon form: each parameter that is no pivot, corrected by the pivots, is a sum that is observed
    size = np.abs(hidden[:, members]).max(axis=0)
    rows = hidden[:, members] / size
    pivots: list[int] = []
    for r in range(len(rows)):
        column = int(np.argmax(np.abs(rows[r])))
        pivots.append(column)
        rows[r] /= rows[r, column]
        others = np.arange(len(rows)) != r
        rows[others] -= np.outer(rows[others, column], rows[r])
    out = []
    for j in range(len(members)):
        if j in pivots:
            continue
        w = np.zeros(len(names))
        w[members[j]] = 1.0
        w[members[pivots]] = -rows[:, j] * size[j] / size[pivots]
        w[np.abs(w) < 1e-6] = 0.0
        if np.count_nonzero(w) > 1:
            weights = {str(names[i]): float(w[i]) for i in np.flatnonzero(w)}
            out.append(Combination(weights, float(w @ values), float(np.sqrt(w @ covariance @ w))))
    return tuple(out)
