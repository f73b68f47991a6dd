# SPDX-License-Identifier: Apache-2.0
"""Where the tracker stands this time, from the robot's own positions: nobody puts a station back to a tenth of a millimetre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..effects.of_session import marker_by_controller
from ..session import Session, Station
from ..typing import Array, IntArray, Json

FEWEST_POSES = 3
SPREAD = 0.15  # m: second-largest extent of the positions below which their rotation is not found from them
NOTE_M, NOTE_RAD = 2e-3, 1e-3  # distance from the stated pose that is worth a note


def with_stations_found(session: Session) -> Session:
    """A loaded session whose station poses are fitted to the controller's marker positions, rigidly.

    A station that sees too few poses, or poses on one line, keeps its stated pose, and so do all where an external axis turns
    the robot. With a rail the pose found is the one in base_link at rail 0, as it is stated in a session. What remains wrong by
    the robot's own absolute accuracy (some 0.5 mrad) has to be allowed for by whoever compares displacements.
    """
    if any(a.kind != "prismatic" for a in session.ext_axes):
        return session
    believed = marker_by_controller(session, session.robot.kinematics(session.q)) + _carried(session)
    stations, notes = list(session.stations), list(session.notes)
    for i, station in enumerate(stations):
        rows = np.flatnonzero((session.station == i) & session.marker_seen)
        found = _rigid(session.p_marker_in_station[rows], believed[rows]) if _enough(session, rows, believed) else None
        if found is None:
            continue
        R, t = found
        stations[i] = replace(station, xyz=tuple(t.tolist()), quat_xyzw=tuple(Rotation.from_matrix(R).as_quat().tolist()))
        moved = float(np.linalg.norm(t - np.array(station.xyz)))
        turned = float(np.linalg.norm(Rotation.from_matrix(R @ station.R_in_base.T).as_rotvec()))
        if moved > NOTE_M or turned > NOTE_RAD:
            notes.append(
                f"tracker station {station.name} stands {1e3 * moved:.1f} mm and {1e3 * turned:.2f} mrad from where it is"
                " stated; its pose was found anew from the robot's positions"
            )
    return replace(session, stations=tuple(stations), notes=tuple(notes), meta=_stated(session, stations))


def _stated(session: Session, stations: Sequence[Station]) -> Json:
    """Content of session.yaml with the poses that were found, for whoever reads the session after it was written."""
    stated = session.meta.get("stations")
    if not isinstance(stated, list) or len(stated) != len(stations):
        return session.meta
    poses = [{"xyz": list(s.xyz), "quat_xyzw": list(s.quat_xyzw)} for s in stations]
    return {**session.meta, "stations": [{**old, **new} for old, new in zip(stated, poses, strict=True)]}


def _carried(session: Session) -> Array:
    """How far external axes have carried base_link from where they read 0, (n, 3), m."""
    way = [session.ext[a.name][:, None] * np.array(a.axis) for a in session.ext_axes if a.name in session.ext]
    return np.sum(way, axis=0) if way else np.zeros((len(session.pose), 3))


def _enough(session: Session, rows: IntArray, believed: Array) -> bool:
    if len(np.unique(session.pose[rows])) < FEWEST_POSES:
        return False
    extent = np.linalg.svd(believed[rows] - believed[rows].mean(axis=0), compute_uv=False) / np.sqrt(len(rows))
    return bool(extent[1] > SPREAD)


def _rigid(p_in_station: Array, p_in_base: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and translation (3,) that take points of the station (n, 3) to base_link (n, 3) with least squares."""
    a, b = p_in_station - p_in_station.mean(axis=0), p_in_base - p_in_base.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    D = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))])
    R = Vt.T @ D @ U.T
    return R, p_in_base.mean(axis=0) - R @ p_in_station.mean(axis=0)
