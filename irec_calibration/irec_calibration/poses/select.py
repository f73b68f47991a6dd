# SPDX-License-Identifier: Apache-2.0
"""Selection of few poses from a pool, behind one interface: cover, ioops, d_optimal, i_optimal, random.

Decisions on COVER (the paper's Pseudocode 2 leaves two of them open):

* Line 8 as printed ends at i = k - 1, with N - 1 poses, although the result is to hold N. Here N poses means N.
* As printed, the pose whose distance is at last within d_max has been added before the test. Here the test comes first: as soon
  as every candidate is within d_max of a chosen pose, selection stops, and no pose is spent that the threshold does not ask
  for. So each pose after the first is farther than d_max from all before it, and every candidate is within d_max of one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import PlanError
from ..typing import Array, IntArray

METHODS = {
    "cover": "farthest point first, on the surface (Pseudocode 2)",
    "ioops": "observability index O1 by one-by-one exchange (Pseudocode 1)",
    "d_optimal": "largest information, with the noise of the shared reference, best of several exchanges",
    "i_optimal": "smallest predicted error over the work poses",
    "random": "at random, for comparison",
}
_RIDGE = 1e-8  # of the mean Gram of the pool: keeps criteria finite while few poses are chosen
_RESTARTS = 3


@dataclass(frozen=True)
class Candidates:
    """A pool as the selection sees it: n candidates, r identifiable combinations of parameters.

    points: on the surface, cell frame, (n, 3), m. distance: index -> distances to all points (n,), m; straight lines when None.
    gram: plain Gram of each pose (Eq. 17-18) in the identifiable combinations, (n, r, r): ioops.
    information: the same, whitened by the measurement noise: d_optimal, i_optimal.
    work: Gram of the deflections asked for, mean over the work poses, (r, r): i_optimal.
    """

    points: Array
    distance: Callable[[int], Array] | None = None
    gram: Array | None = None
    information: Array | None = None
    work: Array | None = None

    def __len__(self) -> int:
        return len(self.points)

    def subset(self, indices: IntArray) -> Candidates:
        """Some of the candidates, for the same work; straight distances only."""
        gram = None if self.gram is None else self.gram[indices]
        information = None if self.information is None else self.information[indices]
        return Candidates(self.points[indices], None, gram, information, self.work)


def select_poses(method: str, candidates: Candidates, n: int, *, d_max: float = 0.0, seed: int = 1) -> IntArray:
    """Indices of the chosen candidates, in the order of choice (for cover: coarse to fine).

    Args:
        method: one of METHODS.
        candidates: what the method needs of the pool has to be filled in.
        n: number of poses; cover returns fewer when d_max is reached first.
        d_max: cover only: stop when every candidate is within this distance of a chosen pose, m; 0: never.
        seed: of random choices.

    Raises PlanError: unknown method, empty pool, n larger than the pool, or a matrix that the method needs is missing.
    """
    if method not in METHODS:
        raise PlanError(f"unknown method {method!r}: there are {', '.join(METHODS)}")
    if len(candidates) == 0:
        raise PlanError("the pool is empty: there is no pose to select from")
    if not 1 <= n <= len(candidates):
        raise PlanError(f"{n} poses were asked for, the pool has {len(candidates)}: ask for 1 to {len(candidates)}")
    rng = np.random.default_rng(seed)
    if method == "cover":
        return cover(candidates.points, n, d_max, distance=candidates.distance)
    if method == "random":
        return rng.choice(len(candidates), size=n, replace=False)
    matrices = candidates.gram if method == "ioops" else candidates.information
    if matrices is None or (method == "i_optimal" and candidates.work is None):
        raise PlanError(f"method {method} needs the observation blocks of the pool")
    start = rng.choice(len(candidates), size=n, replace=False)
    if method == "ioops":
        return exchange(matrices, start, LogDeterminant())
    criterion: Criterion = LogDeterminant()
    starts = [greedy(matrices, n, criterion), start]
    starts += [rng.choice(len(candidates), size=n, replace=False) for _ in range(_RESTARTS - len(starts))]
    if method == "i_optimal" and candidates.work is not None:
        criterion = WorkError(candidates.work)
    results = [exchange(matrices, s, criterion) for s in starts]
    return max(results, key=lambda chosen: criterion.value(_sum(matrices, chosen)[None])[0])


def cover(
    points: Array,
    n: int,
    d_max: float = 0.0,
    *,
    first: IntArray | None = None,
    distance: Callable[[int], Array] | None = None,
) -> IntArray:
    """Gonzalez' farthest-point heuristics for the k-centre problem (Pseudocode 2), O(n k).

    Args:
        points: (n_points, 3), m.
        n: largest number of poses.
        d_max: stop when every point is within this distance of a chosen one, m; 0: never.
        first: indices that are chosen before any other; the point nearest the centroid when None.
        distance: index -> distances to all points, m; straight lines when None.
    """
    coordinates = np.ascontiguousarray(points.T)

    def to_all(index: int) -> Array:
        if distance is not None:
            return distance(index) ** 2
        x, y, z = coordinates - coordinates[:, index, None]
        return x * x + y * y + z * z

    if first is None:
        first = np.array([central(points)])
    chosen = first.tolist()[:n]
    nearest = np.min([to_all(i) for i in chosen], axis=0)
    while len(chosen) < n:
        farthest = int(np.argmax(nearest))
        if nearest[farthest] <= d_max * d_max:
            break
        chosen.append(farthest)
        np.minimum(nearest, to_all(farthest), out=nearest)
    return np.array(chosen)


def central(points: Array) -> int:
    """Index of the point nearest the centroid; points (n, 3), m."""
    return int(np.argmin(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))


def cover_distance(candidates: Candidates, chosen: IntArray) -> float:
    """Largest distance of a candidate from its nearest chosen pose, m: what is compared with d_max."""
    if candidates.distance is not None:
        return float(np.min([candidates.distance(int(i)) for i in chosen], axis=0).max())
    gap = np.linalg.norm(candidates.points[:, None] - candidates.points[None, chosen], axis=2)
    return float(gap.min(axis=1).max())


class Criterion:
    """A number to maximise, of the sum S (r, r) of the matrices of the chosen poses."""

    def value(self, S: Array) -> Array:
        """The criterion of each matrix of a stack (k, r, r) -> (k,)."""
        raise NotImplementedError

    def bound(self, S: Array, matrices: Array) -> Array:
        """What adding each of the matrices (n, r, r) to S can reach at most, (n,). Cheap: saves most evaluations."""
        raise NotImplementedError


class LogDeterminant(Criterion):
    """log det S: for a given number of poses the same order as O1 = (det S)^(1/2r) / sqrt(3 N M), Eq. (20)."""

    def value(self, S: Array) -> Array:
        sign, log_det = np.linalg.slogdet(S)
        return np.where(sign > 0, log_det, -np.inf)

    def bound(self, S: Array, matrices: Array) -> Array:
        # log det(S + G) = log det S + log det(I + M), and the r eigenvalues of M have the sum tr(S^-1 G)
        r = len(S)
        trace = np.maximum(matrices.reshape(len(matrices), -1) @ np.linalg.inv(S).ravel(), 0.0)
        return self.value(S[None])[0] + r * np.log1p(trace / r)


class WorkError(Criterion):
    """-tr(S^-1 W): minus the mean variance of predicted deflections over the work poses (I-optimality, test-pose approach)."""

    def __init__(self, work: Array) -> None:
        self._work = work

    def value(self, S: Array) -> Array:
        return -np.einsum("kij,ji->k", np.linalg.inv(S), self._work)

    def bound(self, S: Array, matrices: Array) -> Array:
        # tr(S^-1 W) is convex in S: it can't fall faster than its slope at S
        inverse = np.linalg.inv(S)
        slope = inverse @ self._work @ inverse
        return self.value(S[None])[0] + matrices.reshape(len(matrices), -1) @ slope.ravel()


def exchange(matrices: Array, start: IntArray, criterion: Criterion) -> IntArray:
    """Add the best candidate, remove the least useful pose, until these are the same (Pseudocode 1, IOOPS).

    matrices: (n, r, r), scaled so that their mean is about the unit matrix. start: indices of the first set, its size stays.
    """
    chosen = list(int(i) for i in start)
    if len(chosen) == len(matrices):
        return np.array(chosen)
    S = _sum(matrices, start)
    while True:
        best = _best_addition(S, matrices, chosen, criterion)
        S = S + matrices[best]
        chosen.append(best)
        without = criterion.value(S - matrices[chosen])
        worst = int(np.argmax(without))
        # a swap between two poses that count the same to rounding error would go on for ever
        if worst == len(chosen) - 1 or without[worst] <= without[-1] + 1e-12 * abs(without[-1]):
            return np.array(chosen[:-1])
        chosen.pop(worst)
        S = _sum(matrices, np.array(chosen))


def greedy(matrices: Array, n: int, criterion: Criterion) -> IntArray:
    """Begin with nothing and add the best candidate n times."""
    chosen: list[int] = []
    S = _RIDGE * np.eye(matrices.shape[1])
    while len(chosen) < n:
        chosen.append(_best_addition(S, matrices, chosen, criterion))
        S = S + matrices[chosen[-1]]
    return np.array(chosen)


def _sum(matrices: Array, chosen: IntArray) -> Array:
    return matrices[chosen].sum(axis=0) + _RIDGE * np.eye(matrices.shape[1])


def _best_addition(S: Array, matrices: Array, chosen: list[int], criterion: Criterion) -> int:
    """The candidate not yet chosen that raises the criterion most; only those whose bound is above the best are evaluated."""
    bound = criterion.bound(S, matrices)
    bound[chosen] = -np.inf
    few = min(48, len(matrices) - len(chosen))
    first = np.argpartition(-bound, few - 1)[:few]
    value = criterion.value(S + matrices[first])
    best, reached = int(first[np.argmax(value)]), float(value.max())
    bound[first] = -np.inf
    rest = np.flatnonzero(bound > reached)
    if len(rest):
        value = criterion.value(S + matrices[rest])
        if value.max() > reached:
            best = int(rest[np.argmax(value)])
    return best
