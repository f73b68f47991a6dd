# SPDX-License-Identifier: Apache-2.0
"""Whether the markers of a session are where joint angles and the header have them: units, signs, columns, frames, places.

Medians say whether a session as a whole fits; rows beyond the limit are counted beside that, since many of them are no
mistakes of single rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..errors import RobotError
from ..typing import Array
from .data import Session, Station
from .plausible_load import FEW, marker_as_believed
from .plausible_tcp import MANY_ROWS, altered_joints, beyond_limit, median_norm, mended, some_rows, standing
from .registration import registered

MARKER_M = 0.3  # m; only differences count in a loaded session, so that a station's pose need not be known well
PLACED_M = 1.0  # m, and TURNED rad: how far stations and markers that fit a loaded session may be from where they are stated
TURNED = 0.15
MISFIT = 0.05  # of the spread of the points: an absolute session that is registered as well as can be


@dataclass(frozen=True)
class _Placing:
    """Seen rows of a loaded session, whose stations and markers are known, beside what the controller has.

    believed: markers in base_link, (n, 3), m; back: ways in which base_link may ride on prismatic axes, whether the stations
    do or not, (n, 3) each, m.
    """

    rows: Session
    believed: Array
    back: tuple[Array, ...]

    @classmethod
    def of(cls, session: Session) -> _Placing:
        rows = session.select(np.flatnonzero(session.marker_seen))
        along = np.zeros_like(rows.p_marker_in_station)
        for axis in rows.ext_axes:
            if axis.kind == "prismatic" and axis.name in rows.ext:
                along += np.nan_to_num(rows.ext[axis.name][:, None]) * np.array(axis.axis)
        return cls(rows, marker_as_believed(rows), (0.0 * along, along, -along))

    def poses(self) -> tuple[Array, Array]:
        """Rotation (n, 3, 3) and position (n, 3), m, of the station of each row in base_link."""
        s = self.rows.stations
        return np.stack([k.R_in_base for k in s])[self.rows.station], np.array([k.xyz for k in s])[self.rows.station]

    def apart(self, v: Array, R: Array, t: Array) -> Array:
        """Distance of readings v, (n, 3), m, from what the controller has, stations at R, t; (n,), m."""
        difference = np.einsum("nij,nj->ni", R, v) + t - self.believed
        return min((np.linalg.norm(difference - back, axis=1) for back in self.back), key=lambda d: float(np.median(d)))

    def off(self, v: Array, R: Array, t: Array) -> float:
        """The median of these, m."""
        return float(np.median(self.apart(v, R, t)))


def markers(session: Session) -> tuple[list[str], list[str]]:
    """Marker columns of a loaded session, whose stations and markers are known, against the controller's: doubts and notes."""
    if not session.marker_seen.any():
        return [], []
    placing = _Placing.of(session)
    p, (R, t) = placing.rows.p_marker_in_station, placing.poses()
    apart = placing.apart(p, R, t)
    misfit, beyond = float(np.median(apart)), apart > MARKER_M
    if misfit <= MARKER_M and beyond.mean() <= MANY_ROWS:
        return beyond_limit(placing.rows, beyond, apart, "marker_*", "from where the controller has it", MARKER_M)
    if misfit <= PLACED_M and (note := _placed_elsewhere(placing)):
        return [], [note]
    if misfit <= MARKER_M:
        return beyond_limit(placing.rows, beyond, apart, "marker_*", "from where the controller has it", MARKER_M)
    hint = mended(misfit, MARKER_M, dict(_other_places(placing))) or _along_one_way(placing)
    return [
        f"marker_* is {misfit:.4g} m (median) from where the controller has it, at most {MARKER_M} m is expected"
        f"{hint}; check units, the stations' poses and marker_in_tool0"
    ], []


def _other_places(placing: _Placing) -> Iterator[tuple[str, float]]:
    """Misfit of the markers, m, without one mistake, with its name."""
    p, (R, t) = placing.rows.p_marker_in_station, placing.poses()
    stations, of = placing.rows.stations, placing.rows.station
    yield "marker_* in mm", placing.off(p * 1e-3, R, t)
    yield "a station's pose the other way round", placing.off(p, np.swapaxes(R, 1, 2), t)
    yield "a station's pose as base in station", placing.off(p, np.swapaxes(R, 1, 2), -np.einsum("nji,nj->ni", R, t))
    yield "marker_* in base_link", placing.off(p, np.broadcast_to(np.eye(3), R.shape), 0 * t)
    for i, j in combinations(range(3), 2):
        order = [0, 1, 2]
        order[i], order[j] = j, i
        yield f"marker_{'xyz'[i]} and marker_{'xyz'[j]} exchanged", placing.off(p[:, order], R, t)
    for i in range(3):
        yield f"marker_{'xyz'[i]} of the other sign", placing.off(p * np.where(np.arange(3) == i, -1.0, 1.0), R, t)
    yield "marker_* all of the other sign", placing.off(-p, R, t)
    w_first = [replace(s, quat_xyzw=(*s.quat_xyzw[1:], s.quat_xyzw[0])) for s in stations]
    yield "quat_xyzw of the stations given with w first", placing.off(p, _rotations(w_first)[of], t)
    for i, j in combinations(range(len(stations)), 2):
        order = list(range(len(stations)))
        order[i], order[j] = j, i
        exchanged = np.array(order)[of]
        poses = _rotations(stations)[exchanged], np.array([s.xyz for s in stations])[exchanged]
        yield f"stations {stations[i].name} and {stations[j].name} exchanged", placing.off(p, *poses)
    small = replace(
        placing.rows,
        markers=tuple(replace(m, xyz=(1e-3 * m.xyz[0], 1e-3 * m.xyz[1], 1e-3 * m.xyz[2])) for m in placing.rows.markers),
    )
    yield "the marker's place on the tool (marker_in_tool0) in mm", _Placing.of(small).off(p, R, t)


