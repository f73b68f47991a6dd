# SPDX-License-Identifier: Apache-2.0
"""The checks of configurations against a cell: joint limits, singularities, clearance, line of sight, torques, the way there."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..cell import Cell
from ..robot import Kinematics
from ..typing import Array, BoolArray, IntArray
from .ik import Chain, solve_pose

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
ACCEPTED = len(REASONS)
_WAY_STEPS = 32  # configurations between HOME and an approach pose that are checked


class Checker:
    """The checks of one cell on configurations; what does not depend on the configuration is kept."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.chain = Chain.of(cell.robot)
        mesh = cell.surface.mesh()
        self._tooling = cKDTree(np.concatenate([mesh.vertices, mesh.vertices[mesh.corners].mean(axis=1)]))
        self._spacing = float(np.sqrt(np.median(mesh.area)))

    def check(self, q: Array, converged: BoolArray, rail: Array, normal: Array) -> tuple[IntArray, IntArray, Kinematics]:
        """Index of the first check that each configuration fails (ACCEPTED: none), the station that sees it."""
        cell, robot = self.cell, self.cell.robot
        names = list(REASONS)
        result = np.full(len(q), ACCEPTED)
        kin = robot.kinematics(q)
        base = cell.base_in_cell(rail)
        margin = np.where(kin.is_prismatic, 0.0, cell.joint_margin)
        inside = ((q >= robot.lower + margin) & (q <= robot.upper - margin)).all(axis=1)
        station, visible = self.line_of_sight(kin, base, normal)
        failures = {
            "torque": overloaded(cell, q, kin),
            "line_of_sight": ~visible,
            "clearance": self.touching(kin, base),
            "singularity": self._singular(kin),
            "joint_limits": ~inside,
            "reach": ~converged,
        }
        for name, fails in failures.items():  # last to first: the first failure of each row remains
            result[fails] = names.index(name)
        good = np.flatnonzero(result == ACCEPTED)
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

    def touching(self, kin: Kinematics, base: Array) -> BoolArray:
        """Whether hull or arm come closer to the tooling than the clearance, (n,); base (n, 3), m: base_link in the cell."""
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
            free &= (segment_distance(marker[:, None], ray[:, None], a, b - a) > self.cell.arm_radius).all(axis=1)
            share = np.linspace(0.02, 1.0, 60)
            on_ray = marker[:, None] + share[:, None] * ray[:, None]
            # the marker itself is closer to the surface than the mesh is fine: only look further along the ray
            blocked = (self._tooling.query(on_ray)[0] < 0.5 * self._spacing) & (share * length[:, None] > 3 * self._spacing)
            sine = np.sum(ray * normal, axis=1) / length
            free &= ~blocked.any(axis=1) & (sine > 0.05)
            elevation[i, free] = sine[free]
        best = np.argmax(elevation, axis=0)
        return best, elevation.max(axis=0) > 0.0


def overloaded(cell: Cell, q: Array, kin: Kinematics) -> BoolArray:
    """Whether a load case of the cell needs more than the continuous torque of an axis at joint angles (n, k), rad: (n,)."""
    force = np.einsum("nij,mj->nmi", kin.R_tool, cell.forces_in_tool)
    process = np.einsum("nik,nmi->nmk", kin.jacobian(kin.p_tcp), force)
    gravity = cell.robot.gravity_torque(q, payload=cell.payload)
    worst = np.maximum(np.abs(process + gravity[:, None]).max(axis=1), np.abs(gravity))
    return np.asarray((worst > cell.continuous_torque).any(axis=1))


def _distance_to_segment(p: Array, start: Array, ray: Array) -> Array:
    """Distance of points p to segments start .. start + ray, all (..., 3), m."""
    share = np.sum((p - start) * ray, axis=-1) / np.maximum(np.sum(ray * ray, axis=-1), 1e-12)
    return np.linalg.norm(p - start - np.clip(share, 0.0, 1.0)[..., None] * ray, axis=-1)


def segment_distance(p: Array, u: Array, q: Array, v: Array) -> Array:
    """Distance between segments p .. p + u and q .. q + v, all (..., 3), m."""
    uu, vv, uv = np.sum(u * u, -1), np.maximum(np.sum(v * v, -1), 1e-12), np.sum(u * v, -1)
    w = p - q
    s = np.clip((uv * np.sum(v * w, -1) - vv * np.sum(u * w, -1)) / np.maximum(uu * vv - uv * uv, 1e-12), 0.0, 1.0)
    t = np.clip((uv * s + np.sum(v * w, -1)) / vv, 0.0, 1.0)
    s = np.clip((uv * t - np.sum(u * w, -1)) / np.maximum(uu, 1e-12), 0.0, 1.0)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
