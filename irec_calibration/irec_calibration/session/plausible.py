# SPDX-License-Identifier: Apache-2.0
"""Whether a session can be what it says, before anything is identified from it: units, signs, columns and frames.

Each doubt names the value, the limit and, where one alteration would mend it, which. A missing effect or a bad row is no doubt:
limits are far from what real robots do, and medians are judged.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..errors import ImplausibleSession, RobotError
from ..typing import Array, IntArray
from .data import Session
from .plausible_load import FEW, deflection, forces, marker_as_believed
from .registration import registered

TCP_M = 0.01  # m; controllers and descriptions differ by a calibrated tool and links, not more
MARKER_M = 0.3  # m; only differences count in a loaded session, so that a station's pose need not be known well
PLACED_M = 1.0  # m, and TURNED rad: how far stations and markers that fit a loaded session may be from where they are stated
TURNED = 0.15
MISFIT = 0.05  # of the spread of the points: an absolute session that is registered as well as can be
NOISE_M = 2e-3  # m; a tracker that is worse is none
GRAVITY = (9.0, 10.5)
TEMPERATURE = (-40.0, 120.0)
FAR_M = 80.0  # m; range of a tracker
BEST_OF_OTHERS = 0.2  # an alteration that brings a misfit below this share of it is named


def check_plausible(session: Session) -> Session:
    """A session that can be what it says, with a note on stations and markers that are not where they are stated.

    Raises:
        ImplausibleSession: it can't be; all reasons in its message.
    """
    found = doubts(session)
    if found:
        where = session.path or session.name
        raise ImplausibleSession(f"{where}: " + "; ".join(found), found)
    elsewhere = _placed_elsewhere(_Placing.of(session)) if session.kind == "loaded" else ""
    return replace(session, notes=(*session.notes, elsewhere)) if elsewhere else session


def doubts(session: Session) -> tuple[str, ...]:
    """What speaks against a session, most basic first; empty where nothing does."""
    found = list(_stated(session))
    if session.kind == "loaded":
        found += _tcp(session) or _markers(session)
        found += forces(session)
        if not found:
            found += deflection(session)
    else:
        if session.has_tcp:
            found += _tcp(session)
        found += _registration(session)
    return tuple(found)


def _stated(session: Session) -> Iterator[str]:
    """Header and columns by themselves."""
    n = session.noise
    for name, value in (("tracker_m", n.tracker_m), ("settling_m", n.settling_m), ("robot_m", n.robot_m)):
        if value > NOISE_M * (5.0 if name == "robot_m" else 1.0):
            yield f"noise: {name} is {value:g} m, more than {NOISE_M:g} m is no such instrument (mm or um for m?)"
    if n.tracker_m_per_m > 1e-3:
        yield f"noise: tracker_m_per_m is {n.tracker_m_per_m:g}, more than 0.001 is no tracker (um/m for m/m?)"
    g = float(np.linalg.norm(session.gravity_in_base))
    if session.gravity_in_base != (0.0, 0.0, 0.0) and not GRAVITY[0] < g < GRAVITY[1]:
        yield f"gravity is {g:g} m/s^2, {GRAVITY[0]} .. {GRAVITY[1]} is expected"
    if session.payload is not None and session.payload.mass > 5000.0:
        yield f"payload: mass is {session.payload.mass:g} kg, more than 5000 kg (g for kg?)"
    for name, values in session.temperature.items():
        middle = float(np.nanmedian(values)) if np.isfinite(values).any() else 20.0
        if not TEMPERATURE[0] < middle < TEMPERATURE[1]:
            yield f"temp_{name} is {middle:g} degC (median), {TEMPERATURE[0]:g} .. {TEMPERATURE[1]:g} is expected (K or F?)"
    for name, values in session.ext.items():
        size = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
        if size > FAR_M:
            yield f"ext_{name} reaches {size:g}, more than {FAR_M:g} m or rad (mm or degrees?)"
    seen = session.p_marker_in_station[session.marker_seen]
    if len(seen) and session.meta.get("without_tracker") is True:
        yield f"without_tracker says that no tracker measured, marker_* has values in {len(seen)} rows: one of the two is wrong"
    if len(seen):
        far = float(np.median(np.linalg.norm(seen, axis=1)))
        if far > FAR_M:
            yield f"markers are {far:.4g} m from their station (median), a tracker reaches {FAR_M:g} m (mm for m?)"
        if len(seen) > 3 and float(np.ptp(seen, axis=0).max()) == 0.0:
            yield "the marker is at the very same place in every row: the tracker's reading did not change"


def _tcp(session: Session) -> list[str]:
    """TCP columns against forward kinematics of the joint columns."""
    q, tcp = session.q, session.p_tcp_in_base
    rows = _some(len(q))
    off = _apart(session, q, rows)
    if off <= TCP_M:
        return []
    hint = _mended(off, {name: _apart(session, changed, rows) for name, changed in _altered_joints(q)})
    if not hint:
        believed = session.robot.kinematics(q).p_tcp[rows]
        others = {what: _median_norm(believed - tcp[rows] * f) for f, what in ((1e-3, "tcp_* in mm"), (1e3, "tcp_* in km"))}
        hint = _mended(off, others)
    return [
        f"tcp_* is {off:.4g} m (median) from the forward kinematics of joint_*, at most {TCP_M} m is expected{hint}; check joint "
        "columns, units and robot description"
    ]


def _apart(session: Session, q: Array, rows: IntArray) -> float:
    try:
        return _median_norm(session.robot.kinematics(q[rows]).p_tcp - session.p_tcp_in_base[rows])
    except RobotError:
        return np.inf


def _altered_joints(q: Array) -> Iterator[tuple[str, Array]]:
    """Joint columns as they would be without one mistake, with its name."""
    k = q.shape[1]
    yield "joint_* in degrees", np.deg2rad(q)
    yield "joint_* all of the other sign", -q
    for i, j in combinations(range(k), 2):
        changed = q.copy()
        changed[:, [i, j]] = q[:, [j, i]]
        yield f"joint_{i + 1} and joint_{j + 1} exchanged", changed
    for i in range(k):
        for name, column in (
            ("of the other sign", -q[:, i]), ("in degrees", np.deg2rad(q[:, i])), ("off by +90 deg", q[:, i] - np.pi / 2),
            ("off by -90 deg", q[:, i] + np.pi / 2), ("off by 180 deg", q[:, i] - np.pi),
        ):  # fmt: skip
            changed = q.copy()
            changed[:, i] = column
            yield f"joint_{i + 1} {name}", changed


def _mended(misfit: float, others: dict[str, float]) -> str:
    best = min(others, key=lambda k: others[k])
    return f"; it would fit with {best}" if others[best] < BEST_OF_OTHERS * misfit else ""


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

    def off(self, v: Array, R: Array, t: Array) -> float:
        """Median distance of readings v, (n, 3), m, from what the controller has, stations at R, t."""
        difference = np.einsum("nij,nj->ni", R, v) + t - self.believed
        return min(_median_norm(difference - back) for back in self.back)


def _markers(session: Session) -> list[str]:
    """Marker columns of a loaded session, whose stations and markers are known, against the controller's."""
    if not session.marker_seen.any():
        return []
    placing = _Placing.of(session)
    p, (R, t) = placing.rows.p_marker_in_station, placing.poses()

    def off(v: Array, R: Array = R, t: Array = t) -> float:
        return placing.off(v, R, t)

    misfit = off(p)
    if misfit <= MARKER_M or (misfit <= PLACED_M and _placed_elsewhere(placing)):
        return []
    others = {
        "marker_* in mm": off(p * 1e-3), "a station's pose the other way round": off(p, np.swapaxes(R, 1, 2), t),
        "a station's pose as base in station": off(p, np.swapaxes(R, 1, 2), -np.einsum("nji,nj->ni", R, t)),
        "marker_* in base_link": off(p, np.broadcast_to(np.eye(3), R.shape), 0 * t),
    }  # fmt: skip
    for i, j in combinations(range(3), 2):
        order = [0, 1, 2]
        order[i], order[j] = j, i
        others[f"marker_{'xyz'[i]} and marker_{'xyz'[j]} exchanged"] = off(p[:, order])
    return [
        f"marker_* is {misfit:.4g} m (median) from where the controller has it, at most {MARKER_M} m is expected"
        f"{_mended(misfit, others)}; check units, the stations' poses and marker_in_tool0"
    ]


