# SPDX-License-Identifier: Apache-2.0
"""A session as the screen shows it: places in the cell frame, columns to colour by, variables of formulas."""

from __future__ import annotations

import numpy as np

from ..effects import known_effects
from ..effects.of_session import scene_of
from ..session import Session
from ..typing import Array
from .plain import SessionView


def view_of(session: Session) -> SessionView:
    """What there is to draw of a session, in base_link; positions in the cell frame where base_link rides on an axis."""
    scene = scene_of(session)
    ride = base_in_cell(session)
    columns: dict[str, Array] = {f"tau_{k + 1}": scene.load_torque()[:, k] for k in range(scene.n_joints)}
    slides = scene.kin.is_prismatic
    columns |= {f"joint_{k + 1}": session.q[:, k] if slides[k] else np.degrees(session.q[:, k]) for k in range(scene.n_joints)}
    columns |= {"stamp": session.stamp, "pose": session.pose.astype(float), "load case": session.load_case.astype(float)}
    columns |= {f"force_{a}": session.force_in_tool[:, i] for i, a in enumerate("xyz")}
    columns |= {f"ext_{n}": v for n, v in session.ext.items()} | {f"temp_{n}": v for n, v in session.temperature.items()}
    columns |= {"reach": np.linalg.norm(session.p_tcp_in_base, axis=1)}
    units = {"tau": "N m", "joint": "deg", "force": "N", "stamp": "s", "temp": "degC", "reach": "m"}
    units = {name: units.get(name.split("_")[0], "") for name in columns}
    units |= {f"joint_{k + 1}": "m" for k in np.flatnonzero(slides)}
    joints = np.concatenate([np.zeros((len(session), 1, 3)), scene.kin.origin, scene.kin.p_tcp[:, None, :]], axis=1)
    reference = session.reference_row()
    commanded = np.where((reference >= 0)[:, None], session.p_tcp_in_base - session.p_tcp_in_base[np.maximum(reference, 0)], 0.0)
    noise = session.noise
    return SessionView(
        name=session.name,
        kind=session.kind,
        serial=session.serial,
        pose=session.pose,
        load_case=session.load_case,
        case_names=tuple(session.case_name(int(j)) for j in session.load_case),
        repeat=session.repeat,
        stamp=session.stamp,
        joints=joints + ride[:, None, :],
        p_tcp=session.p_tcp_in_base + ride,
        commanded=commanded,
        force=session.force_in_tool,
        torque=session.torque_in_tool,
        tau=scene.tau,
        columns={k: v for k, v in columns.items() if np.isfinite(v).any() and np.ptp(v[np.isfinite(v)]) > 0},
        units=units,
        stations={s.name: tuple(np.asarray(s.xyz) + np.median(ride, axis=0)) for s in session.stations if s.stated},
        station=tuple(session.stations[i].name for i in session.station) if session.stations else (),
        claimed_noise={k: float(v) for k, v in vars(noise).items() if v},
        notes=session.notes,
        n_joints=scene.n_joints,
        variables=_variables(scene.n_joints, tuple(session.ext), tuple(session.temperature)),
        effects={e.id: e.label for e in known_effects().values()},
    )


def _variables(joints: int, ext: tuple[str, ...], temperature: tuple[str, ...]) -> tuple[str, ...]:
    per_axis = [f"{n}_{k + 1}" for n in ("tau", "tau_g", "q", "step") for k in range(joints)]
    plain = ["tau", "tau_g", "q", "step", "f_x", "f_y", "f_z", "b_x", "b_y", "b_z", "x", "y", "z", "t", "dwell"]
    return (*plain, *per_axis, *(f"temp_{n}" for n in temperature), *(f"ext_{n}" for n in ext))


def base_in_cell(session: Session) -> Array:
    """Where base_link is in the cell frame in each row, by its prismatic axes, (n, 3), m."""
    out = np.zeros((len(session), 3))
    for axis in session.ext_axes:
        if axis.kind == "prismatic" and axis.name in session.ext:
            out += session.ext[axis.name][:, None] * np.asarray(axis.axis)
    return out