def _rotations(stations: list[Station] | tuple[Station, ...]) -> Array:
    return np.stack([s.R_in_base for s in stations])


def _along_one_way(placing: _Placing) -> str:
    """Whether markers are off along one direction only, by another distance in each pose: base_link rides on an axis."""
    p, (R, t) = placing.rows.p_marker_in_station, placing.poses()
    best = ""
    for back in placing.back:
        off = np.einsum("nij,nj->ni", R, p) + t - placing.believed - back
        middle = np.median(off, axis=0)
        off = off - middle
        if median_norm(off) < 0.1 * MARKER_M:
            x, y, z = -middle
            return f"; it would fit with the station at ({x:.4g}, {y:.4g}, {z:.4g}) m from where it is stated"
        way = np.linalg.svd(off[some_rows(len(off))], full_matrices=False)[2][0]
        along = off @ way
        if median_norm(off - along[:, None] * way) < 0.1 * MARKER_M and np.ptp(along) > MARKER_M:
            x, y, z = way * np.sign(way[np.abs(way).argmax()])
            best = (
                f"; it is off along ({x:.2f}, {y:.2f}, {z:.2f}) of base_link only, by {np.ptp(along):.3g} m more or less "
                "from pose to pose: an external axis on which the base rides (ext_<name>, ext_axes) whose column, axis or "
                "unit is not right?"
            )
    return best


def _placed_elsewhere(placing: _Placing) -> str:
    """Where stations and markers are, if that is a little elsewhere than stated and all readings fit then; else empty.

    Such a session can be what it says, and what it costs is for the diagnosis.
    """
    rows, (R, t) = placing.rows, placing.poses()
    off = placing.off(rows.p_marker_in_station, R, t)
    for back in placing.back:
        p = rows.p_marker_in_station - np.einsum("nji,nj->ni", R, back)
        free = replace(
            rows, kind="absolute", p_marker_in_station=p, stations=tuple(replace(s, known=False) for s in rows.stations),
            markers=tuple(replace(m, known=False) for m in rows.markers),
        )  # fmt: skip
        misfit, spread, placed = _misfit(free, free.q)
        turned = max(_angle(a.R_in_base.T @ b.R_in_base) for a, b in zip(rows.stations, placed.stations, strict=True))
        moved = max(float(np.linalg.norm(np.subtract(a.xyz, b.xyz))) for a, b in zip(rows.markers, placed.markers, strict=True))
        if misfit <= MISFIT * spread and turned <= TURNED and moved <= PLACED_M:
            return (
                f"marker_* is {off:.3g} m (median) from where the controller has it; it fits with stations turned by {turned:.3g}"
                f" rad and markers {moved:.3g} m from where they are stated: measure both anew"
            )
    return ""


def registration(session: Session) -> list[str]:
    """An absolute session against the robot description, stations and markers placed as well as can be."""
    # a marker on base_link is where it is, whatever the robot description says
    rows = np.flatnonzero(session.marker_seen & session.on_tool)
    if len(rows) < 12:
        return []
    some = session.select(rows[some_rows(len(rows))])
    misfit, spread, _ = _misfit(some, some.q)
    if misfit <= MISFIT * spread:
        return []
    few = some.select(some_rows(len(some), FEW))
    others = {name: _misfit(few, q)[0] for name, q in altered_joints(few.q)}
    others["marker_* in mm"] = _misfit(few, few.q, np.full(3, 1e-3))[0]
    # stations whose pose is free turn any mirrored frame into any other
    mirrored = "marker_* in a left-handed frame (one axis of the other sign, or two exchanged)"
    others[mirrored] = _misfit(few, few.q, np.array([1.0, 1.0, -1.0]))[0]
    hint = mended(misfit, MISFIT * spread, others)
    if not hint and (session.load_case == 0).any() and (session.load_case != 0).any():
        hint = "; there are load cases and rows without load: is it kind: loaded?"
    hint = hint or standing(session)
    return [
        f"marker_* is {misfit:.4g} m (median) from the robot description, wherever stations and markers are; at most "
        f"{100 * MISFIT:.0f} % of the {spread:.3g} m that the points spread over is expected{hint}; check "
        "joint columns, units and robot description"
    ]


def _misfit(session: Session, q: Array, factor: Array | float = 1.0) -> tuple[float, float, Session]:
    """Median distance of the points from the robot description after registration, their spread, m; and the session so placed."""
    try:
        kin = session.robot.kinematics(q)
    except RobotError:
        return np.inf, 1.0, session
    p = session.p_marker_in_station * factor
    placed = replace(session, q=q, p_tcp_in_base=kin.p_tcp, p_marker_in_station=p)
    found = registered(placed, kin)
    R = np.stack([s.R_in_base for s in found.stations])[found.station]
    t = np.array([s.xyz for s in found.stations])[found.station]
    off = np.einsum("nij,nj->ni", R, p) + t - marker_as_believed(found)
    spread = float(np.median(np.linalg.norm(p - np.median(p, axis=0), axis=1)))
    return median_norm(off), max(spread, 1e-9), found


def _angle(R: Array) -> float:
    return float(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))
