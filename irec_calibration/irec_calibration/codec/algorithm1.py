# SPDX-License-Identifier: Apache-2.0
"""Accuracy competency development charts (CODEC, Algorithm 1): how accuracy on unseen poses grows with the number of poses.

Where the paper leaves a choice:

* Verification sets (line 4): COVER is deterministic, so combination i is the COVER of the measured poses that begins at another
  pose each time; at most N combinations. The first pose is the one nearest the centroid, and so on in COVER order.
* The split (lines 2-3): N_v = N / (r + 1) rounded, N_c the rest: N = 31 at 70/30 gives 9 and 22.
* Eq. (19) is weighted by the instruments' noise with the noise of the shared reference row, and bounded; without priors.
* Mean and maximum residual (lines 14-15): of |component| in base_link over all loaded rows of the verification poses; the norm of
  the 3-vector is kept beside them for the charts.

Because Grams of pose blocks add up, every training set costs one sum of small matrices, and all are solved together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..effects import Axes
from ..errors import PlanError, SolveError
from ..identification.bounded import solve_bounded_gram
from ..identification.identify import fit, observe_with_force_noise
from ..identification.observe import Observation
from ..identification.system import free_regressors, linearise
from ..model import Term, total_displacement
from ..poses.blocks import identifiable_subspace
from ..poses.select import Candidates, cover, select_poses
from ..session.data import Session
from ..typing import Array, BoolArray, IntArray

TRAIN_TO_TEST = 70 / 30
ESTIMATOR = "bounded weighted least squares without priors; Algorithm 1: error on verification poses over that of training poses"
FEWEST_POSES = 4
# Relative to the largest diagonal entry: a prior so wide (more than ten times a typical compliance) that it only decides
# between solutions which the data can't tell apart, yet wide enough of rounding errors to make these reproducible to 1e-6.
RIDGE = 1e-8


@dataclass(frozen=True)
class PoseData:
    """A session by poses: N poses, at most R observed rows each (others are padding), p scaled parameters.

    A: derivative of the displacement by the scaled parameters, (N, R, 3, p), m; y: what they have to explain, (N, R, 3), m; zero
    in padding. seen: (N, R). gram, rhs: whitened normal equations of the rows that may train, (N, p, p) and (N, p).
    lower, upper, scale: of the parameters, (p,); physical value = scaled value * scale. names: effect.parameter.
    compliance_of: axes of which each parameter is the compliance, None where it is something else, (p,).
    points: TCP in the cell frame (rail accounted for), (N, 3), m. poses: numbers in the session, (N,).
    sigma, sigma_reference: noise of each row and of the reference it shares, (N, R), m.
    """

    A: Array
    y: Array
    seen: BoolArray
    gram: Array
    rhs: Array
    lower: Array
    upper: Array
    scale: Array
    names: tuple[str, ...]
    compliance_of: tuple[Axes | None, ...]
    points: Array
    poses: IntArray
    sigma: Array
    sigma_reference: Array

    def __len__(self) -> int:
        return len(self.poses)


@dataclass(frozen=True)
class Codec:
    """Result of Algorithm 1; n_cv combinations, n_c sizes of the training set (1 to n_c poses), p parameters.

    E_mean, E_max: mean and maximum |residual| per axis of base_link on the verification poses, (n_cv, n_c, 3), m.
    norm_mean, norm_max: the same of the norm of the 3-vector, (n_cv, n_c), m.
    C: identified parameters, physical units, (n_cv, n_c, p); names: effect.parameter. compliance_of: as in PoseData.
    verification: pose numbers, (n_cv, n_v). training: pose numbers in order of choice at the largest size, (n_cv, n_c).
    poses: number of poses of the session.
    floor_mean, floor_max: what a perfect model would leave of norm_mean and norm_max, from the instruments' noise, m.
    """

    label: str
    E_mean: Array
    E_max: Array
    norm_mean: Array
    norm_max: Array
    C: Array
    names: tuple[str, ...]
    compliance_of: tuple[Axes | None, ...]
    verification: IntArray
    training: IntArray
    poses: int
    floor_mean: float
    floor_max: float

    @property
    def C_a(self) -> Array:
        """Compliances of the actuated joints, (n_cv, n_c, n_a), rad/(N m)."""
        return self.C[:, :, [a is Axes.ACTUATED for a in self.compliance_of]]

    @property
    def C_v(self) -> Array:
        """Compliances of the virtual joints, (n_cv, n_c, n_v), rad/(N m)."""
        return self.C[:, :, [a is Axes.VIRTUAL for a in self.compliance_of]]


def pose_data(session: Session, terms: Sequence[Term], train_cases: Sequence[int] | None = None) -> PoseData:
    """Observation system of a model by poses.

    Args:
        session: loaded or absolute.
        terms: model; effects that are not linear in their parameters are linearised about a fit to the whole session.
        train_cases: load cases that may train (verification always takes all); all when None.

    Raises:
        SolveError: no row has one of the load cases, or the model can't be identified from this session.
    """
    whole = fit(terms, observe_with_force_noise(session, terms))
    observation, fitted = whole.observation, whole.terms
    session = observation.session
    system = linearise(fitted, observation)
    scaled = np.concatenate(free_regressors(fitted, observation.scene), axis=2)
    A = observation.of(scaled) * system.scale
    at = [fitted[i].theta([p])[0] for i, p in zip(system.owner, system.parameters, strict=True)]
    y = observation.y - observation.of(total_displacement(fitted, observation.scene)) + A @ (np.array(at) / system.scale)

    trains = np.ones(len(observation.rows), dtype=bool)
    if train_cases is not None:
        trains = np.isin(session.load_case[observation.rows], list(train_cases))
        if not trains.any():
            raise SolveError(f"{session.path or session.name}: no observed row has load case {list(train_cases)}")
    whiten = observation.whiten.only(trains)
    A_white, y_white = whiten(A[trains]), whiten(y[trains])

    poses, index = np.unique(observation.pose, return_inverse=True)
    N, p = len(poses), A.shape[2]
    slot = np.zeros(len(index), dtype=int)
    for i in range(N):
        slot[index == i] = np.arange(np.sum(index == i))
    R = int(slot.max()) + 1

    def by_pose(rows: Array) -> Array:
        out = np.zeros((N, R, *rows.shape[1:]))
        out[index, slot] = rows
        return out

    gram, rhs = np.zeros((N, p, p)), np.zeros((N, p))
    np.add.at(gram, index[trains], np.einsum("mip,miq->mpq", A_white, A_white))
    np.add.at(rhs, index[trains], np.einsum("mip,mi->mp", A_white, y_white))
    return PoseData(
        A=by_pose(A),
        y=by_pose(y),
        seen=by_pose(np.ones(len(index))) > 0,
        gram=gram,
        rhs=rhs,
        lower=system.lower,
        upper=system.upper,
        scale=system.scale,
        names=tuple(f"{fitted[i].effect.id}.{q.name}" for i, q in zip(system.owner, system.parameters, strict=True)),
        compliance_of=tuple(fitted[i].effect.compliance_of for i in system.owner),
        points=_points_in_cell(session, observation)[[int(np.argmax(index == i)) for i in range(N)]],
        poses=poses,
        sigma=by_pose(observation.whiten.sigma),
        sigma_reference=by_pose(observation.whiten.sigma_reference),
    )


def _points_in_cell(session: Session, observation: Observation) -> Array:
    """TCP of the observed rows in the frame in which the tooling stands still, (m, 3), m."""
    p = session.p_tcp_in_base[observation.rows].copy()
    for axis in session.ext_axes:
        if axis.kind == "prismatic" and axis.name in session.ext:
            p += session.ext[axis.name][observation.rows, None] * np.asarray(axis.axis, dtype=float)
    return p


def split_sizes(n_poses: int, ratio: float = TRAIN_TO_TEST) -> tuple[int, int]:
    """Largest training set N_c and verification set N_v for N poses at a train/test ratio (Algorithm 1, lines 2-3).

    Raises PlanError: too few poses for the split.
    """
    n_v = round(n_poses / (ratio + 1.0))
    if n_poses < FEWEST_POSES or n_v < 1 or n_poses - n_v < 2:
        train, test = 100 * ratio / (1 + ratio), 100 / (1 + ratio)
        raise PlanError(
            f"{n_poses} poses are too few to split {train:.0f}/{test:.0f}: that leaves {n_poses - n_v} for training and {n_v} "
            f"for verification; at least {FEWEST_POSES} poses are needed, 2 of them to train"
        )
    return n_poses - n_v, n_v


def run_codec(
    data: PoseData,
    *,
    method: str = "cover",
    combinations: int | None = None,
    ratio: float = TRAIN_TO_TEST,
    seed: int = 1,
    label: str = "",
) -> Codec:
    """Algorithm 1.

    Args:
        data: from `pose_data`.
        method: pose search by which the training set grows (line 10), one of poses.select.METHODS.
        combinations: N_cv, at most the number of poses; as many when None.
        ratio: train/test ratio r.

    Raises:
        PlanError: too few poses for the split, more combinations than poses, or an unknown method.
    """
    N = len(data)
    n_c, n_v = split_sizes(N, ratio)
    n_cv = N if combinations is None else combinations
    if not 1 <= n_cv <= N:
        raise PlanError(f"{n_cv} combinations were asked for; each begins at another pose, so 1 to {N} are possible")
    gap = np.sum((data.points[:, None] - data.points) ** 2, axis=2)
    everywhere = np.ones((n_cv, N), dtype=bool)
    verification = _cover_each(gap, everywhere, cover(data.points, N)[:n_cv], n_v)
    may_train = everywhere.copy()
    np.put_along_axis(may_train, verification, False, axis=1)
    if method == "cover":
        centroid = may_train @ data.points / n_c
        from_centroid = np.sum((data.points - centroid[:, None]) ** 2, axis=2)
        first = np.argmin(np.where(may_train, from_centroid, np.inf), axis=1)
        order = _cover_each(gap, may_train, first, n_c)
        members = np.cumsum(np.arange(N) == order[:, :, None], axis=1, dtype=float)
    else:
        members, order = _grow(data, may_train, method, seed)

    x = _solve_all(data, members)
    A = data.A[verification].reshape(n_cv, -1, data.A.shape[3])
    residual = data.y[verification].reshape(n_cv, 1, -1) - x @ A.swapaxes(1, 2)
    residual = residual.reshape(n_cv, n_c, -1, 3)
    seen = data.seen[verification].reshape(n_cv, 1, -1)
    size = np.abs(residual) * seen[..., None]
    norm = np.linalg.norm(size, axis=3)
    count = seen.sum(axis=2)
    floor_mean, floor_max = _noise_floor(data, verification)
    return Codec(
        label=label or method,
        E_mean=size.sum(axis=2) / count[..., None],
        E_max=size.max(axis=2),
        norm_mean=norm.sum(axis=2) / count,
        norm_max=norm.max(axis=2),
        C=x * data.scale,
        names=data.names,
        compliance_of=data.compliance_of,
        verification=data.poses[verification],
        training=data.poses[order],
        poses=N,
        floor_mean=floor_mean,
        floor_max=floor_max,
    )


def _noise_floor(data: PoseData, verification: IntArray, draws: int = 16) -> tuple[float, float]:
    """Mean and maximum norm that noise alone leaves on the verification sets, expectation over random draws, m."""
    rng = np.random.default_rng(0)
    own = rng.normal(size=(draws, *data.sigma.shape, 3)) * data.sigma[..., None]
    shared = rng.normal(size=(draws, len(data), 1, 3)) * data.sigma_reference[..., None]
    norm = np.linalg.norm((own + shared) * data.seen[..., None], axis=3)[:, verification]
    mean = norm.sum(axis=(2, 3)) / data.seen[verification].sum(axis=(1, 2))
    return float(mean.mean()), float(norm.max(axis=(2, 3)).mean())


def _solve_all(data: PoseData, members: Array) -> Array:
    """Bounded solutions for training sets given by membership (..., N) of 0 and 1; scaled parameters (..., p)."""
    N, p = data.rhs.shape
    G = (members @ data.gram.reshape(N, p * p)).reshape(*members.shape[:-1], p, p)
    ridge = RIDGE * np.maximum(np.diagonal(G, axis1=-2, axis2=-1).max(axis=-1), 1e-30)
    G[..., np.arange(p), np.arange(p)] += ridge[..., None]
    return solve_bounded_gram(G, members @ data.rhs, data.lower, data.upper)


def _cover_each(gap: Array, allowed: BoolArray, first: IntArray, k: int) -> IntArray:
    """COVER of k poses in each of m subsets at once: what `cover` gives for every subset alone, (m, k).

    gap: squared distances, (N, N). allowed: the subsets, (m, N). first: where each begins, (m,).
    """
    chosen = np.empty((len(first), k), dtype=int)
    chosen[:, 0] = first
    nearest = np.where(allowed, gap[first], -1.0)
    for i in range(1, k):
        chosen[:, i] = np.argmax(nearest, axis=1)
        np.minimum(nearest, gap[chosen[:, i]], out=nearest)
    return chosen


def _grow(data: PoseData, may_train: BoolArray, method: str, seed: int) -> tuple[Array, IntArray]:
    """Membership (n_cv, n_c, N) of the training sets of 1 to n_c poses, and the order of the largest (n_cv, n_c).

    may_train: (n_cv, N). Only `random` grows by adding to what it has; the others search afresh for every size.
    """
    n_cv, n_c = len(may_train), int(may_train[0].sum())
    grams = np.einsum("nrip,nriq->npq", data.A, data.A)
    subspace = identifiable_subspace(grams)
    weighted = subspace.reduce(data.gram)
    weighted = weighted * (subspace.rank / max(np.trace(weighted.mean(axis=0)), 1e-300))
    reduced = subspace.reduce(grams)
    candidates = Candidates(data.points, None, reduced, weighted, reduced.mean(axis=0))
    members = np.zeros((n_cv, n_c, len(data)))
    order = np.empty((n_cv, n_c), dtype=int)
    for i in range(n_cv):
        pool = np.flatnonzero(may_train[i])
        subset = candidates.subset(pool)
        order[i] = pool[select_poses(method, subset, n_c, seed=seed + i)]
        for j in range(n_c):
            chosen = order[i, : j + 1]
            if method != "random" and j + 1 < n_c:
                chosen = pool[select_poses(method, subset, j + 1, seed=seed + i)]
            members[i, j, chosen] = 1.0
    return members, order
