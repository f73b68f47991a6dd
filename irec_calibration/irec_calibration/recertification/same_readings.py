# SPDX-License-Identifier: Apache-2.0
"""Which rows are the same reading taken again, and how far such readings scatter.

What scatters between visits of one pose averages out over them. What the model in force misses at a pose comes again at each
visit: no number of visits makes it smaller, and it must not be taken for a change of the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..identification.observe import Observation
from ..typing import Array, IntArray

SAME_PLACE = 3e-3  # rad and m, each joint: a robot that goes to a pose again comes nearer than that; other poses are further
FEWEST_FREE = 60  # degrees of freedom from which on the scatter is told from the rest


@dataclass(frozen=True)
class Level:
    """Noise of the observed rows, relative to what the session states, in two parts that add in squares.

    Attributes:
        scatter: differs at each visit. lasting: comes again at each visit of a pose in the same load case.
    """

    scatter: float
    lasting: float = 0.0

    def of_means(self, times: float) -> float:
        """Level that explains the means over so many visits, were each visit's noise its own."""
        return float(np.sqrt(self.scatter**2 + times * self.lasting**2))


def same_readings(observation: Observation) -> IntArray:
    """Number of the place and load case of each observed row, (m,); rows with the same number are the same reading again."""
    both = np.stack([places(observation), observation.session.load_case[observation.rows]], axis=1)
    return np.asarray(np.unique(both, axis=0, return_inverse=True)[1].ravel())


def places(observation: Observation) -> IntArray:
    """Number of the place at which each observed row was measured, (m,)."""
    session, at = observation.session, observation.scene.reference[observation.rows]
    where = np.column_stack([session.q, *session.ext.values()])
    known: list[Array] = []
    numbers: dict[int, int] = {}
    for row in np.unique(at).tolist():
        near = next((i for i, p in enumerate(known) if np.abs(where[row] - p).max() < SAME_PLACE), len(known))
        if near == len(known):
            known.append(where[row])
        numbers[row] = near
    return np.array([numbers[row] for row in at.tolist()], dtype=np.int64)


def level_of(observation: Observation, same: IntArray, left: Array, total: float) -> Level | None:
    """The two parts of the noise, from what a model leaves of the rows; None where too little was measured again to tell.

    What comes again is what the total exceeds the scatter by, where that is more than the error of their difference.

    Args:
        same: of `same_readings`. left: measured minus predicted displacement, (m, 3), m. total: level of all of it.
    """
    numbers, counts = np.unique(same, return_counts=True)
    again = numbers[counts > 1]
    freedom = 3 * int((counts - 1).sum())
    if freedom < FEWEST_FREE:
        return None
    keep = np.isin(same, again)
    few = observation.only(keep)
    means = (same[keep][:, None] == again[None, :]).astype(np.float64)
    white = few.whiten(np.repeat(means[:, None, :], 3, axis=1))[:, 0, :]
    target = few.whiten(left[keep])
    of_means = np.linalg.lstsq(white, target, rcond=None)[0]
    scatter = float(np.linalg.norm(target - white @ of_means)) / np.sqrt(freedom)
    error = np.sqrt(2.0) * np.hypot(scatter**2 / np.sqrt(freedom), total**2 / np.sqrt(3.0 * len(same)))
    lasting = total**2 - scatter**2
    return Level(scatter, float(np.sqrt(lasting)) if lasting > error else 0.0)


def covariance_of_rows(level: Level, own: Array, same: IntArray, times: Array | None = None) -> Array:
    """Covariance per coordinate of the rows of a check, (m, m), m^2.

    Args:
        own: covariance that the session states, (m, m). times: how often each row is taken, (m,); None: once.
    """
    once = np.ones(len(own)) if times is None else times
    size = np.sqrt(np.diag(own))
    lasting = np.where(same[:, None] == same[None, :], size[:, None] * size[None, :], 0.0)
    return np.asarray(level.scatter**2 * own / np.sqrt(np.outer(once, once)) + level.lasting**2 * lasting)
