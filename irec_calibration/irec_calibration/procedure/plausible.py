# SPDX-License-Identifier: Apache-2.0
"""Whether the readings of a standing robot agree with each other: joint angles with tcp_pose, tcp_pose with the marker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from ..cell import Cell
from ..typing import Array
from .scale import Scale

TCP_TOLERANCE = 5e-3  # m between forward kinematics and tcp_pose; a controller with measured geometry differs by less
TURN_TOLERANCE = 0.02  # rad, likewise
MARKER_TOLERANCE = 5e-3  # m, and MARKER_SHARE of the way: the marker moves as the TCP does
MARKER_SHARE = 0.01  # a station that is registered half a degree wrong
PLACE_TOLERANCE = 0.5  # m between where the marker is and where station and TCP say it is


@dataclass(frozen=True)
class Standing:
    """Readings of the robot while it stands.

    Attributes:
        q: joint angles (k,), rad; rail: m. p_tcp: (3,), m, in base_link. R_tool: rotation of tool0 into base_link (3, 3).
        station, p_marker: the marker in the frame of its station, (3,), m; None where it was not seen.
    """

    q: Array
    rail: float
    p_tcp: Array
    R_tool: Array
    station: str = ""
    p_marker: Array | None = None


class Plausibility:
    """Judges one standing robot after the other in one cell.

    Attributes:
        scale: of the force sensor, as far as it is known.
    """

    def __init__(self, cell: Cell, raw_force: Callable[[], Array | None] = lambda: None) -> None:
        """raw_force: newest mean of the raw force sensor in its frame, (3,), N; None where it does not come."""
        self._cell, self._raw_force, self.scale = cell, raw_force, Scale(cell)
        self._last: tuple[Array, Array, str] | None = None  # marker by TCP and by tracker in the cell, station

    def problem(self, s: Standing) -> str:
        """What does not agree with what, in a sentence; empty where all agrees."""
        return self.kinematics_problem(s) or self.marker_problem(s)

    def weight_problem(self, R_tool: Array) -> str:
        """Scale of the force sensor, by the tool's weight in this orientation and those before; in free air. R_tool: (3, 3)."""
        raw = self._raw_force()
        return "" if raw is None else self.scale.problem(R_tool, raw)

    def scale_doubt_before(self, R_tool: Array) -> str:
        """Why a run that stands at HOME and in these orientations (n, 3, 3) can't verify the scale; empty where it may."""
        at_home = self._cell.robot.kinematics(self._cell.home[None]).R_tool
        return self.scale.doubt_before(np.concatenate([at_home, R_tool]))

    def kinematics_problem(self, s: Standing) -> str:
        """Forward kinematics of the joint angles against tcp_pose."""
        at = self._cell.robot.kinematics(s.q[None])
        off = float(np.linalg.norm(at.p_tcp[0] - s.p_tcp))
        turn = float(Rotation.from_matrix(at.R_tool[0].T @ s.R_tool).magnitude())
        if off <= TCP_TOLERANCE and turn <= TURN_TOLERANCE:
            return ""
        if off > TCP_TOLERANCE:
            what = f"tcp_pose is at {_mm(s.p_tcp)} mm, the joint angles say {_mm(at.p_tcp[0])} mm: {1e3 * off:.1f} mm apart"
            what += f", limit {1e3 * TCP_TOLERANCE:g} mm"
        else:
            what = f"tcp_pose is turned by {np.degrees(turn):.1f} deg against the joint angles, limit"
            what += f" {np.degrees(TURN_TOLERANCE):.1f} deg"
        return f"joint_states and tcp_pose do not agree: {what}; {self._why(s, at.p_tcp[0])}"

    def _why(self, s: Standing, p_of_joints: Array) -> str:
        in_degrees = self._cell.robot.kinematics(np.radians(s.q)[None]).p_tcp[0]
        if np.linalg.norm(in_degrees - s.p_tcp) < TCP_TOLERANCE:
            return "the joint angles are in degrees, radians are needed"
        if np.linalg.norm(p_of_joints - 1e-3 * s.p_tcp) < TCP_TOLERANCE:
            return "tcp_pose is in mm, m is needed"
        if s.rail and np.linalg.norm(p_of_joints + self._cell.base_in_cell(np.array([s.rail]))[0] - s.p_tcp) < TCP_TOLERANCE:
            return "tcp_pose does not move with the rail: it is to be in base_link, which rides on it"
        return (
            "is tcp_pose that of tool0 in base_link, are the joints in the order of their names, and is the robot description"
            " that of this robot and tool?"
        )

    def marker_problem(self, s: Standing) -> str:
        """The tracker against tcp_pose: where the marker is, and how it has moved since the robot stood last."""
        if s.p_marker is None:
            return ""
        station = next(st for st in self._cell.stations if st.name == s.station)
        ride = self._cell.base_in_cell(np.array([s.rail]))[0]
        by_tcp = s.p_tcp + s.R_tool @ self._cell.marker_in_tool + ride
        by_tracker = station.p_in_cell + station.R_in_cell @ s.p_marker
        before, self._last = self._last, (by_tcp, by_tracker, s.station)
        if before is not None and before[2] == s.station:
            went, seen = by_tcp - before[0], by_tracker - before[1]
            off, limit = float(np.linalg.norm(seen - went)), MARKER_TOLERANCE + MARKER_SHARE * float(np.linalg.norm(went))
            if off > limit:
                return (
                    f"the marker does not move as the TCP does: since the robot stood last tcp_pose moved it by {_mm(went)} mm,"
                    f" the tracker ({s.station}) by {_mm(seen)} mm in the cell: {1e3 * off:.1f} mm apart,"
                    f" limit {1e3 * limit:.1f} mm; {_why_moved(went, seen)}"
                )
        off = float(np.linalg.norm(by_tracker - by_tcp))
        if off > PLACE_TOLERANCE:
            return (
                f"the tracker ({s.station}) sees the marker at {_mm(by_tracker)} mm in the cell, tcp_pose says {_mm(by_tcp)} mm:"
                f" {1e3 * off:.0f} mm apart, limit {1e3 * PLACE_TOLERANCE:g} mm;"
                f" {_why_placed(s.p_marker, station.R_in_cell.T @ (by_tcp - station.p_in_cell))}"
            )
        return ""


