# SPDX-License-Identifier: Apache-2.0
"""Tooling given as triangles: reader of STL and OBJ files, and the surface that the robot presses on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .errors import SimError
from .kinematics import Array

MOST_TRIANGLES = 500_000
_NEAR = 24  # triangles looked at for the nearest point
_SPACING = 0.02  # m, between the points by which triangles are found
_SMOOTH = np.cos(np.radians(25.0))  # edges that bend less are facets of a curved surface


@dataclass(frozen=True)
class Mesh:
    """Triangles (m, 3, 3) in the cell frame, m, corners counter-clockwise seen from outside."""

    triangles: Array

    @cached_property
    def normal(self) -> Array:
        """Outward unit normals of the triangles, (m, 3)."""
        a, b, c = self.triangles.swapaxes(0, 1)
        n = np.cross(b - a, c - a)
        return np.asarray(n / np.maximum(np.linalg.norm(n, axis=1), 1e-300)[:, None])

    @cached_property
    def area(self) -> Array:
        """(m,), m^2."""
        a, b, c = self.triangles.swapaxes(0, 1)
        return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))

    @cached_property
    def corner_normal(self) -> Array:
        """Unit normal at each corner, (m, 3, 3): mean of the facets that meet there smoothly, by area."""
        _, vertex = np.unique(np.round(self.triangles.reshape(-1, 3), 7), axis=0, return_inverse=True)
        vertex = vertex.reshape(-1, 3)
        out = np.repeat(self.normal[:, None], 3, axis=1)
        order = np.argsort(vertex.ravel(), kind="stable")
        cuts = np.flatnonzero(np.diff(vertex.ravel()[order])) + 1
        for group in np.split(order, cuts):
            owners = group // 3
            smooth = self.normal[owners] @ self.normal[owners].T > _SMOOTH
            mean = (smooth * self.area[owners]) @ self.normal[owners]
            out[owners, group % 3] = mean / np.linalg.norm(mean, axis=1)[:, None]
        return out

    @cached_property
    def _index(self) -> tuple[cKDTree, NDArray[np.int64]]:
        """Points spread over every triangle and the triangle of each."""
        longest = np.linalg.norm(self.triangles - np.roll(self.triangles, 1, axis=1), axis=2).max(axis=1)
        pieces = np.clip(np.ceil(longest / _SPACING), 1, 60).astype(int)
        points, owner = [], []
        for k in np.unique(pieces):
            which = np.flatnonzero(pieces == k)
            i, j = (v.ravel() for v in np.meshgrid(np.arange(k), np.arange(k), indexing="ij"))
            keep = i + j < k
            u, v = (i[keep] + 1 / 3) / k, (j[keep] + 1 / 3) / k
            weight = np.stack([1 - u - v, u, v], axis=1)
            points.append(np.einsum("sk,mkx->msx", weight, self.triangles[which]).reshape(-1, 3))
            owner.append(np.repeat(which, len(weight)))
        return cKDTree(np.concatenate(points)), np.concatenate(owner)

    def sample(self, n: int, margin: float, rng: np.random.Generator) -> tuple[Array, Array]:
        """n random points and normals, at least `margin` (m) from where the mesh ends."""
        found_p, found_n = [], []
        edges = self._border
        for _ in range(50):
            which = rng.choice(len(self.area), size=4 * n, p=self.area / self.area.sum())
            a, b = np.sqrt(rng.uniform(size=4 * n)), rng.uniform(size=4 * n)
            weight = np.stack([1 - a, a * (1 - b), a * b], axis=1)
            p = np.einsum("nk,nkx->nx", weight, self.triangles[which])
            inside = np.ones(len(p), dtype=bool) if edges is None else edges.query(p)[0] > margin
            found_p.append(p[inside])
            found_n.append(self._smooth_normal(which[inside], weight[inside]))
            if sum(map(len, found_p)) >= n:
                break
        return np.concatenate(found_p)[:n], np.concatenate(found_n)[:n]

    @cached_property
    def _border(self) -> cKDTree | None:
        """Points along the edges where the mesh ends or bends sharply."""
        _, vertex = np.unique(np.round(self.triangles.reshape(-1, 3), 7), axis=0, return_inverse=True)
        vertex = vertex.reshape(-1, 3)
        sides = np.sort(np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
        ends = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=2).reshape(-1, 2, 3)
        _, index, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
        index = index.ravel()
        first, last = np.full(len(count), -1), np.full(len(count), -1)
        first[index[::-1]], last[index] = np.arange(len(index))[::-1] // 3, np.arange(len(index)) // 3
        bend = np.einsum("ij,ij->i", self.normal[first], self.normal[last])
        sharp = ((count == 1) | (bend < _SMOOTH))[index]
        if not sharp.any():
            return None
        along = np.linspace(0.0, 1.0, 17)[:, None, None]
        return cKDTree((ends[sharp, 0] * (1 - along) + ends[sharp, 1] * along).reshape(-1, 3))

    def _smooth_normal(self, which: NDArray[np.int64], weight: Array) -> Array:
        n = np.einsum("nk,nkx->nx", weight, self.corner_normal[which])
        return np.asarray(n / np.linalg.norm(n, axis=1)[:, None])

    def gap(self, p: Array) -> tuple[float, Array]:
        """Signed distance of one point above the mesh, m (negative inside), and the smooth outward normal there."""
        tree, owner = self._index
        near = np.unique(owner[tree.query(p, k=min(_NEAR, tree.n))[1]])
        weight = closest(self.triangles[near], p)
        away = p - np.einsum("mk,mkx->mx", weight, self.triangles[near])
        # of triangles that share the nearest edge the one that faces the point counts
        distance = np.linalg.norm(away, axis=1) - 1e-9 * np.abs(np.einsum("mx,mx->m", away, self.normal[near]))
        i = int(np.argmin(distance))
        normal = self._smooth_normal(near[i : i + 1], weight[i : i + 1])[0]
        return float(away[i] @ normal), normal

    def inside(self, points: Array, depth: float) -> bool:
        """Whether any of the points (n, 3) lies more than `depth` (m) behind the mesh, close to it."""
        tree, owner = self._index
        distance, which = tree.query(points)
        behind = np.einsum("nx,nx->n", points - self.triangles[owner[which], 0], self.normal[owner[which]]) < -depth
        return bool((behind & (distance < 2 * _SPACING)).any())


def closest(triangles: Array, p: Array) -> Array:
    """Barycentric weights (m, 3) of the point of each triangle (m, 3, 3) that is nearest to p (3,)."""
    a, b, c = triangles.swapaxes(0, 1)
    ab, ac, ap = b - a, c - a, p - a
    d11, d12, d22 = (np.einsum("mx,mx->m", u, v) for u, v in ((ab, ab), (ab, ac), (ac, ac)))
    r1, r2 = np.einsum("mx,mx->m", ab, ap), np.einsum("mx,mx->m", ac, ap)
    det = np.maximum(d11 * d22 - d12 * d12, 1e-300)
    v, w = (d22 * r1 - d12 * r2) / det, (d11 * r2 - d12 * r1) / det
    inner = np.stack([1 - v - w, v, w], axis=1)
    out = inner.copy()
    outside = (inner < 0).any(axis=1)
    best = np.full(len(triangles), np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, along = triangles[:, i], triangles[:, j] - triangles[:, i]
        t = np.einsum("mx,mx->m", p - start, along) / np.maximum(np.einsum("mx,mx->m", along, along), 1e-300)
        t = np.clip(t, 0.0, 1.0)
        away = np.linalg.norm(p - start - t[:, None] * along, axis=1)
        better = outside & (away < best)
        best = np.where(better, away, best)
        weight = np.zeros((len(triangles), 3))
        weight[:, i], weight[:, j] = 1 - t, t
        out[better] = weight[better]
    return out


def read_mesh(path: Path) -> Array:
    """Triangles (m, 3, 3) of an STL or OBJ file, in its own unit. SimError: not such a file, or not finite."""
    try:
        if not path.is_file() or path.stat().st_size > 300_000_000:
            raise SimError(f"{path}: no mesh file of at most 300 MB is there")
        data = path.read_bytes()
        kind = path.suffix.lower()
        if kind == ".obj":
            triangles = _obj(data.decode("utf-8", "replace"))
        elif kind == ".stl":
            count = int.from_bytes(data[80:84], "little")
            triangles = _binary(data, count) if len(data) == 84 + 50 * count else _ascii(data.decode("utf-8", "replace"))
        else:
            raise SimError(f"{path}: the simulator reads meshes from .stl and .obj files")
    except (OSError, ValueError, IndexError) as error:
        raise SimError(f"{path}: not a mesh that can be read: {error}") from error
    if not 0 < len(triangles) <= MOST_TRIANGLES or not np.isfinite(triangles).all():
        raise SimError(f"{path}: {len(triangles)} triangles; between 1 and {MOST_TRIANGLES} of finite size are needed")
    return triangles


def _binary(data: bytes, count: int) -> Array:
    raw = np.frombuffer(data, dtype=np.uint8, offset=84).reshape(count, 50)[:, 12:48]
    return np.ascontiguousarray(raw).view("<f4").reshape(count, 3, 3).astype(float)


def _ascii(text: str) -> Array:
    words = [line.split()[1:4] for line in text.splitlines() if line.strip().startswith("vertex")]
    return np.array(words, dtype=float).reshape(-1, 3, 3)


def _obj(text: str) -> Array:
    vertices: list[list[float]] = []
    corners: list[list[int]] = []
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            face = [int(w.split("/")[0]) for w in words[1:]]
            face = [k - 1 if k > 0 else len(vertices) + k for k in face]
            corners += [[face[0], face[i], face[i + 1]] for i in range(1, len(face) - 1)]
    return np.array(vertices, dtype=float).reshape(-1, 3)[np.array(corners, dtype=int).reshape(-1, 3)]
