# SPDX-License-Identifier: Apache-2.0
"""Which poses of the calibration a quick check visits again, and how small a change they can show.

The power to see a change at a set of visits S is the information that `quick_check.check` will have of it there,

    i = a' (s^2 Sigma_S + B_S P B_S' + N V N')^-1 a,

so that what the calibration itself leaves open, and where the tracker stands, is taken into account; of the ways in which a
change may go, the one that shows least there. Poses are chosen one by
one, each for what the changes that are not yet seen well enough gain by it; then for each it is asked whether another is better.

Each pose is measured several times in a row: pressing again takes half of the time of going to another pose, and what limits the
check is the tracker's noise, not the variety of eight poses. All are gone through twice, so that a large change is found, and
many an unchanged robot passes, after the first and shorter of the two rounds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import Array, IntArray
from .changes import never_shown
from .quick_check import MOST_VISITS, Reference, loaded_columns, row_covariance, station_columns, weighted
from .same_readings import covariance_of_rows, same_readings

PLACES = 8  # different poses
ROUNDS = (2, 4)  # visits of each pose in the first round, and in the second
SEEN_WELL = 4.2  # signal to noise at which a change is excluded with 98 % where there is none, and missed with 2.5 %
MOST_LATERAL = 1.3  # times the forces across the tool of the calibration, as far as the cell bears it: changes show more
MATTERS = 0.10  # share of the tolerance: a change that moves the tool by more has to be found at its size in `changes`
MOST = 0.20  # share of the tolerance: no other change that moves the tool by more may pass


@dataclass(frozen=True)
class QuickPlan:
    """Visits of a quick check.

    Attributes:
        poses: pose numbers of the calibration session in the order of the visits, MOST_VISITS at the most.
        power: change -> signal to noise ratio after all of them, at its size in `changes`.
        sizes: change -> multiple of that size at which it must be found: 1, or what those visits can show; never so much that
            it moves the tool by more than MOST of the tolerance.
        moved: change -> largest displacement of the observed point at its size in `changes`, m.
        seen: what is found, each change at the size at which it must be, in plain words. never: what no pose can show.
        lateral: forces across the tool, in multiples of those of the calibration.
    """

    poses: tuple[int, ...]
    power: dict[str, float]
    sizes: dict[str, float]
    moved: dict[str, float]
    seen: tuple[str, ...]
    never: tuple[str, ...]
    lateral: float = 1.0

    @property
    def looks(self) -> tuple[int, ...]:
        """Numbers of visits after which the robot leaves a pose, and the check is asked."""
        return tuple(n for n in range(1, len(self.poses) + 1) if self.poses[n - 1 : n] != self.poses[n : n + 1])


def plan(reference: Reference, lateral: float = 1.0) -> QuickPlan:
    """Choose visits by the power to see each change, the most telling first.

    Args:
        lateral: forces across the tool at the visits, in multiples of those of the calibration.
    """
    power = _Power(reference, lateral)
    each = MOST_VISITS // PLACES
    times = np.zeros(power.poses, dtype=np.int64)
    order: list[int] = []
    while len(order) < min(PLACES, power.poses):
        best = max(np.flatnonzero(times == 0).tolist(), key=lambda i: power.worth(_with(times, i, each)))
        times[best] = each
        order.append(best)
    for place, old in enumerate(order):  # each once more: is there a better one?
        without = _with(times, old, -each)
        best = max(np.flatnonzero(without == 0).tolist(), key=lambda i: power.worth(_with(without, i, each)))
        if power.worth(_with(without, best, each)) > 1.001 * power.worth(times):
            times, order[place] = _with(without, best, each), best
    moved = {c.name: float(np.linalg.norm(c.displacement, axis=1).max()) for c in reference.changes}
    after = np.sqrt(power.of(times))
    seen = {c.name: float(a) for c, a in zip(reference.changes, after, strict=True)}
    share = {n: m / reference.tolerance for n, m in moved.items()}
    largest = {n: 1.0 if s > MATTERS else MOST / s for n, s in share.items()}
    sizes = {n: float(np.clip(SEEN_WELL / max(seen[n], 1e-9), 1.0, largest[n])) for n in moved}
    return QuickPlan(
        tuple(int(reference.observation.poses[i]) for n in ROUNDS for i in order for _ in range(n)), seen, sizes, moved,
        tuple(c.text(sizes[c.name]) for c in reference.changes),
        tuple(never_shown(reference.changes, reference.terms, reference.observation.scene)), lateral,
    )  # fmt: skip


def _with(times: IntArray, i: int, more_often: int) -> IntArray:
    more = times.copy()
    more[i] += more_often
    return more


class _Power:
    """Information of each change for numbers of visits (poses,)."""

    def __init__(self, reference: Reference, lateral: float = 1.0) -> None:
        o = reference.observation
        index = np.searchsorted(o.poses, o.pose)
        self.poses = len(o.poses)
        repeat = o.session.repeat[o.rows]
        self._rows = [np.flatnonzero((index == i) & (repeat == repeat[index == i].min())) for i in range(self.poses)]
        self._level, self._own, self._same = reference.level, row_covariance(o), same_readings(o)
        self._B, self._A = loaded_columns(reference, lateral)
        self._P = reference.covariance
        self._N = station_columns(o.of(o.scene.p_observed) + o.y)
        # a change that matters has to be seen at its size; another at the largest size at which it does not matter yet
        limit = MATTERS * reference.tolerance
        most = np.array([np.linalg.norm(c.displacement, axis=1).max() for c in reference.changes])
        self._wanted = np.maximum(limit / most, 1.0)
        self._known: dict[bytes, Array] = {}

    def of(self, times: IntArray) -> Array:
        """Information at the sizes of `changes`, (changes,): of the way in which these visits show least of each.

        Play that is taken up over a wide range of torque shows a little wherever the torque comes near zero, play that is
        taken up at once only where the torque is turned; which of them comes nobody knows.
        """
        key = times.tobytes()
        if key not in self._known:
            rows = np.concatenate([self._rows[i] for i in np.flatnonzero(times)])
            often = np.concatenate([np.full(len(self._rows[i]), times[i]) for i in np.flatnonzero(times)])
            at = (3 * rows[:, None] + np.arange(3)).ravel()
            B, A = self._B[at], np.concatenate(self._A[:, at], axis=1)
            # visits of one pose share what the calibration leaves open, not their noise
            noise = covariance_of_rows(self._level, self._own[np.ix_(rows, rows)], self._same[rows], often)
            covariance = np.kron(noise, np.eye(3)) + B @ self._P @ B.T
            each_way = np.einsum("ij,ij->j", A, weighted(covariance, self._N[at], A))
            self._known[key] = each_way.reshape(len(self._A), -1).min(axis=0)
        return self._known[key]

    def worth(self, times: IntArray) -> float:
        """Sum over the changes of how well they are seen, 1 where well enough; what is small counts first at its own size."""
        i = self.of(times) / SEEN_WELL**2
        return float(np.minimum(i * self._wanted**2, 1.0).sum() + 0.5 * np.minimum(i, 1.0).sum() + 1e-3 * np.log1p(i).sum())
