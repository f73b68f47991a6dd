# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes: what follows from corners and vertices, division to a size, reading from a file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import PlanError
from ..files import one_line, read_bytes
from ..typing import Array, IntArray

STEP = 0.04  # m, edge of the triangles that stand for an analytic surface
MOST_TRIANGLES = 200_000
MESH_LIMIT = 300_000_000  # bytes


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
        other = "irec init-cell --surface makes one of it; or " if kind in ("step", "stp") else ""
        advice = f"{other}export STL from the CAD program (deviation 0.1 mm) and name that"
        raise PlanError(f"{path}: {kind.upper()} is no mesh; {advice}")
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


def divided(vertices: Array, corners: IntArray, step: float) -> tuple[Array, IntArray]:
    """Triangles split at the middle of their longest side until no side is longer than `step`, m; m can't grow without bound."""
    done: list[Array] = []
    triangles = vertices[corners]
    while len(triangles):
        sides = np.linalg.norm(triangles[:, [1, 2, 0]] - triangles, axis=2)
        longest = sides.argmax(axis=1)
        split = sides.max(axis=1) > step
        done.append(triangles[~split])
        if sum(map(len, done)) + int(split.sum()) > 8 * MOST_TRIANGLES:
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


def grid(size: Array | tuple[float, float]) -> tuple[Array, IntArray]:
    """Vertices (v, 2) and triangles (m, 3) of a rectangle centred on 0, counter-clockwise."""
    nx, ny = (max(2, int(np.ceil(extent / STEP)) + 1) for extent in size)
    x, y = (np.linspace(-extent / 2, extent / 2, k) for extent, k in zip(size, (nx, ny), strict=True))
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    a = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
    corners = np.concatenate([np.column_stack([a, a + ny, a + ny + 1]), np.column_stack([a, a + ny + 1, a + 1])])
    return xy, corners
