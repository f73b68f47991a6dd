# SPDX-License-Identifier: Apache-2.0
"""The loaded course of a cell: a straight way in the surface's own coordinates, pressed on with a changing force.

Its record is what the simulator knows and no instrument of the cell sees: where the TCP really was.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .cellfile import CellFile, Patch
from .errors import SimError
from .kinematics import Array, forward, inverse
from .mesh import Mesh
from .motion import KNOT
from .poses import tool_frames

RAMP_TIME = 0.5  # s in which the process force comes and goes while the robot stands at either end
_WAVES = np.array([2.0, 3.0, 2.5])  # of the ripple along the course, for x, y, z of the force
_PHASES = np.array([0.3, 1.7, 4.0])  # rad
_TURNS = (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5)  # rad about the tool's axis, tried where the cell file does not say
_ALONG_TOOL = 0.02  # sine of the angle to the tool's axis below which a direction says nothing about its turn
STEP = 0.3  # rad, largest change of a joint from knot to knot
SINGULARITY = 0.06  # smallest singular value of the Jacobian that the course may come to, unit of length 1 m

COLUMNS = (
    *("stamp", "s"),
    *(f"p_{kind}_{axis}" for kind in ("commanded", "unloaded", "true") for axis in "xyz"),
    *("deviation_along", "deviation_lateral", "deviation_normal"),
    *("force_x", "force_y", "force_z", "offset_x", "offset_y", "offset_z"),
)


@dataclass(frozen=True)
class CoursePlan:
    """The course in base_link with the rail at `rail` (m), at k equal steps of its length (m).

    Attributes:
        q: joint angles that put the rigid robot there, (k, n), rad; q_approach: above the start, (n,).
        tangent, normal: unit vectors along the course and out of the surface, (k, 3).
        mean, ripple: of the process force on the robot, in tool0, (3,), N; speed: m/s.
    """

    q: Array
    q_approach: Array
    rail: float
    length: float
    tangent: Array
    normal: Array
    mean: Array
    ripple: Array
    speed: float

    def force(self, s: float) -> Array:
        """Process force at the way s (m) along the course, in tool0, (3,), N."""
        return self.mean + self.ripple * np.sin(2.0 * math.pi * _WAVES * s / self.length + _PHASES)

    def index(self, s: Array) -> Array:
        """Nearest steps to the ways s (m)."""
        return np.rint(np.asarray(s) / self.length * (len(self.q) - 1)).astype(int)


def plan_course(cell: CellFile) -> CoursePlan:
    """Joint angles along the course of the cell file.

    Raises:
        SimError: the file has no course, or the robot can't follow it.
    """
    try:
        section = cell.course
        start, end = np.array(section["from"], dtype=float), np.array(section["to"], dtype=float)
        mean, ripple = np.array(section["force"], dtype=float), np.array(section["ripple"], dtype=float)
        speed, face = float(section["speed"]), str(section.get("face", ""))
    except (KeyError, TypeError, ValueError) as error:
        raise SimError(f"{cell.path}: section 'course' lacks or has a wrong {error}; see config/cells/afp.yaml") from error
    p, normal, length = _points(cell, start, end, face)
    rail = 0.0
    if cell.rail is not None:
        axis, (low, high) = cell.rail
        rail = float(np.clip(p.mean(axis=0) @ axis, low, high))
        p = p - rail * axis
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    for R in _tool_frames(cell, section.get("tool_x"), tangent, normal):
        q = follow(cell, p, R, STEP, SINGULARITY)
        if q is not None:
            above = p[:1] + cell.approach_distance * normal[:1]
            q_approach, reached = inverse(cell.chain, above, R[:1], q[:1])
            if reached[0]:
                return CoursePlan(q, q_approach[0], rail, length, tangent, normal, mean, ripple, speed)
    turned = f" with tool_x {section['tool_x']}" if "tool_x" in section else ""
    raise SimError(f"{cell.path}: the robot can't follow the course from {start} to {end} m{turned}; move it on the surface")


def _tool_frames(cell: CellFile, tool_x: object, tangent: Array, normal: Array) -> list[Array]:
    """Rotations of tool0 along the course (k, 3, 3): as the file says, or those that are tried where it does not."""
    if tool_x is None:
        return [tool_frames(normal, np.full(len(normal), turn)) for turn in _TURNS]
    try:
        x = tangent.copy() if tool_x == "course" else np.tile(np.array(tool_x, dtype=float).reshape(3), (len(normal), 1))
    except (TypeError, ValueError) as error:
        raise SimError(f"{cell.path}: course.tool_x is {tool_x!r}; 'course' or a direction of 3 numbers is needed") from error
    z = -normal
    x /= np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-12)
    x -= z * np.einsum("ij,ij->i", x, z)[:, None]
    length = np.linalg.norm(x, axis=1, keepdims=True)
    if length.min() < _ALONG_TOOL:
        raise SimError(f"{cell.path}: course.tool_x {tool_x!r} lies along the tool; name a direction along the surface")
    x /= length
    return [np.stack([x, np.cross(z, x), z], axis=2)]


def _points(cell: CellFile, start: Array, end: Array, face: str) -> tuple[Array, Array, float]:
    """Points and normals in the cell frame at equal steps of the length."""

    def surface(u: Array) -> tuple[Array, Array]:
        x, y = (start + u[:, None] * (end - start)).T
        shape = cell.surface
        if isinstance(shape, Mesh):
            raise SimError(f"{cell.path}: course: the simulator drives courses on patches and blocks, not on meshes")
        return shape.point(x, y) if isinstance(shape, Patch) else shape.face_point(face, x, y)

    fine = np.linspace(0.0, 1.0, 2001)
    way = np.r_[0.0, np.linalg.norm(np.diff(surface(fine)[0], axis=0), axis=1).cumsum()]
    steps = max(2, math.ceil(way[-1] / KNOT))
    p, normal = surface(np.interp(np.linspace(0.0, way[-1], steps + 1), way, fine))
    return p, normal, float(way[-1])


def follow(cell: CellFile, p: Array, R: Array, step: float, singularity: float) -> Array | None:
    """Joint angles along a line of tool poses, (n, 6), rad; None where the robot can't follow it.

    Args:
        p, R: points (n, 3), m, and tool frames (n, 3, 3), in base_link. step: largest change of a joint from point to point, rad.
        singularity: smallest singular value of the Jacobian that is allowed on the way.
    """
    guess = cell.home.copy()
    guess[0] = -math.atan2(p[0, 1], p[0, 0])
    angles: list[Array] = []
    for k in range(len(p)):
        start = guess if k == 0 else angles[-1] if k == 1 else 2.0 * angles[-1] - angles[-2]
        q, reached = inverse(cell.chain, p[k : k + 1], R[k : k + 1], start[None])
        if not reached[0] or (k > 0 and np.abs(q[0] - angles[-1]).max() > step):
            return None
        angles.append(q[0])
    smallest = np.linalg.svd(forward(cell.chain, np.array(angles)).jacobian(), compute_uv=False)[:, -1].min()
    return np.array(angles) if smallest > singularity else None


@dataclass(frozen=True)
class CourseSample:
    """One instant of the course, in base_link: m, N (in tool0)."""

    stamp: float
    s: float
    p_commanded: Array
    p_unloaded: Array
    p_true: Array
    force_in_tool: Array
    offset: Array


def write_course(path: Path, plan: CoursePlan, samples: Sequence[CourseSample]) -> None:
    """One line per sample; deviation is the true TCP minus where it would be without process force and correction.

    Raises:
        SimError: the file can't be written.
    """
    steps = plan.index(np.array([sample.s for sample in samples]))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            for sample, k in zip(samples, steps, strict=True):
                deviation = sample.p_true - sample.p_unloaded
                tangent, normal = plan.tangent[k], plan.normal[k]
                parts = (deviation @ tangent, deviation @ np.cross(normal, tangent), deviation @ normal)
                points = (*sample.p_commanded, *sample.p_unloaded, *sample.p_true)
                values = (sample.stamp, sample.s, *points, *parts, *sample.force_in_tool, *sample.offset)
                writer.writerow([f"{value:.9f}" for value in values])
    except OSError as error:
        raise SimError(f"{path} can't be written: {error.strerror}; set parameter course_csv to another file") from error
