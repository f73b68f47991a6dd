# SPDX-License-Identifier: Apache-2.0
"""Triangles of the robot's picture: capsules along its frames, all in one mesh."""

from __future__ import annotations

import numpy as np

from ..typing import Array, IntArray

SIDES = 10


def capsules(points: Array, radius: Array) -> tuple[Array, IntArray]:
    """Cylinders with round ends between consecutive points.

    Args:
        points: (k, 3), m; radius: of each piece, (k - 1,), m.

    Returns:
        vertices (v, 3) and triangles (t, 3).
    """
    vertices, triangles = [], []
    begun = 0
    for a, b, r in zip(points[:-1], points[1:], radius, strict=True):
        length = float(np.linalg.norm(b - a))
        if length < 1e-6:
            continue
        along = (b - a) / length
        across = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        other = np.cross(along, across)
        turn = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
        ring = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * other
        # end cap, two rings along, end cap
        stack = [(a, -1.0, 0.0), (a, -0.7, 0.7), (a, 0.0, 1.0), (b, 0.0, 1.0), (b, 0.7, 0.7), (b, 1.0, 0.0)]
        for centre, out, wide in stack:
            vertices.append(centre + r * (out * along + wide * ring))
        for level in range(len(stack) - 1):
            low, high = begun + level * SIDES, begun + (level + 1) * SIDES
            for i in range(SIDES):
                j = (i + 1) % SIDES
                triangles += [(low + i, low + j, high + j), (low + i, high + j, high + i)]
        begun += len(stack) * SIDES
    if not vertices:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    return np.concatenate(vertices), np.array(triangles, dtype=np.int64)


def link_radii(joints: Array) -> Array:
    """Radii that look like an arm of this size, thinner towards the tool, (k - 1,), m."""
    reach = float(np.linalg.norm(np.diff(joints, axis=0), axis=1).sum())
    return np.linspace(0.036, 0.012, len(joints) - 1) * max(reach, 0.1)
