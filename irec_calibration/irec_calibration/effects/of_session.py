# SPDX-License-Identifier: Apache-2.0
"""The scene of a session: where the robot was, what acted on it, what observed it, and which row came before which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..robot import Kinematics, Payload
from ..robot.coupled import coupling
from ..session.data import Session
from ..session.registration import level_gravity, registered
from ..typing import Array, IntArray
from .scene import Scene
from .state import Arm, Gravity, Instruments, Load, Rows, View


def carrying(session: Session, payload: Payload | None) -> Session:
    """A loaded session with a payload where it states none."""
    stated = session.payload is not None or session.kind != "loaded"
    return session if stated or payload is None else replace(session, payload=payload)


def scene_of(session: Session, *, observe: str = "marker") -> Scene:
    """The scene of a session.

    Args:
        session: any session.
        observe: `marker` (identification: p_observed is where the controller believes the marker) or `tcp` (prediction).
    """
    kin = session.robot.kinematics(session.q)
    n = len(session)
    previous = _previous_row(session)
    has_previous = previous >= 0
    on_tool = session.on_tool
    p_observed = marker_by_controller(session, kin) if observe == "marker" else session.p_tcp_in_base
    from_station = modelled = None
    if observe == "marker" and session.contact is None:
        R = np.stack([s.R_in_base for s in session.stations])[session.station]
        from_station = np.einsum("nij,nj->ni", R, session.p_marker_in_station)
        modelled = p_observed - np.array([s.xyz for s in session.stations])[session.station]
    in_base = _gravity(session, kin)
    x, y, z = (float(v) for v in session.meta.get("sensor_axis_in_tool", (0.0, 0.0, 1.0)))
    branches = {n: v for n, v in session.ext.items() if n in session.robot.branch_joints}
    arm = Arm(
        session.robot, kin, session.q,
        step=np.where(has_previous[:, None], session.q - session.q[previous], 0.0),
        p_tcp=session.p_tcp_in_base,
        driven=np.array([name not in session.passive for name in session.robot.joint_names]),
        coupling=coupling(session.passive, session.robot.joint_names, session.q), repeatability=session.noise.robot_m,
    )  # fmt: skip
    return Scene(
        rows=Rows(
            session.kind, session.pose, session.repeat, session.load_case, session.stamp,
            load_since=np.where(has_previous, session.stamp[previous], session.stamp),
            reference=session.reference_row(), previous=previous, clock=session.clock,
        ),
        view=View(
            arm, p_observed, on_tool if observe == "marker" else np.ones(n, dtype=bool),
            # where the contact stands in for the tracker the arm stays where it touches, however far it is commanded
            sags=float(observe == "marker" and session.kind == "loaded" and session.contact is None),
            measured=observe == "marker",
        ),
        load=Load(arm, session.force_in_tool, session.torque_in_tool),
        gravity=Gravity(
            arm, in_base, arm.followed(session.robot.gravity_torque(session.q, in_base, session.payload, branches)),
            session.payload, branches,
        ),
        instruments=Instruments(
            session.station, tuple(s.name for s in session.stations), session.marker, tuple(m.name for m in session.markers),
            station_known=tuple(s.known or session.kind == "loaded" for s in session.stations),
            marker_known=tuple(m.known or session.kind == "loaded" for m in session.markers),
            measured_from_station=from_station, modelled_from_station=modelled, sensor_axis_in_tool=(x, y, z),
            by_contact=session.contact is not None,
        ),
        ext=session.ext,
        temperature=session.temperature,
    )  # fmt: skip


def _gravity(session: Session, kin: Kinematics) -> Array:
    """Gravity in base_link, m/s^2: as stated, else by a station that stands level."""
    if "gravity" not in session.meta and any(s.level for s in session.stations):
        level = level_gravity(registered(session, kin).stations)
        if level is not None:
            return level
    return np.asarray(session.gravity_in_base, dtype=float)


def marker_by_controller(session: Session, kin: Kinematics) -> Array:
    """Where the controller (or the URDF) believes the marker to be, in base_link, (n, 3), m."""
    xyz = np.array([m.xyz for m in session.markers])[session.marker]
    on_tool = session.on_tool
    p_on_tool = session.p_tcp_in_base + np.einsum("nij,nj->ni", kin.R_tool, xyz)
    return np.where(on_tool[:, None], p_on_tool, xyz)


def _previous_row(session: Session) -> IntArray:
    """Row before in time: within pose, repeat and marker (loaded) or the pose before with any marker (absolute)."""
    previous = np.full(len(session), -1)
    if session.clock == "none":
        return previous
    order = np.lexsort((session.load_case, session.stamp))
    if session.kind == "loaded":
        last: dict[tuple[int, int, int], int] = {}
        for i in order:
            key = (int(session.pose[i]), int(session.repeat[i]), int(session.marker[i]))
            # the robot is relaxed at its reference: history begins there
            if session.load_case[i] != 0:
                previous[i] = last.get(key, -1)
            last[key] = int(i)
        return previous
    current, before = -1, -1
    for i in order:
        if current >= 0 and session.pose[i] != session.pose[current]:
            before = current
        current = int(i)
        previous[i] = before
    return previous
