# SPDX-License-Identifier: Apache-2.0
"""Line of sight from the tracker stations to the marker: arm and tooling may stand between."""

from __future__ import annotations

import numpy as np

from .cellfile import Block, CellFile
from .kinematics import Array, forward
from .mesh import Mesh

ARM_SHARE = 0.75  # of the radius that the cell states, upper arm and forearm; the statement has room
_OWN = 0.25  # m around the marker that belong to the tool and don't hide it


def _share(numerator: float, denominator: float) -> float:
    """Quotient within 0..1; 0 where there is none."""
    return float(np.clip(numerator / denominator, 0.0, 1.0)) if denominator > 1e-12 else 0.0


def _segment_distance(a: Array, b: Array, c: Array, d: Array) -> float:
    """Smallest distance of the segments a-b and c-d, m."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv, uw, vw = float(u @ u), float(u @ v), float(v @ v), float(u @ w), float(v @ w)
    det = uu * vv - uv * uv
    s = _share(uv * vw - vv * uw, det)
    t = _share(uv * s + vw, vv)
    s = _share(uv * t - uw, uu)
    gap = w + s * u - t * v
    return float(np.sqrt(gap @ gap))


def _through_tooling(cell: CellFile, p_station: Array, marker: Array) -> bool:
    share = np.linspace(0.0, 1.0, 40)[1:-1, None]
    points = marker + share * (p_station - marker)
    surface = cell.surface
    if isinstance(surface, Mesh):
        return surface.inside(points[1:], 0.002)
    local = (points - surface.p) @ surface.R
    if isinstance(surface, Block):
        return bool((np.abs(local) < np.array(surface.size) / 2 - 0.002).all(axis=1).any())
    x, y, z = local.T
    inside = (np.abs(x) < surface.size[0] / 2) & (np.abs(y) < surface.size[1] / 2)
    height = z + x**2 / (2 * surface.radius[0]) + y**2 / (2 * surface.radius[1])
    return bool((inside & (height < -0.002)).any())


def visible(cell: CellFile, q: Array, rail: float, marker: Array) -> int | None:
    """Index of the nearest station that sees the marker (cell frame), None where none does."""
    base = rail * cell.rail[0] if cell.rail is not None else np.zeros(3)
    joints = forward(cell.chain, q[None]).origin[0] + base
    order = np.argsort([np.linalg.norm(marker - p) for _, p, _ in cell.stations])
    for index in order:
        p_station = cell.stations[index][1]
        away = p_station - marker
        start = marker + away * (_OWN / np.linalg.norm(away))
        arm = ((joints[1], joints[2]), (joints[2], joints[4]))
        if any(_segment_distance(start, p_station, a, b) < ARM_SHARE * cell.arm_radius for a, b in arm):
            continue
        if not _through_tooling(cell, p_station, marker):
            return int(index)
    return None
