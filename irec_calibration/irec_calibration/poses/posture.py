# SPDX-License-Identifier: Apache-2.0
"""How to turn the tool about its own axis along a way, so that the arm stands stiffest against the process (paper 4.3.1).

Turning a spindle about its axis changes nothing for the part and everything for the arm. Turns are tried one by one; what stands
in the way of one (reach, joint limits, singularity, torque, the arm at the tooling) is told by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..cell import Cell
from ..effects.of_session import scene_of
from ..errors import CellError
from ..model import Model
from ..session.data import Session
from ..typing import Array, BoolArray
from .checker import Checker
from .course import LARGEST_STEP, course_of, rows_along, turned
from .ik import Chain, solve_pose, solve_tool_axis, wrap_into_limits

COLUMNS = ("x", "y", "z", "axis_x", "axis_y", "axis_z", "force_x", "force_y", "force_z")
COUNTS = ("counts_x", "counts_y", "counts_z")
_PERIOD = 0.2  # s between two points, for effects that take time


@dataclass(frozen=True)
class ToolWay:
    """n points of a way of the tool, in base_link.

    Attributes:
        p: TCP, (n, 3), m; R: tool0 as it is turned now, (n, 3, 3); force: on the robot, (n, 3), N.
        counts: unit directions in which a deviation is an error of the part, (n, 3); None: all of it is.
        ext: of the external axes, as a session has them.
    """

    p: Array
    R: Array
    force: Array
    counts: Array | None
    ext: dict[str, float]


@dataclass(frozen=True)
class Posture:
    """One turn of the tool along a way.

    Attributes:
        turn: rad, about tool z, from how the tool is turned now. hindered: what stands in its way, empty where nothing does.
        mean, largest: m, of the deviation that the model predicts, as far as it counts. q: joint angles, (n, k), rad.
        margin: rad, smallest way to a joint limit; singular: smallest singular value of the Jacobian, unit of length 1 m.
    """

    turn: float
    hindered: str
    mean: float = np.nan
    largest: float = np.nan
    margin: float = np.nan
    singular: float = np.nan
    q: Array | None = None


def way_of_course(cell: Cell, session: Session) -> ToolWay:
    """The cell file's own course with its mean force. Raises CellError: it has none, or the robot can't follow it."""
    course = course_of(cell, session)
    if course is None:
        raise CellError(f"{cell.path} has no section 'course'; give the way as a table (--way)")
    rows = course.session.select(np.flatnonzero(course.session.load_case == 1))
    kin = session.robot.kinematics(rows.q)
    force = (kin.R_tool @ rows.force_in_tool[:, :, None])[..., 0]
    return ToolWay(kin.p_tcp, kin.R_tool, force, None, {name: float(v[0]) for name, v in rows.ext.items()})


def way_of_table(path: Path, session: Session) -> ToolWay:
    """A way from a table with the columns COLUMNS and, where one direction counts only, COUNTS; base_link, m and N.

    `axis` is where tool z points. The tool is turned so that its x points down and towards the robot.

    Raises:
        CellError: a column is missing, a value is no number, or there are fewer than two points.
    """
    try:
        table = np.genfromtxt(path, delimiter=",", names=True)
    except (OSError, ValueError) as error:
        raise CellError(f"{path}: not a table: {error}") from error
    names = table.dtype.names or ()
    missing = [name for name in COLUMNS if name not in names]
    if missing or table.size < 2:
        raise CellError(
            f"{path}: {'no column ' + missing[0] if missing else 'fewer than two points'}; needed: {', '.join(COLUMNS)}"
        )
    p, z, force = (np.stack([table[c] for c in COLUMNS[k : k + 3]], axis=1) for k in (0, 3, 6))
    counts = np.stack([table[c] for c in COUNTS], axis=1) if set(COUNTS) <= set(names) else None
    for name, block in (("x, y, z", p), ("axis", z), ("force", force), ("counts", counts)):
        if block is not None and not np.isfinite(block).all():
            raise CellError(f"{path}: line {2 + int(np.argmin(np.isfinite(block).all(axis=1)))}: {name} is not a number")
    if (np.linalg.norm(z, axis=1) < 1e-6).any():
        raise CellError(f"{path}: line {2 + int(np.argmin(np.linalg.norm(z, axis=1)))}: axis has no length")
    z = _unit(z)
    x = np.array([-0.7, 0.0, -0.714]) + 1e-3 * np.array([0.0, 1.0, 0.0])
    x = _unit(x - z * (z @ x)[:, None])
    ext = {name: float(np.median(v)) for name, v in session.ext.items()}
    R = np.stack([x, np.cross(z, x), z], axis=2)
    return ToolWay(p, R, force, None if counts is None else _unit(counts), ext)


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))


def try_turns(
    cell: Cell, session: Session, model: Model, way: ToolWay, turns: Sequence[float],
    progress: Callable[[float, str], None] | None = None,
) -> list[Posture]:  # fmt: skip
    """Each turn (rad) along the whole way, in the order given.

    Args:
        session: its robot; time and temperature of its rows are those of production.

    Raises:
        CellError: the robot does not reach the beginning of the way however the tool is turned.
    """
    search = _Search(cell, session, model, way)
    found = []
    for i, turn in enumerate(turns):
        found.append(search.one(float(turn)))
        if progress is not None:
            progress((i + 1) / len(turns), f"turn {np.degrees(turn):.0f} degrees")
    return found


def in_line(cell: Cell) -> str:
    """Name of the last joint where its axis is that of the tool, so that turning the tool moves no other joint; else empty."""
    kin = cell.robot.kinematics(cell.home[None])
    apart = np.linalg.norm(np.cross(kin.p_tcp[0] - kin.origin[0, -1], kin.axis[0, -1]))
    sine = np.linalg.norm(np.cross(kin.R_tool[0, :, 2], kin.axis[0, -1]))
    return cell.robot.joint_names[-1] if apart < 1e-3 and sine < 1e-3 and not kin.is_prismatic[-1] else ""


def stiffest(postures: Sequence[Posture]) -> Posture | None:
    """The least mean predicted deviation of those that nothing hinders; None: all are hindered."""
    free = [p for p in postures if not p.hindered]
    return min(free, key=lambda p: p.mean) if free else None


class _Search:
    def __init__(self, cell: Cell, session: Session, model: Model, way: ToolWay) -> None:
        self.cell, self.session, self.model, self.way = cell, session, model, way
        self.chain, self.checker = Chain.of(cell.robot), Checker(cell)
        self.rail = next((way.ext[a.name] for a in session.ext_axes if a.kind == "prismatic" and a.name in way.ext), 0.0)
        home = cell.home.copy()
        home[0] = -np.arctan2(way.p[0, 1], way.p[0, 0]) if not self.chain.is_prismatic[0] else home[0]
        self.start: Array | None = None
        for first in (home, cell.home):
            q, reached = solve_tool_axis(self.chain, way.p[:1], way.R[:1, :, 2], first[None])
            if reached[0]:
                self.start = q
                break
        if self.start is None:
            raise CellError(f"{cell.path}: the robot does not reach the beginning of the way, {way.p[0].round(3).tolist()} m")
        as_now = self._followed(way.R)
        self.touched: BoolArray = np.zeros(len(way.p), dtype=bool) if as_now is None else self._touches(as_now)

    def one(self, turn: float) -> Posture:
        c, s = np.cos(turn), np.sin(turn)
        R = self.way.R @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        q = self._followed(R)
        if q is None:
            return Posture(turn, "out of reach, or a joint would have to leap")
        robot, cell = self.cell.robot, self.cell
        revolute = ~robot.is_prismatic
        margin = float(np.minimum(q - robot.lower, robot.upper - q)[:, revolute].min())
        kin = robot.kinematics(q)
        angular = np.where(kin.is_prismatic[:, None], 0.0, kin.axis)
        J = np.concatenate([kin.jacobian(kin.p_tcp), angular.swapaxes(1, 2)], axis=1)
        singular = float(np.linalg.svd(J, compute_uv=False)[:, -1].min())
        torque = (kin.jacobian(kin.p_tcp).swapaxes(1, 2) @ self.way.force[:, :, None])[..., 0]
        torque = torque + robot.gravity_torque(q, payload=cell.payload)
        hindered = ""
        if margin < cell.joint_margin:
            hindered = "a joint limit"
        elif singular < cell.singularity:
            hindered = "too close to a singularity"
        elif (np.abs(torque) > cell.continuous_torque).any():
            hindered = "the continuous torque of an axis"
        elif (self._touches(q) & ~self.touched).any():
            hindered = "tool or arm would touch the tooling"
        moved = self._deviation(q, R)
        return Posture(turn, hindered, float(moved.mean()), float(moved.max()), margin, singular, q)

    def _followed(self, R: Array) -> Array | None:
        """Joint angles along the way, None where the arm can't follow it as it stands at its beginning."""
        if self.start is None:
            return None
        p = self.way.p
        first, reached = turned(self.chain, self.start, p[:1], R[0])
        if not reached[0]:
            return None
        q = [first[0]]
        for k in range(1, len(p)):
            found, reached = solve_pose(self.chain, p[k : k + 1], R[k : k + 1], q[-1][None])
            if not reached[0] or np.abs(found[0] - q[-1]).max() > LARGEST_STEP:
                return None
            q.append(found[0])
        return wrap_into_limits(np.array(q), self.cell.robot.lower, self.cell.robot.upper, self.chain.is_prismatic)

    def _touches(self, q: Array) -> BoolArray:
        """Points at which tool or arm touch the tooling. A cutter stands in what it has cut: only further ones count."""
        base = self.cell.base_in_cell(np.full(len(q), self.rail))
        return self.checker.touching(self.cell.robot.kinematics(q), base)

    def _deviation(self, q: Array, R: Array) -> Array:
        force = (R.swapaxes(1, 2) @ self.way.force[:, :, None])[..., 0]
        rows = rows_along(self.session, q, self.way.p, force, _PERIOD * np.arange(len(q), dtype=np.float64), self.way.ext)
        moved = self.model.predict(scene_of(rows, observe="tcp"))[1::2]
        if self.way.counts is None:
            return np.asarray(np.linalg.norm(moved, axis=1))
        return np.asarray(np.abs((moved * self.way.counts).sum(axis=1)))
