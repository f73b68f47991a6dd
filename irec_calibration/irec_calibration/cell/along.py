# SPDX-License-Identifier: Apache-2.0
"""Distances along a surface, for poses that are spread over the tooling."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ..typing import Array
from .mesh import TriangleMesh
from .surface import SurfacePoints


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
