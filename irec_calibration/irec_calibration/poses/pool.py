# SPDX-License-Identifier: Apache-2.0
"""Candidate engagement configurations on the tooling of a cell (the pool Omega of the paper, 3.1).

Points are drawn uniformly on the area. For each, several attempts with a random rail position and a random start (which decides
the rotation about tool z) look for a configuration that passes every check; what the best attempt failed is the reason.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..cell import Cell
from ..cell.surface import SurfacePoints
from ..errors import PlanError
from ..robot import Kinematics
from ..typing import Array, BoolArray, IntArray
from .ik import Chain, solve_pose, solve_tool_axis, wrap_into_limits

# In the order of the checks; a candidate is counted under the last one that any of its attempts got to.
REASONS = {
    "edge": "contact pad would overhang an edge of the surface",
    "friction": "a load case would slip on the surface",
    "reach": "no joint angles reach the point with tool z normal to the surface",
    "joint_limits": "reached only outside the joint limits",
    "singularity": "too close to a singularity",
    "clearance": "tool or arm would touch the tooling",
    "line_of_sight": "no tracker station sees the marker",
    "torque": "a load case needs more than the continuous torque of an axis",
    "approach": "the approach pose is out of reach or outside the joint limits",
    "way": "on the way from HOME to the approach pose the tool would come too close to the tooling",
}
_ATTEMPTS = 24
_ACCEPTED = len(REASONS)
_WAY_STEPS = 32  # configurations between HOME and an approach pose that are checked


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
        accepted = sum(int(np.sum(part["level"] == _ACCEPTED)) for part in parts)
        if accepted >= size:
            break
        share = max(accepted / drawn, 0.2) if drawn else 1.0
        count = min(int(np.ceil((size - accepted) / share)) + 8 * (drawn > 0), 3 * size - drawn)
        parts.append(_engage(cell, checker, cell.surface.sample(count, rng), rng))
        drawn += count
    found = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    good = np.flatnonzero(found["level"] == _ACCEPTED)
    drawn = len(found["level"])
    if len(good) > size:  # the last points drawn are not needed: leave them out of all counts
        drawn, good = int(good[size - 1]) + 1, good[:size]
    level = found["level"][:drawn]
    bad = np.flatnonzero(level < _ACCEPTED)
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
    """Try to engage every point; level[i] is the index of the check that stopped it, _ACCEPTED when none did."""
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
        todo = np.flatnonzero((level >= names.index("reach")) & (level < _ACCEPTED))
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
        take = todo[reached == _ACCEPTED]
        mask = reached == _ACCEPTED
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


class Checker:
    """The checks of one cell on configurations; what does not depend on the configuration is kept."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.chain = Chain.of(cell.robot)
        mesh = cell.surface.mesh()
        self._tooling = cKDTree(np.concatenate([mesh.vertices, mesh.vertices[mesh.corners].mean(axis=1)]))
        self._spacing = float(np.sqrt(np.median(mesh.area)))

    def check(self, q: Array, converged: BoolArray, rail: Array, normal: Array) -> tuple[IntArray, IntArray, Kinematics]:
        """Index of the first check that each configuration fails (_ACCEPTED: none), the station that sees it."""
        cell, robot = self.cell, self.cell.robot
        names = list(REASONS)
        result = np.full(len(q), _ACCEPTED)
        kin = robot.kinematics(q)
        base = cell.base_in_cell(rail)
        margin = np.where(kin.is_prismatic, 0.0, cell.joint_margin)
        inside = ((q >= robot.lower + margin) & (q <= robot.upper - margin)).all(axis=1)
        station, visible = self.line_of_sight(kin, base, normal)
        failures = {
            "torque": self._overloaded(q, kin),
            "line_of_sight": ~visible,
            "clearance": self._touches(kin, base),
            "singularity": self._singular(kin),
            "joint_limits": ~inside,
            "reach": ~converged,
        }
        for name, fails in failures.items():  # last to first: the first failure of each row remains
            result[fails] = names.index(name)
        good = np.flatnonzero(result == _ACCEPTED)
        q_approach, reached = self.approach(q[good], kin.p_tcp[good], kin.R_tool[good])
        result[good[~reached]] = names.index("approach")
        blocked = reached & self._way_touches(q_approach, rail[good])
        result[good[blocked]] = names.index("way")
        return result, station, kin

    def approach(self, q: Array, p_tcp: Array, R_tool: Array) -> tuple[Array, BoolArray]:
        """Joint angles of the approach poses of contacts q (n, k), and whether the robot reaches them, (n,)."""
        robot = self.cell.robot
        found, converged = solve_pose(self.chain, p_tcp - self.cell.approach_distance * R_tool[:, :, 2], R_tool, q)
        margin = np.where(robot.is_prismatic, 0.0, self.cell.joint_margin)
        return found, converged & ((found >= robot.lower + margin) & (found <= robot.upper - margin)).all(axis=1)

    def _way_touches(self, q_approach: Array, rail: Array) -> BoolArray:
        """Whether the tool comes too close to the tooling between HOME and approach, wherever the rail comes from, (n,)."""
        cell = self.cell
        share = np.linspace(0.0, 1.0, _WAY_STEPS)[:, None]
        q = (cell.home + share[:, :, None] * (q_approach - cell.home)).reshape(-1, cell.robot.n_joints)
        p, R, _ = self.chain.forward(q)
        # the disc at the TCP is no part of the hull, since it has to touch in the end
        spheres = np.vstack([cell.hull, [0.0, 0.0, 0.0, max(cell.pad_radius, self._spacing)]])
        centres = p[:, None] + np.einsum("nij,sj->nsi", R, spheres[:, :3])
        limit = spheres[:, 3] + cell.clearance
        starts: list[Array | float] = [rail] if cell.rail is None else [rail, cell.rail.lower, cell.rail.upper]
        touches = np.zeros(len(rail), dtype=bool)
        for start in starts:
            base = cell.base_in_cell((start + share * (rail - start)).ravel())
            near = self._tooling.query(centres + base[:, None], distance_upper_bound=limit.max())[0] < limit
            touches |= near.any(axis=1).reshape(_WAY_STEPS, -1).any(axis=0)
        return touches

    def _singular(self, kin: Kinematics) -> BoolArray:
        angular = np.where(kin.is_prismatic[:, None], 0.0, kin.axis)
        J = np.concatenate([kin.jacobian(kin.p_tcp), angular.swapaxes(1, 2)], axis=1)
        return np.linalg.svd(J, compute_uv=False)[:, -1] < self.cell.singularity

    def _overloaded(self, q: Array, kin: Kinematics) -> BoolArray:
        force = np.einsum("nij,mj->nmi", kin.R_tool, self.cell.forces_in_tool)
        process = np.einsum("nik,nmi->nmk", kin.jacobian(kin.p_tcp), force)
        gravity = self.cell.robot.gravity_torque(q, payload=self.cell.payload)
        worst = np.maximum(np.abs(process + gravity[:, None]).max(axis=1), np.abs(gravity))
        return (worst > self.cell.continuous_torque).any(axis=1)

    def _hull(self, kin: Kinematics, base: Array) -> Array:
        """Centres of the hull spheres in the cell frame, (n, s, 3), m."""
        tcp = kin.p_tcp + base
        return tcp[:, None] + np.einsum("nij,sj->nsi", kin.R_tool, self.cell.hull[:, :3])

    def _arm(self, kin: Kinematics, base: Array) -> tuple[Array, Array]:
        """Ends of the arm's links in the cell frame, (n, l, 3) each: between joint origins more than 0.3 m apart."""
        origin = kin.origin + base[:, None]
        ends = [(i, i + 1) for i in range(1, origin.shape[1] - 1)]
        long = [e for e in ends if np.median(np.linalg.norm(origin[:, e[1]] - origin[:, e[0]], axis=1)) > 0.3]
        return origin[:, [e[0] for e in long]], origin[:, [e[1] for e in long]]

    def _touches(self, kin: Kinematics, base: Array) -> BoolArray:
        cell = self.cell
        distance = self._tooling.query(self._hull(kin, base))[0]
        touches = (distance < cell.hull[:, 3] + cell.clearance).any(axis=1)
        a, b = self._arm(kin, base)
        along = np.linspace(0.0, 1.0, 9)[:, None, None, None]
        beads = ((1 - along) * a + along * b).reshape(-1, len(base), a.shape[1], 3)
        near = self._tooling.query(beads)[0] < cell.arm_radius + cell.clearance
        return touches | near.any(axis=(0, 2))

    def line_of_sight(self, kin: Kinematics, base: Array, normal: Array) -> tuple[IntArray, BoolArray]:
        marker = kin.p_tcp + base + kin.R_tool @ self.cell.marker_in_tool
        hull, (a, b) = self._hull(kin, base), self._arm(kin, base)
        elevation = np.full((len(self.cell.stations), len(base)), -1.0)
        for i, station in enumerate(self.cell.stations):
            ray = station.p_in_cell - marker
            length = np.linalg.norm(ray, axis=1)
            clear = _distance_to_segment(hull, marker[:, None], ray[:, None]) > self.cell.hull[:, 3]
            free = clear.all(axis=1)
            free &= (_segment_distance(marker[:, None], ray[:, None], a, b - a) > self.cell.arm_radius).all(axis=1)
            share = np.linspace(0.02, 1.0, 60)
            on_ray = marker[:, None] + share[:, None] * ray[:, None]
            # the marker itself is closer to the surface than the mesh is fine: only look further along the ray
            blocked = (self._tooling.query(on_ray)[0] < 0.5 * self._spacing) & (share * length[:, None] > 3 * self._spacing)
            sine = np.sum(ray * normal, axis=1) / length
            free &= ~blocked.any(axis=1) & (sine > 0.05)
            elevation[i, free] = sine[free]
        best = np.argmax(elevation, axis=0)
        return best, elevation.max(axis=0) > 0.0


def _distance_to_segment(p: Array, start: Array, ray: Array) -> Array:
    """Distance of points p to segments start .. start + ray, all (..., 3), m."""
    share = np.sum((p - start) * ray, axis=-1) / np.maximum(np.sum(ray * ray, axis=-1), 1e-12)
    return np.linalg.norm(p - start - np.clip(share, 0.0, 1.0)[..., None] * ray, axis=-1)


def _segment_distance(p: Array, u: Array, q: Array, v: Array) -> Array:
    """Distance between segments p .. p + u and q .. q + v, all (..., 3), m."""
    uu, vv, uv = np.sum(u * u, -1), np.maximum(np.sum(v * v, -1), 1e-12), np.sum(u * v, -1)
    w = p - q
    s = np.clip((uv * np.sum(v * w, -1) - vv * np.sum(u * w, -1)) / np.maximum(uu * vv - uv * uv, 1e-12), 0.0, 1.0)
    t = np.clip((uv * s + np.sum(v * w, -1)) / vv, 0.0, 1.0)
    s = np.clip((uv * t - np.sum(u * w, -1)) / np.maximum(uu, 1e-12), 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
