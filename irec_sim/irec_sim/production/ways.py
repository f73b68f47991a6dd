# SPDX-License-Identifier: Apache-2.0
"""The ways of a part: 32 parallel courses over a mould, or the levels of a dome in a block, all driven side by side in time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..cellfile import Block, CellFile, Patch
from ..course import SINGULARITY, follow
from ..errors import SimError
from ..kinematics import Array, BoolArray, forward
from ..motion import Way
from ..poses import tool_frames

PERIOD = 0.004  # s
_KNOT = 0.05  # m, between points for which joint angles are computed
_STEP = 0.4  # rad, largest change of a joint between such points
_TURNS = (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5)


@dataclass(frozen=True)
class Ways:
    """k courses at equal steps of time; courses that end earlier stand at their end.

    Attributes:
        q: (steps, k, n), rad; rail: (k,), m; way: along each course, (steps, k), m; length: (k,), m.
        path: columns along, across, out of the surface, in base_link, (steps, k, 3, 3).
        counts: direction in which a deviation is an error of the part, unit, (steps, k, 3).
        R_tool: tool0 in base_link, (steps, k, 3, 3); driving: not yet at the end, (steps, k).
        p_in_cell: nominal TCP in the cell frame, (steps, k, 3), m. names: of the courses.
    """

    q: Array
    rail: Array
    way: Array
    length: Array
    path: Array
    counts: Array
    R_tool: Array
    driving: BoolArray
    p_in_cell: Array
    speed: float
    names: tuple[str, ...]

    def only(self, rows: Array) -> Ways:
        """Some of the courses."""
        steps = int(self.driving[:, rows].any(axis=1).sum())
        some = {n: getattr(self, n)[:steps, rows] for n in ("q", "way", "path", "counts", "R_tool", "driving", "p_in_cell")}
        names = tuple(np.array(self.names)[rows].tolist())
        return Ways(rail=self.rail[rows], length=self.length[rows], speed=self.speed, names=names, **some)


@dataclass(frozen=True)
class _Line:
    """Points, normals of the surface the tool stands on, tangents, directions that count, at equal steps of the way."""

    p: Array
    normal: Array
    counts: Array
    length: float


def make_ways(cell: CellFile, process: dict[str, Any]) -> Ways:
    """Ways of the process of a truth file.

    Raises:
        SimError: a key is missing, or the robot can't follow.
    """
    try:
        lines = _courses(cell, process) if process["kind"] == "lay-down" else _levels(cell, process)
        speed = float(process["speed"])
    except KeyError as error:
        raise SimError(f"{cell.path}: process of the truth lacks {error}; see config/truths/case_afp.yaml") from error
    driven = [_driven(cell, line, speed, i) for i, line in enumerate(lines)]
    steps = max(len(d[0]) for d in driven)
    padded = [[_padded(x, steps) for x in d[:-1]] for d in driven]
    q, way, path, counts, R, p = (np.stack([row[i] for row in padded], axis=1) for i in range(6))
    driving = np.arange(steps)[:, None] < np.array([len(d[0]) for d in driven])
    length = np.array([line.length for line in lines])
    names = tuple(f"T_{i + 1}" for i in range(len(lines)))
    return Ways(q, np.array([d[-1] for d in driven]), way, length, path, counts, R, driving, p, speed, names)


def _padded(x: Array, steps: int) -> Array:
    return np.concatenate([x, np.repeat(x[-1:], steps - len(x), axis=0)])


def _courses(cell: CellFile, process: dict[str, Any]) -> list[_Line]:
    """Parallel courses, one tape's width apart; the first 1 .. n from one side of the mould to the other."""
    surface = cell.surface
    if not isinstance(surface, Patch):
        raise SimError(f"{cell.path}: lay-down needs a surface of kind patch")
    angle = math.radians(float(process["direction_deg"]))
    d, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    half = np.array(surface.size) / 2 - float(process["margin"])
    lines = []
    n = int(process["courses"])
    for i in range(n):
        start = (i - 0.5 * (n - 1)) * float(process["spacing"]) * across
        with np.errstate(divide="ignore"):
            ends = np.stack([(-half - start) / d, (half - start) / d])
        low, high = ends.min(axis=0).max(), ends.max(axis=0).min()
        middle, reach = 0.5 * (low + high), 0.5 * min(high - low, float(process["longest"]))
        low, high = middle - reach, middle + reach
        if high - low < 0.1:
            raise SimError(f"{cell.path}: course {i + 1} is only {max(high - low, 0.0):.2f} m long; fewer courses or less margin")
        fine = start + np.linspace(low, high, 801)[:, None] * d
        p, _ = surface.point(fine[:, 0], fine[:, 1])
        done = np.r_[0.0, np.linalg.norm(np.diff(p, axis=0), axis=1).cumsum()]
        even = np.linspace(0.0, done[-1], max(8, math.ceil(done[-1] / _KNOT)) + 1)
        xy = np.stack([np.interp(even, done, fine[:, k]) for k in (0, 1)], axis=1)
        p, normal = surface.point(xy[:, 0], xy[:, 1])
        lines.append(_Line(p, normal, np.cross(normal, _tangents(p)), float(done[-1])))
    return lines


