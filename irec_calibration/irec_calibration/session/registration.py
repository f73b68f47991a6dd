# SPDX-License-Identifier: Apache-2.0
"""Where the tracker stations and the markers are in an `absolute` session, from the robot description alone.

Closed form first (a linear problem whose rotation matrices are free, then projected), so that a session which states no pose
at all starts as well as one that does; then a robust nonlinear refinement. What is `known: true` stays as stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..robot import Kinematics
from ..robot.kinematics import cross_matrices
from ..typing import Array, IntArray
from .data import Marker, Session, Station

ROWS_ENOUGH = 3000  # a start value does not need more
TRIM = 6.0  # median residuals beyond which a row does not take part in the second closed-form pass
POSITION_DOUBT = 0.1  # m; how far a marker may be from where it is stated before that counts like the misfit of the nominal robot
REFINEMENTS = 40
G = 9.81  # m/s^2


@dataclass(frozen=True)
class _Rows:
    """Seen rows: station and marker index, measured point in the station (m, 3), believed point at marker origin, its
    rotation."""

    station: IntArray
    marker: IntArray
    v: Array
    p: Array
    B: Array

    def take(self, keep: Array) -> _Rows:
        return _Rows(self.station[keep], self.marker[keep], self.v[keep], self.p[keep], self.B[keep])


def registered(session: Session, kin: Kinematics) -> Session:
    """A session with the unknown poses of its stations and markers estimated from nominal kinematics.

    Args:
        session: `loaded` sessions are returned as they are.
        kin: of all rows of the session.

    Returns:
        the same session; stations and markers with `known` are unchanged.
    """
    free_s = [i for i, s in enumerate(session.stations) if not s.known]
    free_m = [i for i, m in enumerate(session.markers) if not m.known]
    rows = np.flatnonzero(session.marker_seen)
    if session.kind == "loaded" or not (free_s or free_m) or len(rows) < 3:
        return session
    rows = _enough(session, rows)
    on_tool = session.on_tool[rows]
    data = _Rows(
        session.station[rows],
        session.marker[rows],
        session.p_marker_in_station[rows],
        np.where(on_tool[:, None], session.p_tcp_in_base[rows], 0.0),
        np.where(on_tool[:, None, None], kin.R_tool[rows], np.eye(3)),
    )
    stated = (session.stations, session.markers)
    starts = [stated, _aligned(data, *stated)]
    closed = _closed_form(data, *stated)
    distance = np.linalg.norm(_residual(data, *closed), axis=1)
    starts += [closed, _closed_form(data.take(distance <= TRIM * np.median(distance) + 1e-9), *stated)]
    given = [m.xyz for m in session.markers]
    refined = [_refine(data, *start, free_s, free_m, given) for start in starts]
    _, stations, markers = min(refined, key=lambda f: f[0])
    return replace(session, stations=stations, markers=markers)


def _enough(session: Session, rows: IntArray) -> IntArray:
    """Some of many rows, spread evenly over those of each marker from each station: where markers take turns, every second row
    may be of some of them only."""
    if len(rows) <= ROWS_ENOUGH:
        return rows
    kind = session.station[rows] * len(session.markers) + session.marker[rows]
    of_kind = [rows[kind == k] for k in np.unique(kind)]
    most = max(ROWS_ENOUGH // len(of_kind), 1)
    kept = [mine[np.unique(np.linspace(0, len(mine) - 1, min(most, len(mine))).astype(int))] for mine in of_kind]
    return np.sort(np.concatenate(kept))


def level_gravity(stations: tuple[Station, ...]) -> Array | None:
    """Gravity in base_link by the first station that stands level, m/s^2; None where none does."""
    for s in stations:
        if s.level:
            return -G * s.R_in_base[:, 2]
    return None


def _residual(data: _Rows, stations: tuple[Station, ...], markers: tuple[Marker, ...]) -> Array:
    R = np.stack([s.R_in_base for s in stations])[data.station]
    t = np.array([s.xyz for s in stations])[data.station]
    m = np.array([m.xyz for m in markers])[data.marker]
    return np.einsum("nij,nj->ni", R, data.v) + t - data.p - np.einsum("nij,nj->ni", data.B, m)


def _posed(station: Station, R: Array, t: Array) -> Station:
    q = Rotation.from_matrix(R).as_quat()
    return replace(station, xyz=tuple(map(float, t)), quat_xyzw=tuple(map(float, q)))  # type: ignore[arg-type]


def _rotation_between(v: Array, p: Array) -> tuple[Array, Array]:
    """R, t with p = R v + t in the sense of least squares (Kabsch)."""
    a, b = v - v.mean(axis=0), p - p.mean(axis=0)
    u, _, wt = np.linalg.svd(b.T @ a)
    R = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ wt))]) @ wt
    return R, p.mean(axis=0) - R @ v.mean(axis=0)


def _aligned(
    data: _Rows, stations: tuple[Station, ...], markers: tuple[Marker, ...]
) -> tuple[tuple[Station, ...], tuple[Marker, ...]]:
    """Unknown stations by alignment of the point clouds, markers as stated."""
    m = np.array([m.xyz for m in markers])[data.marker]
    p = data.p + np.einsum("nij,nj->ni", data.B, m)
    out = []
    for i, s in enumerate(stations):
        mine = data.station == i
        out.append(s if s.known or mine.sum() < 3 else _posed(s, *_rotation_between(data.v[mine], p[mine])))
    return tuple(out), markers


def _closed_form(
    data: _Rows, stations: tuple[Station, ...], markers: tuple[Marker, ...]
) -> tuple[tuple[Station, ...], tuple[Marker, ...]]:
    """A v + t - B m = p, linear in A (any 3x3), t and m; then the rotation nearest to A, and t and m again."""
    n = len(data.v)
    free_s = [i for i, s in enumerate(stations) if not s.known]
    free_m = [i for i, m in enumerate(markers) if not m.known]
    right = data.p.copy()
    blocks = []
    for i, s in enumerate(stations):
        mine = (data.station == i)[:, None]
        if i in free_s:
            centre = data.v[mine[:, 0]].mean(axis=0) if mine.any() else np.zeros(3)
            block = np.zeros((n, 3, 12))
            for a in range(3):
                block[:, a, 3 * a : 3 * a + 3] = np.where(mine, data.v - centre, 0.0)
                block[:, a, 9 + a] = mine[:, 0]
            blocks.append(block)
        else:
            right -= np.where(mine, data.v @ s.R_in_base.T + np.array(s.xyz), 0.0)
    for i, m in enumerate(markers):
        mine = data.marker == i
        if i in free_m:
            blocks.append(-data.B * mine[:, None, None])
        else:
            right += mine[:, None] * (data.B @ np.array(m.xyz))
    system = np.concatenate(blocks, axis=2).reshape(3 * n, -1)
    x = np.linalg.lstsq(system, right.reshape(-1), rcond=1e-9)[0]
    new_m = list(markers)
    for j, i in enumerate(free_m):
        new_m[i] = replace(markers[i], xyz=tuple(map(float, x[12 * len(free_s) + 3 * j :][:3])))  # type: ignore[arg-type]
    return _aligned(data, stations, tuple(new_m))


def _refine(
    data: _Rows,
    stations: tuple[Station, ...],
    markers: tuple[Marker, ...],
    free_s: list[int],
    free_m: list[int],
    given: Sequence[tuple[float, float, float]],
) -> tuple[float, tuple[Station, ...], tuple[Marker, ...]]:
    """Robust least squares about a start (Gauss-Newton, rows reweighted by a smooth absolute loss); its cost with the result."""
    stated = np.array([given[i] for i in free_m]).reshape(-1)
    n, s, m = len(data.v), list(stations), list(markers)
    columns = 6 * len(free_s) + 3 * len(free_m)
    held = 0.0

    def off() -> Array:
        return np.array([m[i].xyz for i in free_m]).reshape(-1) - stated

    for _ in range(REFINEMENTS):
        r = _residual(data, tuple(s), tuple(m))
        typical = max(float(np.median(np.abs(r))), 1e-7)
        weight = 1.0 / np.sqrt(1.0 + (r / (3.0 * typical)) ** 2)
        J = np.zeros((n, 3, columns))
        for j, i in enumerate(free_s):
            mine = data.station == i
            turned = data.v[mine] @ s[i].R_in_base.T
            J[mine, :, 6 * j : 6 * j + 3] = np.eye(3)
            J[mine, :, 6 * j + 3 : 6 * j + 6] = cross_matrices(-turned)
        for j, i in enumerate(free_m):
            mine = data.marker == i
            at = 6 * len(free_s) + 3 * j
            J[mine, :, at : at + 3] = -data.B[mine]
        flat, w = J.reshape(-1, columns), weight.reshape(-1)
        G, h = flat.T @ (flat * w[:, None]), -flat.T @ (w * r.ravel())
        # a tool that never tilts does not show how long it is: without this a marker would wander off by metres
        held = typical**2 * n / POSITION_DOUBT**2
        tail = np.arange(6 * len(free_s), columns)
        G[tail, tail] += held
        h[tail] -= held * off()
        step = np.linalg.solve(G + 1e-12 * max(float(G.diagonal().max()), 1e-30) * np.eye(columns), h)
        for j, i in enumerate(free_s):
            d = step[6 * j : 6 * j + 6]
            s[i] = _posed(s[i], Rotation.from_rotvec(d[3:]).as_matrix() @ s[i].R_in_base, np.array(s[i].xyz) + d[:3])
        for j, i in enumerate(free_m):
            d = step[6 * len(free_s) + 3 * j :][:3]
            m[i] = replace(m[i], xyz=tuple(map(float, np.array(m[i].xyz) + d)))  # type: ignore[arg-type]
        if np.abs(step).max(initial=0.0) < 1e-9:
            break
    # the median: rows that are no measurement must not choose between starts
    middle = float(np.median(np.linalg.norm(_residual(data, tuple(s), tuple(m)), axis=1)))
    return n * middle**2 + held * float((off() ** 2).sum()), tuple(s), tuple(m)
