# SPDX-License-Identifier: Apache-2.0
"""Candidate engagement configurations on the tooling of a cell (the pool Omega of the paper, 3.1).

Points are drawn uniformly on the area. For each, several attempts with a random rail position and a random start (which decides
the rotation about tool z) look for a configuration that passes every check; what the best attempt failed is the reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cell import Cell
from ..cell.surface import SurfacePoints
from ..errors import PlanError
from ..typing import Array, IntArray
from .checker import ACCEPTED, REASONS, Checker
from .ik import solve_tool_axis, wrap_into_limits

_ATTEMPTS = 24


@dataclass(frozen=True)
class Pool:
    """Accepted candidates, n of them, and what became of the others.

    q: joint angles, (n, k), rad. rail: position of the rail, (n,), m; zeros without one.
    p_in_base, R_in_base: tool0 in base_link at contact, (n, 3) m and (n, 3, 3). normal_in_base: (n, 3).
    p_in_cell, normal_in_cell: contact point and outward surface normal in the cell frame, (n, 3).
    station: index of the tracker station that sees the marker best, (n,).
    drawn: number of points drawn on the surface. rejected: reason -> count, in the order of REASONS.
    p_rejected: rejected points in the cell frame, (m, 3); reason_rejected: index into REASONS, (m,).
    """

    q: Array
    rail: Array
    p_in_base: Array
    R_in_base: Array
    normal_in_base: Array
    p_in_cell: Array
    normal_in_cell: Array
    edge_distance: Array
    station: IntArray
    drawn: int
    rejected: dict[str, int]
    p_rejected: Array
    reason_rejected: IntArray

    def __len__(self) -> int:
        return len(self.q)

    @property
    def points(self) -> SurfacePoints:
        return SurfacePoints(self.p_in_cell, self.normal_in_cell, self.edge_distance)

    def counts(self) -> str:
        """One line: how many were drawn, accepted, and rejected for which reason."""
        reasons = ", ".join(f"{name} {count}" for name, count in self.rejected.items() if count)
        return f"{self.drawn} drawn, {len(self)} accepted; rejected: {reasons or 'none'}"


def generate_pool(cell: Cell, size: int = 3000, seed: int = 1) -> Pool:
    """Draw points until `size` are accepted, at most 3 times as many as wanted.

    Raises PlanError: not a single point can be engaged; the message holds the counts by reason.
    """
    if size < 1:
        raise PlanError(f"a pool of {size} candidates was asked for, at least 1 is needed")
    rng = np.random.default_rng(seed)
    checker = Checker(cell)
    parts: list[dict[str, Array]] = []
    drawn = 0
    while drawn < 3 * size:
        accepted = sum(int(np.sum(part["level"] == ACCEPTED)) for part in parts)
        if accepted >= size:
            break
        share = max(accepted / drawn, 0.2) if drawn else 1.0
        count = min(int(np.ceil((size - accepted) / share)) + 8 * (drawn > 0), 3 * size - drawn)
        parts.append(_engage(cell, checker, cell.surface.sample(count, rng), rng))
        drawn += count
    found = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    good = np.flatnonzero(found["level"] == ACCEPTED)
    drawn = len(found["level"])
    if len(good) > size:  # the last points drawn are not needed: leave them out of all counts
        drawn, good = int(good[size - 1]) + 1, good[:size]
    level = found["level"][:drawn]
    bad = np.flatnonzero(level < ACCEPTED)
    rejected = {name: int(np.sum(level == i)) for i, name in enumerate(REASONS)}
    pool = Pool(
        **{k: found[k][good] for k in ("q", "rail", "p_in_base", "R_in_base", "p_in_cell", "edge_distance", "station")},
        normal_in_base=found["normal"][good],
        normal_in_cell=found["normal"][good],
        drawn=drawn,
        rejected=rejected,
        p_rejected=found["p_in_cell"][bad],
        reason_rejected=level[bad].astype(int),
    )
    if len(good) == 0:
        meaning = "; ".join(f"{n}: {REASONS[n]}" for n, count in rejected.items() if count)
        raise PlanError(
            f"{cell.path}: the robot can engage no point of the surface ({pool.counts()}). {meaning}. "
            "Move the surface or the robot, or widen the limits in the cell file"
        )
    return pool


def _engage(cell: Cell, checker: Checker, points: SurfacePoints, rng: np.random.Generator) -> dict[str, Array]:
    """Try to engage every point; level[i] is the index of the check that stopped it, ACCEPTED when none did."""
    n, k = len(points.p), cell.robot.n_joints
    names = list(REASONS)
    level = np.full(n, names.index("reach"))
    level[points.edge_distance < cell.pad_radius] = names.index("edge")
    slips = _slips(cell.forces_in_tool, cell.friction)
    if slips:
        level[level != names.index("edge")] = names.index("friction")
    q, rail = np.zeros((n, k)), np.zeros(n)
    station = np.zeros(n, dtype=int)
    R_tool, p_tool = np.zeros((n, 3, 3)), np.zeros((n, 3))
    lowest, highest = _start_range(cell)
    for attempt in range(_ATTEMPTS):
        todo = np.flatnonzero((level >= names.index("reach")) & (level < ACCEPTED))
        if len(todo) == 0:
            break
        spread = 0.6 if attempt < _ATTEMPTS // 2 else 1.5
        start = cell.home + spread * rng.normal(size=(len(todo), k))
        start[:, -1] = rng.uniform(lowest[-1], highest[-1], size=len(todo))
        start = np.clip(start, lowest, highest)
        at = _rail_guess(cell, points.p[todo], rng)
        wanted = points.p[todo] - cell.base_in_cell(at)
        found, converged = solve_tool_axis(checker.chain, wanted, -points.normal[todo], start, rest=_rest(cell, start, attempt))
        found = wrap_into_limits(found, cell.robot.lower, cell.robot.upper, checker.chain.is_prismatic)
        reached, seen_by, kin = checker.check(found, converged, at, points.normal[todo])
        better = reached > level[todo]
        level[todo[better]] = reached[better]
        take = todo[reached == ACCEPTED]
        mask = reached == ACCEPTED
        q[take], rail[take], station[take] = found[mask], at[mask], seen_by[mask]
        R_tool[take], p_tool[take] = kin.R_tool[mask], kin.p_tcp[mask]
    return {
        "level": level, "q": q, "rail": rail, "station": station, "R_in_base": R_tool, "p_in_base": p_tool,
        "p_in_cell": points.p, "normal": points.normal, "edge_distance": points.edge_distance,
    }  # fmt: skip


def _slips(forces_in_tool: Array, friction: float) -> bool:
    """Whether a load case leaves the friction cone about tool z (which is the surface normal)."""
    lateral = np.hypot(forces_in_tool[:, 0], forces_in_tool[:, 1])
    return bool(np.any(lateral > friction * np.abs(forces_in_tool[:, 2])))


def _start_range(cell: Cell) -> tuple[Array, Array]:
    lower, upper = cell.robot.lower, cell.robot.upper
    return np.maximum(lower, -np.pi) + cell.joint_margin, np.minimum(upper, np.pi) - cell.joint_margin


def _rest(cell: Cell, start: Array, attempt: int) -> Array | None:
    """Where a redundant robot (seven axes and more) is drawn to while its tool stays: HOME, then the middle, then the start."""
    if cell.robot.n_joints <= 6:
        return None  # what is free, the rotation about tool z, is left to chance
    if attempt % 3 == 2:
        return start
    lower, upper = _start_range(cell)
    return np.tile(cell.home if attempt % 3 == 0 else 0.5 * (lower + upper), (len(start), 1))


def _rail_guess(cell: Cell, p_in_cell: Array, rng: np.random.Generator) -> Array:
    """A random rail position for each point, rather where the base stands abreast of it, (n,), m."""
    if cell.rail is None:
        return np.zeros(len(p_in_cell))
    abreast = p_in_cell @ cell.rail.axis + 0.3 * rng.normal(size=len(p_in_cell))
    anywhere = rng.uniform(cell.rail.lower, cell.rail.upper, size=len(p_in_cell))
    inside = (abreast >= cell.rail.lower) & (abreast <= cell.rail.upper)
    return np.where(inside, abreast, anywhere)
