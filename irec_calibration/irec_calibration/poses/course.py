# SPDX-License-Identifier: Apache-2.0
"""The loaded course of a cell as rows that a model can be asked about: joint angles along the surface and the process force.

The cell file's section `course` names it: a straight way in the surface's own coordinates, pressed on with a changing force.
`course.tool_x` says how the tool is turned about its axis; without it the tool is turned as in the nearest pose of the session.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..cell import Cell
from ..cell.surface import Block, Patch
from ..errors import CellError
from ..session.data import Session
from ..typing import Array, BoolArray
from .ik import Chain, solve_pose, solve_tool_axis, wrap_into_limits

STEPS = 60
WAVES, PHASES = np.array([2.0, 3.0, 2.5]), np.array([0.3, 1.7, 4.0])  # of the force's ripple along the course, for x, y, z
LARGEST_STEP = 0.3  # rad between two points of the course
TURN_STEP = 0.2  # rad about the tool's axis, from how a pose of the session stands to how the course asks for it
ALONG_TOOL = 0.02  # sine of the angle to the tool's axis below which a direction says nothing about its turn


@dataclass(frozen=True)
class Course:
    """n points of a course.

    Attributes:
        s: way along the course, (n,), m. tangent, normal: unit vectors along it and out of the surface, (n, 3), in base_link.
        session: 2 n rows: each point without and with its process force, as one pose of Procedure 1; the marker is never seen.
        tolerance: of the process, m. is_turned: the cell file says how the tool is turned about its axis.
    """

    s: Array
    tangent: Array
    normal: Array
    session: Session
    tolerance: float
    is_turned: bool = False

    def across(self, displacement: Array) -> Array:
        """The part of displacements (n, 3) along the surface across the course, (n,), m: what a laid tow is off by."""
        lateral = np.cross(self.normal, self.tangent)
        return np.asarray(np.sum(displacement * lateral, axis=1) / np.linalg.norm(lateral, axis=1))


def course_of(cell: Cell, session: Session, steps: int = STEPS) -> Course | None:
    """The course of a cell for the robot of a session; None where the cell file has none.

    Args:
        session: its poses say how the arm stands at the surface.

    Raises:
        CellError: the section is wrong, or the robot can't follow the course.
    """
    section = cell.raw.get("course")
    if not section:
        return None
    try:
        start, end = np.array(section["from"], dtype=float), np.array(section["to"], dtype=float)
        mean, ripple = np.array(section["force"], dtype=float), np.array(section.get("ripple", (0, 0, 0)), dtype=float)
        speed, face = float(section["speed"]), str(section.get("face", ""))
    except (KeyError, TypeError, ValueError) as error:
        raise CellError(f"{cell.path}: section 'course' lacks or has a wrong {error}; see config/cells/afp.yaml") from error
    if session.robot.sha256 != cell.robot.sha256:
        raise CellError(f"{cell.path} and session '{session.name}' are of different robots; the course is left out")
    p, normal = _points(cell, start + np.linspace(0.0, 1.0, steps)[:, None] * (end - start), face)
    p, ext = _on_rail(cell, session, p)
    s = np.r_[0.0, np.linalg.norm(np.diff(p, axis=0), axis=1).cumsum()]
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    q = _follow(cell, session, p, normal, _tool_frames(cell, section.get("tool_x"), tangent, normal))
    force = mean + ripple * np.sin(2.0 * np.pi * WAVES * (s / s[-1])[:, None] + PHASES)
    rows = rows_along(session, q, p, force, s / speed, ext)
    return Course(s, tangent, normal, rows, cell.tolerance, is_turned=bool(section.get("tool_x")))


def _points(cell: Cell, local: Array, face: str) -> tuple[Array, Array]:
    surface = cell.surface
    if isinstance(surface, Patch):
        return surface.place(local)
    if isinstance(surface, Block):
        if face not in surface.faces:
            raise CellError(f"{cell.path}: course.face: {face!r} is none of {', '.join(surface.faces)}")
        return surface.place(face, local), np.tile(surface.R_in_cell @ surface.frame(face)[1], (len(local), 1))
    raise CellError(f"{cell.path}: course: courses are known on patches and blocks, not on meshes")


def _on_rail(cell: Cell, session: Session, p: Array) -> tuple[Array, dict[str, float]]:
    """The points in base_link, and where the external axes stand meanwhile."""
    ext = {name: float(np.median(v)) for name, v in session.ext.items()}
    if cell.rail is None:
        return p, ext
    carrying = [a.name for a in session.ext_axes if a.kind == "prismatic" and a.name in ext]
    at = float(np.clip(p.mean(axis=0) @ cell.rail.axis, cell.rail.lower, cell.rail.upper)) if carrying else 0.0
    return p - at * cell.rail.axis, ext | dict.fromkeys(carrying, at)


def _tool_frames(cell: Cell, tool_x: object, tangent: Array, normal: Array) -> Array | None:
    """Rotations of tool0 into base_link along the course (n, 3, 3); None where the file does not say how it is turned."""
    if tool_x is None:
        return None
    try:
        wanted = tangent if tool_x == "course" else np.tile(np.array(tool_x, dtype=float).reshape(3), (len(tangent), 1))
    except (TypeError, ValueError) as error:
        raise CellError(f"{cell.path}: course.tool_x is {tool_x!r}; 'course' or a direction of 3 numbers is needed") from error
    x = wanted - normal * np.sum(wanted * normal, axis=1)[:, None]
    size = np.linalg.norm(x, axis=1)
    if not (size > ALONG_TOOL * np.linalg.norm(wanted, axis=1)).all():
        raise CellError(f"{cell.path}: course.tool_x is {tool_x!r}, which lies along the tool; name one along the surface")
    x /= size[:, None]
    return np.stack([x, np.cross(-normal, x), -normal], axis=2)


def _follow(cell: Cell, session: Session, p: Array, normal: Array, R_tool: Array | None) -> Array:
    """Joint angles along the points (n, 3), beginning from the pose of the session that is nearest to the first.

    Args:
        R_tool: rotations of tool0 into base_link (n, 3, 3); None: as they come from that pose.
    """
    chain = Chain.of(session.robot)
    near = np.argsort(np.linalg.norm(session.p_tcp_in_base - p[0], axis=1))
    limits = (session.robot.lower, session.robot.upper, chain.is_prismatic)
    for first in dict.fromkeys(near[:: max(1, len(near) // 12)].tolist()):
        start, reached = solve_tool_axis(chain, p[:1], -normal[:1], session.q[first][None])
        if not reached[0]:
            continue
        if R_tool is not None:
            start, reached = turned(chain, start, p[:1], R_tool[0])
        if not reached[0]:
            continue
        q = [start[0]]
        for k in range(1, len(p)):
            at, before = slice(k, k + 1), q[-1][None]
            if R_tool is None:
                found, reached = solve_tool_axis(chain, p[at], -normal[at], before)
            else:
                found, reached = solve_pose(chain, p[at], R_tool[at], before)
            if not reached[0] or np.abs(found[0] - q[-1]).max() > LARGEST_STEP:
                break
            q.append(found[0])
        angles = wrap_into_limits(np.array(q), *limits) if len(q) == len(p) else np.zeros((0, 0))
        if len(angles) and (angles >= limits[0]).all() and (angles <= limits[1]).all():
            return angles
    raise CellError(f"{cell.path}: course: the robot can't follow it as it stands in session '{session.name}'")


def turned(chain: Chain, q: Array, p: Array, R: Array) -> tuple[Array, BoolArray]:
    """The tool turned about its axis to R (3, 3) in base_link, from joint angles q (1, k), rad, at TCP p (1, 3), m, step by step,
    so that the arm stays folded as it is: joint angles (1, k), rad, and whether it got there (1,)."""
    _, now, _ = chain.forward(q)
    x = R.T @ now[0][:, 0]  # where x points now, seen from where it is to point
    angle = float(np.arctan2(x[1], x[0]))
    steps = max(1, int(np.ceil(abs(angle) / TURN_STEP)))
    reached = np.ones(1, dtype=bool)
    for left in angle * np.arange(steps - 1, -1, -1) / steps:
        about_z = np.array([[np.cos(left), -np.sin(left), 0.0], [np.sin(left), np.cos(left), 0.0], [0.0, 0.0, 1.0]])
        q, reached = solve_pose(chain, p, (R @ about_z)[None], q)
        if not reached[0]:
            break
    return q, reached


def rows_along(session: Session, q: Array, p: Array, force: Array, time: Array, ext: dict[str, float]) -> Session:
    """Two rows for each of n points, without and under the force, of the robot of a session.

    Args:
        session: its robot and instruments; q: joint angles, (n, k), rad; p: TCP in base_link, (n, 3), m.
        force: on the robot in tool0, (n, 3), N; time: (n,), s; ext: positions of external axes, m or rad.
    """
    n = len(q)
    twice = np.repeat(np.arange(n), 2)
    pressed = np.tile([0, 1], n)
    rows = session.select(np.zeros(2 * n, dtype=np.int64))
    return replace(
        rows, name=f"course of {session.name}", kind="loaded", pose=twice + 1, load_case=pressed,
        repeat=np.zeros(2 * n, dtype=np.int64), stamp=time[twice] + 1e-3 * pressed, q=q[twice],
        p_tcp_in_base=session.robot.kinematics(q).p_tcp[twice], p_marker_in_station=np.full((2 * n, 3), np.nan),
        force_in_tool=force[twice] * pressed[:, None], torque_in_tool=np.zeros((2 * n, 3)), q_target=None,
        ext={name: np.full(2 * n, ext[name]) for name in session.ext}, load_case_names={}, load_cases={}, path=None,
        temperature={name: np.full(2 * n, float(np.nanmedian(v))) for name, v in session.temperature.items()},
    )  # fmt: skip