def _why_moved(went: Array, seen: Array) -> str:
    ratio = np.linalg.norm(seen) / max(float(np.linalg.norm(went)), 1e-9)
    if ratio > 300.0:
        return "the tracker's points are in mm, m is needed"
    if 0.97 < ratio < 1.03:
        return "the way is as long but has another direction: is the station's rotation in the cell file right, and the frame?"
    if ratio < 0.05:
        return "the marker stands: does the tracker repeat a held point, or see another reflector?"
    return "is it the marker of the tool, and is its place in tool0 (tool.marker_in_tool0) right?"


def _why_placed(p_marker: Array, expected: Array) -> str:
    if np.linalg.norm(1e-3 * p_marker - expected) < PLACE_TOLERANCE:
        return "the tracker's points are in mm, m is needed"
    return "are the points in the frame of the station, and is the station where the cell file says?"


def what_is_read(asked: Array, read: Array) -> str:
    """Asked and read force side by side, and what turns the one into the other where something simple does, (3,), N."""
    text = f"asked for {newtons(asked)} N, the wrench reads {newtons(read)} N"
    size = float(np.linalg.norm(asked))
    if size == 0.0:
        return text
    if abs(np.linalg.norm(read) - 1e-3 * size) < 1e-4 * size:
        return f"{text}: it is in kN, N is needed"
    best, how = np.inf, ""
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            off = float(np.linalg.norm(np.array(signs) * asked[list(order)] - read))
            if off < best - 1e-6 * size:
                best = off
                pairs = [(k, o, s) for k, (o, s) in enumerate(zip(order, signs, strict=True)) if k != o or s < 0]
                how = ", ".join(f"{'xyz'[k]} is {'-' if s < 0 else ''}{'xyz'[o]}" for k, o, s in pairs)
    if best < 0.05 * size < np.linalg.norm(asked - read) and how:
        return f"{text}: axes or signs are exchanged ({how})"
    return text


def _mm(p: Array) -> str:
    return f"({', '.join(f'{1e3 * v:.1f}' for v in p)})"


def newtons(f: Array) -> str:
    """(3,), N, for a sentence."""
    return f"({', '.join(f'{v:.0f}' for v in f)})"