def _placed_elsewhere(placing: _Placing) -> str:
    """Where stations and markers are, if that is a little elsewhere than stated and all readings fit then; else empty.

    Such a session can be what it says, and what it costs is for the diagnosis.
    """
    rows, (R, t) = placing.rows, placing.poses()
    if not len(rows) or (off := placing.off(rows.p_marker_in_station, R, t)) <= MARKER_M:
        return ""
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


def _registration(session: Session) -> list[str]:
    """An absolute session against the robot description, stations and markers placed as well as can be."""
    # a marker on base_link is where it is, whatever the robot description says
    rows = np.flatnonzero(session.marker_seen & session.on_tool)
    if len(rows) < 12:
        return []
    some = session.select(rows[_some(len(rows))])
    misfit, spread, _ = _misfit(some, some.q)
    if misfit <= MISFIT * spread:
        return []
    few = some.select(_some(len(some), FEW))
    others = {name: _misfit(few, q)[0] for name, q in _altered_joints(few.q)}
    others["marker_* in mm"] = _misfit(few, few.q, 1e-3)[0]
    return [
        f"marker_* is {misfit:.4g} m (median) from the robot description, wherever stations and markers are; at most "
        f"{100 * MISFIT:.0f} % of the {spread:.3g} m that the points spread over is expected{_mended(misfit, others)}; check "
        "joint columns, units and robot description"
    ]


def _misfit(session: Session, q: Array, factor: float = 1.0) -> tuple[float, float, Session]:
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
    return _median_norm(off), max(spread, 1e-9), found


def _angle(R: Array) -> float:
    return float(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))


def _some(n: int, most: int = 400) -> IntArray:
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))


def _median_norm(v: Array) -> float:
    return float(np.median(np.linalg.norm(v, axis=1)))
