# SPDX-License-Identifier: Apache-2.0
"""Rows that are wrong by so much that no model is needed to see it: forces, joint angles; and what was there in their place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..session.data import Session
from ..session.plausible_place import MARKER_M
from ..session.plausible_tcp import MANY_ROWS, TCP_M
from ..typing import Array, BoolArray, IntArray
from .bad_rows import BadRow, place
from .settings import OUTLIERS

TO_NORMAL = 1.4826  # standard deviations of a normal distribution in its median absolute deviation


def mended(session: Session) -> Session:
    """A session with what was there in place of wrong forces and joint angles, as far as that is known: what the other rows of
    the load case or pose have, in an absolute session the commanded angles.

    The rows count for nothing by themselves. This is for what comes after them: what friction, creep and play keep of a load is
    kept of the load that was there, and a step begins where the robot was.
    """
    if session.kind == "absolute":
        return _where_commanded(session)
    loaded = np.flatnonzero(session.load_case != 0)
    of_force, of_angles = wrong_forces(session, loaded), _elsewhere(session)
    if not of_force and not of_angles:
        return session
    force, q, p = session.force_in_tool.copy(), session.q.copy(), session.p_tcp_in_base.copy()
    wrong = [b.rows[0] for b in of_force]
    for row in wrong:
        alike = np.setdiff1d(loaded[session.load_case[loaded] == session.load_case[row]], wrong)
        force[row] = np.median(force[alike], axis=0)
    elsewhere = [row for row, _, _ in of_angles]
    for row, group, _ in of_angles:
        others = np.setdiff1d(group, elsewhere)
        like = others[np.argmin(np.abs(q[others] - np.median(q[others], axis=0)).max(axis=1))]  # of one row, so that both agree
        q[row], p[row] = q[like], p[like]
    return replace(session, force_in_tool=force, q=q, p_tcp_in_base=p)


def _where_commanded(session: Session) -> Session:
    rows = [row for row, _ in _not_commanded(session)]
    if not rows or session.q_target is None:
        return session
    q, p = session.q.copy(), session.p_tcp_in_base.copy()
    q[rows] = session.q_target[rows]
    if not session.has_tcp:
        p[rows] = session.robot.kinematics(q[rows]).p_tcp
    return replace(session, q=q, p_tcp_in_base=p)


def wrong_forces(session: Session, rows: IntArray) -> list[BadRow]:
    """Rows whose force differs from that of the same load case at other poses by a factor that no contact makes.

    Args:
        rows: of the session, to be looked at, (m,).
    """
    if session.kind != "loaded":
        return []
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


def wrong_joints(session: Session) -> list[BadRow]:
    """Rows whose joint angles are far from those of their pose, of a reference all rows that it is one of, and poses whose angles
    are those of no TCP or marker that was read there; in an absolute session from the commanded ones."""
    found = [BadRow("joints", (row,), float("nan"), text) for row, text in _not_commanded(session)]
    found += [BadRow("joints", tuple(int(r) for r in group), float("nan"), text) for group, text in _not_there(session)]
    for row, group, text in _elsewhere(session):
        spoilt = group[session.load_case[group] != 0] if session.load_case[row] == 0 else np.array([row])
        found.append(BadRow("joints", tuple(int(r) for r in spoilt), float("nan"), text))
    return found


def _not_commanded(session: Session) -> list[tuple[int, str]]:
    """Rows of an absolute session whose reported joint angles are far from the commanded ones, with the words."""
    if session.kind != "absolute" or session.q_target is None or not np.isfinite(session.q_target).all():
        return []
    off = np.abs(session.q - session.q_target).max(axis=1)
    limit = max(OUTLIERS.elsewhere_rad, OUTLIERS.elsewhere_usual * float(np.median(off)))
    text = "joint angles up to {:.3f} rad from the commanded ones; look like {}"
    suspects = [int(row) for row in np.flatnonzero(off > limit)]
    return [(row, f"{place(session, row)}: {text.format(off[row], _looks_like(session, row, off[row]))}") for row in suspects]


def _looks_like(session: Session, row: int, off: float) -> str:
    """Whose joint angles those of a row are, that are `off` rad from where they should be."""
    away = np.abs(session.q - session.q[row]).max(axis=1)
    away[(session.pose == session.pose[row]) & (session.repeat == session.repeat[row])] = np.inf
    twin = int(np.argmin(away))
    return f"those of pose {session.pose[twin]}" if away[twin] < 0.5 * off else "not those of this pose"


def _elsewhere(session: Session) -> list[tuple[int, IntArray, str]]:
    """Rows of a loaded session whose joint angles are far from those of their pose, with all rows of the pose and the words."""
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
            spread = TO_NORMAL * float(np.median(np.abs(off[of_case] - usual)))
            limit[of_case] = usual + OUTLIERS.elsewhere_sigmas * spread
    found = []
    suspects = np.flatnonzero(off > limit)
    seen = _seen_there(session, suspects, index)
    for row in suspects[~seen]:
        group = np.flatnonzero(index == index[row])
        if (off[group] > limit[group]).sum() * 2 > len(group):
            continue  # the pose has no angles of its own
        like = _looks_like(session, int(row), off[row])
        text = f"{place(session, int(row))}: joint angles up to {off[row]:.3f} rad from the pose's other rows; look like {like}"
        found.append((int(row), group, text))
    return found


def _not_there(session: Session) -> list[tuple[IntArray, str]]:
    """Loaded rows of each pose of a loaded session all of whose joint angles put the TCP, or the marker, far from where the
    controller, or the tracker, has it, with the words; none where that is so in many."""
    if session.kind != "loaded":
        return []
    believed, seen = _markers(session)
    of_tcp = np.linalg.norm(session.robot.kinematics(session.q).p_tcp - session.p_tcp_in_base, axis=1)
    of_marker = np.where(session.marker_seen & session.on_tool, np.linalg.norm(seen - believed, axis=1), np.nan)
    out = []
    _, index = np.unique(np.column_stack([session.pose, session.repeat]), axis=0, return_inverse=True)
    for what, off, least in (("tcp_*", of_tcp, TCP_M), ("the marker", of_marker, MARKER_M)):
        known = np.isfinite(off)
        limit = max(least, OUTLIERS.not_there_usual * float(np.median(off[known]))) if known.any() else np.inf
        far = [g for g in _grouped(index.ravel()) if known[g].any() and np.nanmin(off[g]) > limit]
        if not far or sum(map(len, far)) > MANY_ROWS * len(off):
            continue
        for group in far:
            row = int(group[0])
            repeat = f", repeat {session.repeat[row]}" if np.any(session.repeat) else ""
            text = f"joint angles that put {what} {np.nanmedian(off[group]):.3g} m from where it was read"
            text = f"pose {session.pose[row]}{repeat}: {text}; look like {_looks_like(session, row, OUTLIERS.elsewhere_rad)}"
            out.append((group[session.load_case[group] != 0], text))
        return out
    return out


def _seen_there(session: Session, rows: IntArray, index: IntArray) -> BoolArray:
    """Whether the marker of some rows was seen to be as far from its place in the pose's other rows as joint angles say, (k,).

    Near a singularity the wrist turns by far without a mistake.

    Args:
        index: which rows are of one pose and repeat.
    """
    out = np.zeros(len(rows), dtype=bool)
    if not len(rows):
        return out
    believed, measured = _markers(session)
    alike = session.marker_seen & session.on_tool
    for i, row in enumerate(rows):
        others = np.flatnonzero((index == index[row]) & alike & (session.station == session.station[row]))
        others = others[(others != row) & (session.marker[others] == session.marker[row])]
        if alike[row] and len(others):
            moved, seen = (np.median(x[row] - x[others], axis=0) for x in (believed, measured))
            most = max(OUTLIERS.seen_there_m, OUTLIERS.seen_there * float(np.linalg.norm(moved)))
            out[i] = np.linalg.norm(moved - seen) < most
    return out


def _markers(session: Session) -> tuple[Array, Array]:
    """Where joint angles put the marker of each row on the tool, and where it was measured, in base_link, (n, 3) each, m."""
    kin, of = session.robot.kinematics(session.q), session.station
    xyz = np.array([m.xyz for m in session.markers])[session.marker]
    R, at = np.stack([s.R_in_base for s in session.stations])[of], np.array([s.xyz for s in session.stations])[of]
    measured = np.einsum("nij,nj->ni", R, session.p_marker_in_station) + at
    return kin.p_tcp + np.einsum("nij,nj->ni", kin.R_tool, xyz), measured


def _grouped(index: IntArray) -> list[IntArray]:
    order = np.argsort(index, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(index[order])) + 1)
