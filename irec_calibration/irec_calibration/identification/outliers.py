# SPDX-License-Identifier: Apache-2.0
"""Rows that are plainly wrong: found, named in plain words, left out, kept or down-weighted.

Every pose is predicted from all others (`neighbours`). A row, or the rows of one pose together, must stand out far beyond the
tail of all the others, and one simple accident (a jump, a swap, a moved reference, ...) must explain it. What bends many poses in
the same way is a missing effect and stays in.

In a loaded session only what no missing effect could do is left out; a row that a cause outside the catalogue may have bent is
named and kept at full weight, since leaving it out would hide the effect from who looks for it. All that fits a session (solve,
compare, codec, diagnose, ...) sees the rows that `treated` leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..model import Term
from ..typing import Array
from .accidents import accidents
from .bad_rows import SHOWN_AGAIN, BadRow, place, shown_again
from .common_cause import common_cause
from .gauss_newton import fitted
from .gross_errors import wrong_forces, wrong_joints
from .neighbours import MIDDLE, neighbours
from .observe import Observation
from .settings import OUTLIERS

KEPT = "kept: a missing effect could do this too"
LASTING = "kept: the readings of later poses have it too, so the station may have moved"


def find(observation: Observation, terms: Sequence[Term]) -> tuple[BadRow, ...]:
    """Rows of a session that are plainly wrong, worst first.

    Args:
        observation: all rows that were observed.
        terms: effects to start from, with or without values.
    """
    return _find(observation, terms)[0]


def treated(observation: Observation, terms: Sequence[Term], lasting: Sequence[int] = ()) -> Observation:
    """The observation without its wrong rows; `bad` and the session's notes say which.

    In an absolute session rows in the tails are down-weighted. In a loaded one all others count in full.

    Args:
        lasting: session rows that are kept although they stand out, since a step that begins there lasts.
    """
    bad, weight = _find(observation, terms)
    if observation.session.kind == "loaded":
        bad = tuple(
            b if b.sigmas >= (OUTLIERS.certain_step if b.kind == "moved" else OUTLIERS.certain) else replace(b, action=KEPT)
            for b in bad
        )
        weight = np.ones(len(weight))
    again = shown_again(observation.session, bad)
    bad = tuple(replace(b, action=SHOWN_AGAIN) if set(b.rows) <= again else b for b in bad)
    bad = tuple(replace(b, action=LASTING) if set(b.rows) & set(lasting) else b for b in bad)
    bad = (*bad, *_from_nowhere(observation, bad))
    out = np.isin(observation.rows, [r for b in bad if b.is_left_out for r in b.rows])
    tail = (weight < OUTLIERS.down_weighted) & ~out
    if tail.mean() > OUTLIERS.tails_at_most:
        tail[:] = False  # so many are no tail but structure, which a verdict needs in full
    if tail.any():
        worst = int(np.argmin(np.where(tail, weight, np.inf)))
        count = f"{int(tail.sum())} of {len(tail)} rows scatter more than normal noise"
        where = place(observation.session, int(observation.rows[worst]))
        rows = tuple(int(r) for r in observation.rows[tail])
        bad = (*bad, BadRow("tail", rows, float("nan"), f"{count}, most {where}", "down-weighted"))
    if not bad:
        return observation
    kept = observation.weighted(np.where(tail, weight, 1.0)).only(~out)
    session = replace(kept.session, notes=(*kept.session.notes, *(str(b) for b in bad)))
    return replace(kept, session=session, bad=bad)


def _from_nowhere(observation: Observation, bad: Sequence[BadRow]) -> list[BadRow]:
    """Rows of an absolute session that come after joint angles which are not their pose's: nobody knows which step was made."""
    session, previous = observation.session, observation.scene.previous
    if session.kind != "absolute" or session.q_target is not None:
        return []
    wrong = [r for b in bad if b.kind == "joints" and b.is_left_out for r in b.rows]
    spoilt = np.isin(session.pose, session.pose[wrong])
    after = observation.rows[(previous[observation.rows] >= 0) & spoilt[previous[observation.rows]]]
    after = np.setdiff1d(after, [r for b in bad if b.is_left_out for r in b.rows])
    text = "pose {}: comes after joint angles that are not those of their pose; from where the robot came is not known"
    poses = np.unique(session.pose[after])
    return [
        BadRow("joints", tuple(int(r) for r in after[session.pose[after] == p]), float("nan"), text.format(p)) for p in poses
    ]


def again(observation: Observation, like: Observation) -> Observation:
    """Another observation of the same session with the rows and weights of one whose wrong rows were treated."""
    weight = dict(zip(like.rows.tolist(), like.weight.tolist(), strict=True))
    kept = observation.only(np.isin(observation.rows, like.rows))
    kept = kept.weighted(np.array([weight[r] for r in kept.rows.tolist()]))
    return replace(kept, session=replace(kept.session, notes=like.session.notes), bad=like.bad)


def _find(observation: Observation, terms: Sequence[Term]) -> tuple[tuple[BadRow, ...], Array]:
    gross = [*wrong_joints(observation.session), *wrong_forces(observation.session, observation.rows)]
    out = np.isin(observation.rows, [r for b in gross for r in b.rows])
    found: list[BadRow] = list(gross)
    weight = np.ones(len(observation.rows))
    if len(np.unique(observation.whiten.group[~out])) < OUTLIERS.fewest_blocks:
        return tuple(found), weight
    kept_in: set[int] = set()
    if observation.session.kind == "absolute":
        weight = robust_weights(observation, terms)
    for _ in range(OUTLIERS.rounds):
        live = observation.only(~out)
        near = neighbours(live, fitted(terms, live.weighted(weight[~out])).terms)
        weight[~out] = near.weight
        more = [b for b in accidents(live, near, any(b.kind == "moved" for b in found)) if not kept_in & set(b.rows)]
        common = common_cause(live, near, more)
        kept_in |= {r for b in common for r in b.rows}
        more = [b for b in more if b not in common]
        new = np.isin(observation.rows, [r for b in more for r in b.rows])
        if not more or (out | new).mean() > OUTLIERS.most:
            break
        found += more
        out = out | new
    found.sort(key=lambda b: -(b.size_m if np.isfinite(b.size_m) else 1e3))
    return tuple(found), np.where(out, 1.0, weight)


def robust_weights(observation: Observation, terms: Sequence[Term]) -> Array:
    """Of an absolute session: weights by which rows far from the truth do not bend a fit of the terms, (m,); each marker has its
    own scale."""
    marker = observation.session.marker[observation.rows]
    weight = np.ones(len(marker))
    for _ in range(OUTLIERS.starts):
        # from the start each time: wrong rows hide which geometric parameters the poses determine
        found = fitted(terms, observation.weighted(weight))
        r = np.linalg.norm(observation.y - observation.of(found.moved), axis=1)
        z = r / observation.whiten.sigma
        for m in np.unique(marker):
            z[marker == m] *= np.sqrt(MIDDLE) / max(float(np.median(z[marker == m])), 1e-12)
        new = np.maximum(np.where(z > OUTLIERS.redescends, (OUTLIERS.redescends / z) ** 4, 1.0), OUTLIERS.smallest_weight)
        if np.abs(new - weight).max() < 0.1:
            break
        weight = new
    return weight
