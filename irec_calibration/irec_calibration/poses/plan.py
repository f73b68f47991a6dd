# SPDX-License-Identifier: Apache-2.0
"""From a cell to chosen poses with the figures that they promise, before anything is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..cell import Cell
from ..cell.along import distance_along
from ..errors import PlanError
from ..typing import Array, IntArray
from .blocks import (
    condition_number,
    gram,
    identifiable_subspace,
    observability,
    observation_blocks,
    predicted_uncertainty,
    whitened,
)
from .pool import Pool, generate_pool
from .select import Candidates, central, cover, cover_distance, select_poses
from .store import EngagementPose, PoseList
from .turning import SHARE, exchanged, turned, wanted

TURN, TURN_FROM = 3, 16  # poses in which each axis is turned, where so many are asked for: one may fail, one turn too little


def turn_for(n: int) -> int:
    """Poses of n in which the torque of each axis should be turned; none where that would be most of them."""
    return TURN if n >= TURN_FROM else 0


@dataclass(frozen=True)
class Plan:
    """A pool, what was chosen of it (indices, order of choice), and the figures of the choice.

    uncertainty: predicted standard deviation of the corrected deflection at each pose of the pool, worst load case, (n,), m.
    figures: plain numbers by name, SI units.
    """

    pool: Pool
    chosen: IntArray
    method: str
    d_max: float
    seed: int
    uncertainty: Array
    figures: dict[str, float]


def make_plan(
    cell: Cell,
    n: int,
    *,
    method: str = "cover",
    d_max: float = 0.0,
    pool_size: int = 3000,
    seed: int = 1,
    along_surface: bool = False,
    turn: int = 0,
    choose: Callable[[Pool], IntArray] | None = None,
) -> Plan:
    """Generate the pool of a cell, select poses, and predict what they will teach.

    Args:
        n: number of poses; `cover` takes fewer when d_max is reached first.
        method: one of select.METHODS.
        d_max: cover distance at which `cover` stops, m; 0: never.
        along_surface: measure distances along the surface instead of straight.
        turn: poses in which the load cases turn the torque of each axis that they can turn anywhere on the tooling, at least, so
            that play shows; `cover` begins with those that it would lack, other methods exchange their nearest. 0: as it comes.
        choose: chooses n poses of the pool itself, instead of a method; `turn` is left to it.

    Raises:
        PlanError: no point can be engaged, or fewer than n can.
    """
    pool = generate_pool(cell, pool_size, seed)
    if n > len(pool):
        raise PlanError(f"{cell.path}: {n} poses were asked for, the pool has {len(pool)} ({pool.counts()})")
    kin = cell.robot.kinematics(pool.q)
    blocks = observation_blocks(kin, cell.forces_in_tool, cell.marker_in_tool)
    deflection = observation_blocks(kin, cell.forces_in_tool, np.zeros(3))
    grams = gram(blocks)
    subspace = identifiable_subspace(grams)
    weighted = subspace.reduce(gram(whitened(blocks, _reading_noise(cell, pool))))
    mean = np.trace(weighted.mean(axis=0)) / subspace.rank
    candidates = Candidates(
        points=pool.p_in_cell,
        distance=distance_along(cell.surface.mesh(), pool.points) if along_surface else None,
        gram=subspace.reduce(grams),
        information=weighted / mean,
        work=subspace.reduce(gram(deflection).mean(axis=0)),
    )
    chosen = select_poses(method, candidates, n, d_max=d_max, seed=seed) if choose is None else choose(pool)
    far = turned(cell, pool.q)
    needed = wanted(far, chosen, turn if choose is None else 0)
    if len(needed) > n:
        raise PlanError(f"{n} poses can't turn the torque of each axis in {turn}: {len(needed)} are needed for that")
    if len(needed) and method == "cover":
        first = np.array(list(dict.fromkeys((*needed.tolist(), central(candidates.points)))))
        chosen = cover(candidates.points, n, d_max, first=first, distance=candidates.distance)
    chosen = exchanged(candidates.points, chosen, needed)
    every = predicted_uncertainty(weighted[chosen].sum(axis=0), subspace, deflection)
    rows = 3 * len(chosen) * len(cell.forces_in_tool)
    reduced = subspace.reduce(grams[chosen].sum(axis=0))
    figures = {
        "poses": len(chosen),
        "cover_distance_m": cover_distance(candidates, chosen),
        "o1": observability(reduced, subspace, rows),
        "rank": subspace.rank,
        "condition": condition_number(grams[chosen].sum(axis=0), subspace.rank),
        "edge_share": edge_share(pool, chosen),
        "nearest_neighbour_ratio": nearest_neighbour_ratio(pool.p_in_cell[chosen], float(cell.surface.mesh().area.sum())),
        "predicted_uncertainty_rms_m": float(np.sqrt(np.mean(every**2))),
        "predicted_uncertainty_max_m": float(every.max()),
    }
    for axis, name in enumerate(cell.robot.joint_names):
        figures[f"turned_{name}"] = int((far[chosen, axis] > SHARE).sum())
        figures[f"turnable_{name}"] = int((far[:, axis] > SHARE).sum())
    return Plan(pool, chosen, method, d_max, seed, every.max(axis=1), figures)


def edge_share(pool: Pool, chosen: IntArray) -> float:
    """Share of the chosen poses that lie in the quarter of the pool nearest the edges: 0.25 for a fair spread."""
    return float(np.mean(pool.edge_distance[chosen] <= np.quantile(pool.edge_distance, 0.25)))


def nearest_neighbour_ratio(points: Array, area: float) -> float:
    """Mean distance to the nearest other pose, over that of as many random points on the area (Clark and Evans 1954).

    Below 1: clustered, above 1: spread out. points: (N, 3), m; area: m^2. NaN for a single pose.
    """
    if len(points) < 2:
        return float("nan")
    gap = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(gap, np.inf)
    return float(gap.min(axis=1).mean() / (0.5 * np.sqrt(area / len(points))))


def _reading_noise(cell: Cell, pool: Pool) -> Array:
    """Standard deviation per coordinate of one tracker reading at each pose of the pool, (n,), m."""
    at = np.array([station.p_in_cell for station in cell.stations])[pool.station]
    distance = np.linalg.norm(pool.p_in_cell - at, axis=1)
    constant = np.hypot(cell.noise["tracker_m"], cell.noise["settling_m"])
    return np.hypot(np.maximum(constant, 1e-7), cell.noise["tracker_m_per_m"] * distance)


def pose_list(cell: Cell, plan: Plan) -> PoseList:
    """The chosen poses as they are written to the pose file."""
    pool = plan.pool
    quaternion = Rotation.from_matrix(pool.R_in_base[plan.chosen]).as_quat()
    poses = tuple(
        EngagementPose(
            index=number,
            q=pool.q[i],
            ext={} if cell.rail is None else {"rail": float(pool.rail[i])},
            p_tool_in_base=pool.p_in_base[i],
            quat_tool_in_base=quaternion[number - 1],
            normal_in_base=pool.normal_in_base[i],
            approach_distance=cell.approach_distance,
            station=cell.stations[pool.station[i]].name,
        )
        for number, i in enumerate(plan.chosen, start=1)
    )
    about = {
        "method": plan.method,
        "seed": plan.seed,
        "d_max_m": plan.d_max,
        "pool": len(pool),
        "drawn": pool.drawn,
        "rejected": {name: count for name, count in pool.rejected.items() if count},
        "figures": {name: float(f"{value:.6g}") for name, value in plan.figures.items()},
    }
    return PoseList(cell.name, cell.serial, cell.robot.sha256, cell.robot.joint_names, poses, about)
