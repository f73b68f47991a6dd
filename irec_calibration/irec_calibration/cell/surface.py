# SPDX-License-Identifier: Apache-2.0
"""Tooling surfaces on which the robot is engaged: an analytic double-curvature patch, a block, a triangle mesh.

Every surface offers the same three things: points uniform on its area, a triangle mesh of itself, and (through the
mesh) distances along it. All positions are in the cell frame, in m; normals are unit vectors that point out of the tooling.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ..errors import PlanError
from ..files import one_line, read_bytes
from ..typing import Array, IntArray

_MESH_STEP = 0.04  # m, edge of the triangles that stand for an analytic surface
_MOST_TRIANGLES = 200_000
LARGEST, SMALLEST = 60.0, 0.01  # m, extent of a tooling
MESH_LIMIT = 300_000_000  # bytes


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a surface: positions (n, 3), outward unit normals (n, 3), distance to the nearest edge (n,), m."""

    p: Array
    normal: Array
    edge_distance: Array


@dataclass(frozen=True)
class TriangleMesh:
    """Vertices (v, 3) in the cell frame, m; corner indices (m, 3), counter-clockwise seen from outside."""

    vertices: Array
    corners: IntArray

    @cached_property
    def _cross(self) -> Array:
        a, b, c = (self.vertices[self.corners[:, i]] for i in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def area(self) -> Array:
        """Area of each triangle, shape (m,), m^2."""
        return 0.5 * np.linalg.norm(self._cross, axis=1)

    @cached_property
    def normal(self) -> Array:
        """Unit normal of each triangle, shape (m, 3)."""
        return self._cross / np.maximum(2 * self.area, 1e-300)[:, None]

    @cached_property
    def vertex_normal(self) -> Array:
        """Unit normal of each vertex (mean of its triangles by area), shape (v, 3)."""
        total = np.zeros_like(self.vertices)
        for i in range(3):
            np.add.at(total, self.corners[:, i], self._cross)
        return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]

    @cached_property
    def sides(self) -> tuple[IntArray, IntArray]:
        """Edges (e, 2) by vertex and the triangles on their two sides (e, 2), -1 where there is none."""
        half = np.sort(np.concatenate([self.corners[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
        owner = np.tile(np.arange(len(self.corners)), 3)
        edges, which = np.unique(half, axis=0, return_inverse=True)
        triangles = np.full((len(edges), 2), -1)
        triangles[which.ravel()[::-1], 0] = owner[::-1]
        triangles[which.ravel(), 1] = owner
        triangles[triangles[:, 0] == triangles[:, 1], 1] = -1
        return edges, triangles

    def sharp_edges(self, angle: float = np.radians(30.0)) -> IntArray:
        """Edges (e, 2) where the mesh ends or bends by more than `angle`."""
        edges, triangles = self.sides
        bend = np.einsum("ij,ij->i", self.normal[triangles[:, 0]], self.normal[triangles[:, 1]])
        return edges[(triangles[:, 1] < 0) | (bend < np.cos(angle))]


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
        xy, corners = _grid(self.size)
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
            uv, triangles = _grid(2 * self.frame(face)[2])
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
    def from_file(
        cls, path: Path, R_in_cell: Array, p_in_cell: Array, scale: float = 1.0, flip: bool = False
    ) -> MeshSurface:
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
        step = max(_MESH_STEP, float(np.sqrt(4.0 * raw.area.sum() / _MOST_TRIANGLES)))
        vertices, corners = _divided(vertices, corners, step)
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


def read_mesh(path: Path) -> tuple[Array, IntArray]:
    """Vertices (v, 3) in the unit of the file and corners (m, 3) of an STL, OBJ, PLY or other file that trimesh reads.

    Raises PlanError: trimesh is missing, or the file is not a mesh of reasonable size.
    """
    try:
        import trimesh
    except ImportError as error:
        raise PlanError(f"{path}: reading a mesh needs trimesh: pip install 'irec_calibration[mesh]'") from error
    kind = path.suffix.lower().lstrip(".")
    if kind in ("step", "stp", "iges", "igs"):
        raise PlanError(f"{path}: {kind.upper()} is no mesh; export STL from the CAD program (deviation 0.1 mm) and name that")
    if kind not in ("stl", "obj", "ply", "off"):
        raise PlanError(f"{path}: meshes are read from .stl, .obj, .ply and .off files")
    data = read_bytes(path, "mesh", PlanError, MESH_LIMIT)
    if kind == "stl" and data[:5] != b"solid" and len(data) < 84 + 50 * int.from_bytes(data[80:84], "little"):
        raise PlanError(f"{path}: announces {int.from_bytes(data[80:84], 'little')} triangles and ends before; it is cut off")
    try:
        # from the bytes alone: no material or texture file that the text names is opened
        raw: Any = trimesh.load(BytesIO(data), file_type=kind, force="mesh", process=False, skip_materials=True)
        vertices: Array = np.array(raw.vertices, dtype=np.float64)
        corners: IntArray = np.array(raw.faces, dtype=np.int64)
    except Exception as error:  # trimesh raises whatever its readers raise
        raise PlanError(f"{path}: not a mesh that can be read: {one_line(str(error))[:200]}") from error
    if corners.size == 0 or corners.ndim != 2 or corners.shape[1] != 3:
        raise PlanError(f"{path}: the mesh has no triangle")
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise PlanError(f"{path}: the corners of the mesh have {vertices.shape[-1]} coordinates, 3 are needed")
    if corners.min() < 0 or corners.max() >= len(vertices) or not np.isfinite(vertices).all() or np.abs(vertices).max() > 1e9:
        raise PlanError(f"{path}: the mesh has corners that are not there or not finite; export it again")
    if len(corners) > 2_000_000:
        raise PlanError(f"{path}: the mesh has {len(corners)} triangles, at most 2000000 are read; export it coarser")
    # corners of neighbours are the same vertex (STL repeats them), so that edges have two sides
    rounded = np.round(vertices / max(np.ptp(vertices), 1e-12), 9)
    _, first, index = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    return vertices[first], index.ravel()[corners].astype(np.int64)


def _divided(vertices: Array, corners: IntArray, step: float) -> tuple[Array, IntArray]:
    """Triangles split at the middle of their longest side until no side is longer than `step`, m; m can't grow without bound."""
    done: list[Array] = []
    triangles = vertices[corners]
    while len(triangles):
        sides = np.linalg.norm(triangles[:, [1, 2, 0]] - triangles, axis=2)
        longest = sides.argmax(axis=1)
        split = sides.max(axis=1) > step
        done.append(triangles[~split])
        if sum(map(len, done)) + int(split.sum()) > 8 * _MOST_TRIANGLES:
            done.append(triangles[split])
            break
        rows, k = np.flatnonzero(split), longest[split]
        a, b, c = (triangles[rows, (k + i) % 3] for i in range(3))
        middle = 0.5 * (a + b)
        triangles = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    out = np.concatenate(done)
    return out.reshape(-1, 3), np.arange(3 * len(out)).reshape(-1, 3)


def facing_share(mesh: TriangleMesh, points: Array) -> tuple[float, float]:
    """Shares of the area that face at least one of the points (k, 3) with their outward and with their inward side."""
    centre = mesh.vertices[mesh.corners].mean(axis=1)
    ahead = np.einsum("mkj,mj->mk", points[None] - centre[:, None], mesh.normal)
    area = mesh.area / mesh.area.sum()
    return float(area[(ahead > 0).any(axis=1)].sum()), float(area[(ahead < 0).any(axis=1)].sum())


def _grid(size: Array | tuple[float, float]) -> tuple[Array, IntArray]:
    """Vertices (v, 2) and triangles (m, 3) of a rectangle centred on 0, counter-clockwise."""
    nx, ny = (max(2, int(np.ceil(extent / _MESH_STEP)) + 1) for extent in size)
    x, y = (np.linspace(-extent / 2, extent / 2, k) for extent, k in zip(size, (nx, ny), strict=True))
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    a = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
    corners = np.concatenate([np.column_stack([a, a + ny, a + ny + 1]), np.column_stack([a, a + ny + 1, a + 1])])
    return xy, corners


def distance_along(mesh: TriangleMesh, points: SurfacePoints) -> Callable[[int], Array]:
    """Distances along a surface: a function of the index of one point, returning those to all points, shape (n,), m.

    Shortest paths in the graph of mesh vertices and points (Dijkstra). Vertices are linked by edges and across the edge
    between two triangles, points to everything near on the same side. Overestimates by a few per cent, never below
    the straight line.
    """
    vertices, n = mesh.vertices, len(points.p)
    edges, triangles = mesh.sides
    inner = triangles[:, 1] >= 0
    opposite = mesh.corners[triangles[inner]].sum(axis=2) - edges[inner].sum(axis=1)[:, None]
    links = np.concatenate([edges, opposite]) + n
    reach = 2.0 * np.median(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1))
    nodes = np.concatenate([points.p, vertices])
    normals = np.concatenate([points.normal, mesh.vertex_normal])
    near = cKDTree(points.p).query_ball_tree(cKDTree(nodes), reach)
    first = np.repeat(np.arange(n), [len(found) for found in near])
    second = np.concatenate([np.asarray(found, dtype=int) for found in near])
    same_side = np.einsum("ij,ij->i", normals[first], normals[second]) > 0.5
    keep = same_side & (first != second)
    links = np.concatenate([links, np.column_stack([first, second])[keep]])
    links = np.unique(np.sort(links, axis=1), axis=0)
    length = np.linalg.norm(nodes[links[:, 0]] - nodes[links[:, 1]], axis=1)
    graph = coo_matrix((length, links.T), shape=(len(nodes), len(nodes))).tocsr()
    return lambda index: dijkstra(graph, directed=False, indices=index)[:n]
