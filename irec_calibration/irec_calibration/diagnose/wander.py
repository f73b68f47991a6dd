# SPDX-License-Identifier: Apache-2.0
"""Noise that wanders within minutes: how much of it, and how slowly, by the residual of a session.

An Ornstein-Uhlenbeck process in time: in a loaded session within the rows that share a reference (differences of different poses
are taken as independent, see `Whitening`), in an absolute one over all rows of a station. There it is a share of what the markers
of a pose have in common, where several were seen, or of the noise of each row. A share of the variance and a correlation time are
chosen where they make the residual beside model and remainder likelier by far than independent noise of the same size does.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ..identification.noise import Wander
from ..identification.observe import Observation
from ..typing import Array, IntArray
from .settings import SETTINGS, Settings

SHARES = (0.25, 0.5, 0.7, 0.85, 0.95)
TIMES = (3.0, 6.0, 12.0, 30.0, 75.0, 180.0)  # s
FAR_APART = 1e9  # s
STRETCH = 200  # rows in succession that may be correlated; cost grows with its square times their number


def wandering(observation: Observation, residual: Array, settings: Settings = SETTINGS) -> Observation:
    """The observation with that part of its noise taken as correlated in time that the residual shows, if it shows any.

    Args:
        residual: beside everything that has structure, time left aside, (m, 3), m.
    """
    plain = replace(observation, whiten=replace(observation.whiten, wander=None))
    if observation.scene.clock != "time":
        return plain
    alone = _log_likelihood(plain, residual)
    best, value = plain, alone + settings.nats_for_wander
    for possible, share, time in product(_possible(plain), SHARES, TIMES):
        tried = replace(plain, whiten=replace(plain.whiten, wander=replace(possible, share=share, time=time)))
        odds = _log_likelihood(tried, residual)
        if odds > value:
            best, value = tried, odds
    return best


def _possible(observation: Observation) -> tuple[Wander, ...]:
    """Which rows of a session may have correlated noise, and of which noise it may be a share; share and time are yet open.

    What wanders, markers that are seen at one moment have in common; such as are seen one after the other may have their own.
    """
    whiten, rows, session = observation.whiten, observation.rows, observation.session
    stamp = session.stamp[rows]
    if session.kind == "loaded":
        before = session.stamp[observation.scene.reference[rows]]
        return (Wander(0.0, 1.0, stamp, whiten.group, whiten.sigma, before, whiten.sigma_reference),)
    stamp = stamp + FAR_APART * session.station[rows]  # each station has its own course
    stretch = np.empty(len(rows), dtype=np.int64)
    for number, part in enumerate(np.array_split(np.argsort(stamp, kind="stable"), -(-len(rows) // STRETCH))):
        stretch[part] = number
    own = Wander(0.0, 1.0, stamp, _with_whole_groups(stretch, whiten.group), whiten.sigma)
    shared = whiten.sigma_reference > 0.0
    if not shared.any():
        return (own,)
    group = np.unique(whiten.group, return_inverse=True)[1]
    common = np.where(shared, group.ravel(), len(rows) + np.arange(len(rows)))
    together = replace(own, sigma=np.where(shared, whiten.sigma_reference, whiten.sigma), common=common)
    order = np.lexsort((stamp, common))
    at_once = np.all(np.diff(stamp[order])[np.diff(common[order]) == 0] == 0.0)
    return (together,) if at_once else (own, together)


def _with_whole_groups(stretch: IntArray, group: IntArray) -> IntArray:
    """Stretches none of which ends within a group of rows that share noise otherwise: each goes to where its first row is."""
    _, first, of_row = np.unique(group, return_index=True, return_inverse=True)
    return np.asarray(stretch[first][of_row.ravel()])


def likelier(one: Observation, other: Observation, residual: Array) -> float:
    """By how much a residual is likelier under the noise of one observation than under that of another, nats."""
    return _log_likelihood(one, residual) - _log_likelihood(other, residual)


def _log_likelihood(observation: Observation, residual: Array) -> float:
    """Of a residual, its size left free."""
    whiten = observation.whiten
    return float(-0.5 * residual.size * np.log((whiten(residual) ** 2).sum()) - 3.0 * whiten.log_size)
