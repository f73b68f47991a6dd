# SPDX-License-Identifier: Apache-2.0
"""Tooling surfaces on which the robot is engaged: an analytic double-curvature patch, a block, a triangle mesh.

Every surface offers the same three things: points uniform on its area, a triangle mesh of itself, and (through the
mesh) distances along it. All positions are in the cell frame, in m; normals are unit vectors that point out of the tooling.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from ..errors import PlanError
from ..typing import Array, IntArray
from .mesh import MOST_TRIANGLES, STEP, TriangleMesh, divided, grid, read_mesh

LARGEST, SMALLEST = 60.0, 0.01  # m, extent of a tooling


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a surface: positions (n, 3), outward unit normals (n, 3), distance to the nearest edge (n,), m."""

    p: Array
    normal: Array
    edge_distance: Array


class Surface(Protocol):
    """What pose planning needs of a surface."""

    def sample(self, n: int, rng: np.random.Generator) -> SurfacePoints:
        """n random points, uniform on the area."""

    def mesh(self) -> TriangleMesh:
        """The surface as triangles of a few centimetres."""


@dataclass(frozen=True)
class Patch:
    """Double-curvature patch: z = -x^2/(2 rx) - y^2/(2 ry) over a rectangle centred on the apex, z outward.

    size: extent along local x and y, m. radius: rx, ry of curvature at the apex, m; negative is concave.
    R_in_cell (3, 3), p_in_cell (3,): pose of the apex frame in the cell frame.
    """

    size: tuple[float, float]
    radius: tuple[float, float]
    R_in_cell: Array
    p_in_cell: Array

    def _slope(self, xy: Array) -> Array:
        return -xy / np.asarray(self.radius)

    def place(self, xy: Array) -> tuple[Array, Array]:
        """Points (n, 3), m, and outward normals (n, 3) in the cell frame of local coordinates (n, 2), m."""
        z = 0.5 * np.sum(xy * self._slope(xy), axis=1)
        normal = np.column_stack([-self._slope(xy), np.ones(len(xy))])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return np.column_stack([xy, z]) @ self.R_in_cell.T + self.p_in_cell, normal @ self.R_in_cell.T

    def sample(self, n: int, rng: np.random.Generator) -> SurfacePoints:
        half = 0.5 * np.asarray(self.size)
        largest = np.sqrt(1.0 + np.sum(self._slope(half) ** 2))
        kept: list[Array] = []
        while sum(map(len, kept)) < n:
            xy = rng.uniform(-half, half, size=(n + 16, 2))
            stretch = np.sqrt(1.0 + np.sum(self._slope(xy) ** 2, axis=1))
            kept.append(xy[rng.uniform(size=len(xy)) * largest <= stretch])
        xy = np.concatenate(kept)[:n]
        p, normal = self.place(xy)
        return SurfacePoints(p, normal, np.min(half - np.abs(xy), axis=1))

    def mesh(self) -> TriangleMesh:
        xy, corners = grid(self.size)
        return TriangleMesh(self.place(xy)[0], corners)


_FACES = {f"{sign}{axis}": (i, s) for i, axis in enumerate("xyz") for sign, s in (("+", 1), ("-", -1))}


@dataclass(frozen=True)
class Block:
    """Faces of a cuboid. size: along local x, y, z, m. faces: those to press on, of +x -x +y -y +z -z, local frame.

    R_in_cell (3, 3), p_in_cell (3,): pose of its centre in the cell frame.
    """

    size: tuple[float, float, float]
    faces: tuple[str, ...]
    R_in_cell: Array
    p_in_cell: Array

    def frame(self, face: str) -> tuple[Array, Array, Array]:
        """Local u, v (2, 3), outward normal (3,) and half extents along u, v (2,) of a face; u x v = normal."""
        axis, sign = _FACES[face]
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        if sign < 0:
            u, v = v, u
        half = 0.5 * np.asarray(self.size)
        return np.array([u, v]), sign * np.eye(3)[axis], np.array([u @ half, v @ half])

    def place(self, face: str, uv: Array) -> Array:
        """Points (n, 3), m, in the cell frame of coordinates (n, 2) on a face, m."""
        axes, normal, _ = self.frame(face)
        local = uv @ axes + normal * (0.5 * np.asarray(self.size) @ np.abs(normal))
        return local @ self.R_in_cell.T + self.p_in_cell

    def sample(self, n: int, rng: np.random.Generator) -> SurfacePoints:
        halves = np.array([self.frame(face)[2] for face in self.faces])
        area = halves.prod(axis=1)
        which = rng.choice(len(self.faces), size=n, p=area / area.sum())
        uv = rng.uniform(-1.0, 1.0, size=(n, 2)) * halves[which]
        p, normal = np.empty((n, 3)), np.empty((n, 3))
        for i, face in enumerate(self.faces):
            p[which == i] = self.place(face, uv[which == i])
            normal[which == i] = self.R_in_cell @ self.frame(face)[1]
        return SurfacePoints(p, normal, np.min(halves[which] - np.abs(uv), axis=1))

    def mesh(self) -> TriangleMesh:
        vertices: list[Array] = []
        corners: list[IntArray] = []
        for face in self.faces:
            uv, triangles = grid(2 * self.frame(face)[2])
            corners.append(triangles + sum(map(len, vertices)))
            vertices.append(self.place(face, uv))
        # faces share their vertices along common edges, so that a path along the surface may go over an edge
        merged, index = np.unique(np.round(np.concatenate(vertices), 9), axis=0, return_inverse=True)
        return TriangleMesh(merged.astype(float), index.ravel()[np.concatenate(corners)])


