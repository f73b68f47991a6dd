# SPDX-License-Identifier: Apache-2.0
"""Rows of a loaded session that are wrong by so much that no model is needed to see it: forces, joint angles."""

from __future__ import annotations

import numpy as np

from ..session.data import Session
from ..typing import BoolArray, IntArray
from .bad_rows import BadRow, place
from .observe import Observation
from .settings import OUTLIERS


def wrong_forces(observation: Observation) -> list[BadRow]:
    """Rows whose force differs from that of the same load case at other poses by a factor that no contact makes."""
    session = observation.session
    if session.kind != "loaded":
        return []
    rows = observation.rows
    size = np.linalg.norm(session.force_in_tool[rows], axis=1)
    found = []
    for case in np.unique(session.load_case[rows]):
        mine = np.flatnonzero(session.load_case[rows] == case)
        usual = float(np.median(size[mine]))
        if usual <= 0.0 or len(mine) < 4:
            continue
        for i in mine[(size[mine] < usual / OUTLIERS.force_factor) | (size[mine] > usual * OUTLIERS.force_factor)]:
            ratio = size[i] / usual
            unit = "; looks like kN for N" if 3e-4 < ratio < 3e-3 else "; looks like N for kN" if 300 < ratio < 3000 else ""
            text = f"{place(session, int(rows[i]))}: force {size[i]:.4g} N, other poses {usual:.4g} N in this load case{unit}"
            found.append(BadRow("force", (int(rows[i]),), float("nan"), text))
    return found


def wrong_joints(observation: Observation) -> list[BadRow]:
    """Rows of a loaded session whose joint angles are far from those of their pose."""
    session = observation.session
    if session.kind != "loaded":
        return []
    q = session.q
    _, index = np.unique(np.column_stack([session.pose, session.repeat]), axis=0, return_inverse=True)
    index = index.ravel()
    middle = np.empty_like(q)
    for mine in _grouped(index):
        middle[mine] = np.median(q[mine], axis=0)
    off = np.abs(q - middle).max(axis=1)
    limit = np.full(len(q), max(OUTLIERS.elsewhere_rad, OUTLIERS.elsewhere_usual * float(np.median(off))))
    for case in np.unique(session.load_case):
        of_case = session.load_case == case
        usual = float(np.median(off[of_case]))
        if usual > limit[of_case][0]:  # so it was measured: a tool that is aligned at contact stands otherwise in references
            spread = 1.4826 * float(np.median(np.abs(off[of_case] - usual)))
            limit[of_case] = usual + OUTLIERS.elsewhere_sigmas * spread
    found = []
    suspects = np.flatnonzero(off > limit)
    seen = _seen_there(session, suspects, index)
    for row in suspects[~seen]:
        group = np.flatnonzero(index == index[row])
        if (off[group] > limit[group]).sum() * 2 > len(group):
            continue  # the pose has no angles of its own
        away = np.abs(q - q[row]).max(axis=1)
        away[index == index[row]] = np.inf
        twin = int(np.argmin(away))
        like = f"those of pose {session.pose[twin]}" if away[twin] < 0.5 * off[row] else "not those of this pose"
        text = f"{place(session, int(row))}: joint angles up to {off[row]:.3f} rad from the pose's other rows; look like {like}"
        spoilt = group[session.load_case[group] != 0] if session.load_case[row] == 0 else np.array([row])
        found.append(BadRow("joints", tuple(int(r) for r in spoilt), float("nan"), text))
    return found


def _seen_there(session: Session, rows: IntArray, index: IntArray) -> BoolArray:
    """Whether the marker of some rows was seen to be as far from its place in the pose's other rows as joint angles say, (k,).

    Near a singularity the wrist turns by far without a mistake.

    Args:
        index: which rows are of one pose and repeat.
    """
    out = np.zeros(len(rows), dtype=bool)
    if not len(rows):
        return out
    kin = session.robot.kinematics(session.q)
    xyz = np.array([m.xyz for m in session.markers])[session.marker]
    believed = kin.p_tcp + np.einsum("nij,nj->ni", kin.R_tool, xyz)
    R = np.stack([s.R_in_base for s in session.stations])[session.station]
    measured = np.einsum("nij,nj->ni", R, session.p_marker_in_station)
    alike = session.marker_seen & session.on_tool
    for i, row in enumerate(rows):
        others = np.flatnonzero((index == index[row]) & alike & (session.station == session.station[row]))
        others = others[(others != row) & (session.marker[others] == session.marker[row])]
        if alike[row] and len(others):
            moved, seen = (np.median(x[row] - x[others], axis=0) for x in (believed, measured))
            most = max(OUTLIERS.seen_there_m, OUTLIERS.seen_there * float(np.linalg.norm(moved)))
            out[i] = np.linalg.norm(moved - seen) < most
    return out


def _grouped(index: IntArray) -> list[IntArray]:
    order = np.argsort(index, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(index[order])) + 1)