def _levels(cell: CellFile, process: dict[str, Any]) -> list[_Line]:
    """Circles about a dome (cap of a sphere) in the upper face of the block, from the top downwards; the tool stands upright."""
    block = cell.surface
    if not isinstance(block, Block):
        raise SimError(f"{cell.path}: roughing needs a surface of kind block")
    base, height, n = float(process["dome_radius"]), float(process["dome_height"]), int(process["levels"])
    centre = block.p + block.R @ np.array([*process["centre"], block.size[2] / 2])
    sphere = (base**2 + height**2) / (2 * height)
    lines = []
    for depth in np.linspace(height / n, height, n):
        drop = sphere - depth
        r = math.sqrt(sphere**2 - drop**2)
        phi = np.linspace(0.0, 2.0 * math.pi, max(24, math.ceil(2.0 * math.pi * r / _KNOT)) + 1) + math.pi
        local = np.stack([r * np.cos(phi), r * np.sin(phi), np.full(len(phi), -depth)], axis=1)
        outward = np.stack([r * np.cos(phi), r * np.sin(phi), np.full(len(phi), drop)], axis=1) / sphere
        up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), local.shape)
        lines.append(_Line(centre + local @ block.R.T, up @ block.R.T, outward @ block.R.T, 2.0 * math.pi * r))
    return lines


def _tangents(p: Array) -> Array:
    t = np.gradient(p, axis=0)
    return np.asarray(t / np.linalg.norm(t, axis=1, keepdims=True))


def _driven(cell: CellFile, line: _Line, speed: float, index: int) -> tuple[Array, Array, Array, Array, Array, Array, float]:
    """q, way, path, counts, R_tool, p_in_cell per step of time, and where the rail stands."""
    rail, p = 0.0, line.p
    if cell.rail is not None:
        axis, (low, high) = cell.rail
        rail = float(np.clip(p.mean(axis=0) @ axis, low, high))
        p = p - rail * axis
    q = None
    for turn in _TURNS:
        R = tool_frames(line.normal, np.full(len(p), turn))
        q = follow(cell, p, R, _STEP, SINGULARITY)
        if q is not None:
            break
    if q is None:
        raise SimError(f"{cell.path}: the robot can't follow course {index + 1} of the process")
    move = Way(line.length, speed)
    t = np.arange(int(math.ceil(move.duration / PERIOD)) + 1) * PERIOD
    way = np.array([move.distance(x) for x in t])
    knots = np.linspace(0.0, line.length, len(p))
    angles = _smooth(knots, q, way)
    tangent, normal = (_unit(_smooth(knots, x, way)) for x in (_tangents(line.p), line.normal))
    across = np.cross(normal, tangent)
    path = np.stack([tangent, across, normal], axis=2)
    R_tool = forward(cell.chain, angles).R_tool
    return angles, way, path, _unit(_smooth(knots, line.counts, way)), R_tool, _smooth(knots, line.p, way), rail


def _smooth(knots: Array, values: Array, at: Array) -> Array:
    from scipy.interpolate import CubicSpline  # loads slowly, and most users of the simulator never come here

    return np.asarray(CubicSpline(knots, values, axis=0)(at))


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