@dataclass(frozen=True)
class MeshSurface:
    """A triangle mesh; points lie on its flat triangles. triangles: in the cell frame."""

    triangles: TriangleMesh

    @classmethod
    def from_file(cls, path: Path, R_in_cell: Array, p_in_cell: Array, scale: float = 1.0, flip: bool = False) -> MeshSurface:
        """Read STL, OBJ or what else trimesh reads. scale: metres per unit of the file (0.001 for mm). flip: turn normals.

        Raises PlanError: trimesh is not installed, the file can't be read or holds no triangle, it is in other units than stated,
        or its normals point into a closed body.
        """
        vertices, corners = read_mesh(path)
        vertices = vertices * scale
        extent = float(np.ptp(vertices, axis=0).max())
        if extent > LARGEST or extent < SMALLEST:
            better = {"0.001 (millimetres)": 1e-3, "0.0254 (inches)": 0.0254, "1 (metres)": 1.0}
            fits = [name for name, value in better.items() if 0.05 <= extent / scale * value <= 20.0 and value != scale]
            raise PlanError(
                f"{path}: the mesh is {extent:.4g} m large with scale {scale:g} (between {SMALLEST:g} and {LARGEST:g} m is"
                f" possible); {'write scale: ' + fits[0] if fits else 'state its scale, metres per unit of the file'}"
            )
        if flip:
            corners = corners[:, ::-1]
        raw = TriangleMesh(vertices, corners)
        if (raw.sides[1][:, 1] >= 0).all():  # closed: inside and outside are known
            a, b, c = (vertices[corners[:, i]] - vertices.mean(axis=0) for i in range(3))
            if np.einsum("ij,ij->i", a, np.cross(b, c)).sum() < 0:
                other = "false" if flip else "true"
                raise PlanError(f"{path}: the normals of the closed mesh point inwards; write flip: {other} at the surface")
        step = max(STEP, float(np.sqrt(4.0 * raw.area.sum() / MOST_TRIANGLES)))
        vertices, corners = divided(vertices, corners, step)
        merged, index = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
        corners = index.ravel()[corners].reshape(-1, 3)
        corners = corners[(corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])]
        if len(corners) == 0:
            raise PlanError(f"{path}: the mesh has no triangle with an area")
        mesh = TriangleMesh(merged @ R_in_cell.T + p_in_cell, corners)
        return cls(TriangleMesh(mesh.vertices, corners[mesh.area > 1e-14]))

    def sample(self, n: int, rng: np.random.Generator) -> SurfacePoints:
        mesh = self.triangles
        which = rng.choice(len(mesh.area), size=n, p=mesh.area / mesh.area.sum())
        a, b = np.sqrt(rng.uniform(size=n)), rng.uniform(size=n)
        weight = np.column_stack([1 - a, a * (1 - b), a * b])
        p = np.einsum("nk,nkj->nj", weight, mesh.vertices[mesh.corners[which]])
        ends = mesh.vertices[mesh.sharp_edges()]
        if len(ends) == 0:
            return SurfacePoints(p, mesh.normal[which], np.full(n, np.inf))
        along = np.linspace(0.0, 1.0, 9)[:, None, None]
        border = ((1 - along) * ends[:, 0] + along * ends[:, 1]).reshape(-1, 3)
        return SurfacePoints(p, mesh.normal[which], cKDTree(border).query(p)[0])

    def mesh(self) -> TriangleMesh:
        return self.triangles
