# SPDX-License-Identifier: Apache-2.0
"""Noise that wanders within minutes: how much of it, and how slowly, by the residual of a session.

An Ornstein-Uhlenbeck process in time within the rows that share a reference; differences of different poses are taken as
independent (see `Whitening`). A share of the variance and a correlation time are chosen where
they make the residual beside model and remainder likelier by far than independent noise of the same size does.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ..identification.noise import Wander
from ..identification.observe import Observation
from ..typing import Array
from .settings import SETTINGS, Settings

SHARES = (0.25, 0.5, 0.7, 0.85, 0.95)
TIMES = (3.0, 6.0, 12.0, 30.0, 75.0, 180.0)  # s


def wandering(observation: Observation, residual: Array, settings: Settings = SETTINGS) -> Observation:
    """The observation with that part of its noise taken as correlated in time that the residual shows, if it shows any.

    Args:
        residual: beside everything that has structure, time left aside, (m, 3), m.
    """
    plain = replace(observation, whiten=replace(observation.whiten, wander=None))
    if observation.session.kind != "loaded" or observation.scene.clock != "time":
        return plain
    stamp = observation.session.stamp
    rows = observation.rows
    alone = _log_likelihood(plain, residual)
    best, value = plain, alone + settings.nats_for_wander
    for share, time in product(SHARES, TIMES):
        wander = Wander(share, time, stamp[rows], stamp[observation.scene.reference[rows]])
        tried = replace(plain, whiten=replace(plain.whiten, wander=wander))
        odds = _log_likelihood(tried, residual)
        if odds > value:
            best, value = tried, odds
    return best


def likelier(one: Observation, other: Observation, residual: Array) -> float:
    """By how much a residual is likelier under the noise of one observation than under that of another, nats."""
    return _log_likelihood(one, residual) - _log_likelihood(other, residual)


def _log_likelihood(observation: Observation, residual: Array) -> float:
    """Of a residual, its size left free."""
    whiten = observation.whiten
    return float(-0.5 * residual.size * np.log((whiten(residual) ** 2).sum()) - 3.0 * whiten.log_size)
