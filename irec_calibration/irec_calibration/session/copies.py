# SPDX-License-Identifier: Apache-2.0
"""Rows that stand under several poses or repeats although they were measured once, and readings that are none.

Copies count as independent evidence: with each row twice, an error is thought smaller by a third than it is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..errors import SessionError
from ..typing import Array, IntArray
from .data import Session

FINE = 1.0 / 3.0  # of the noise: a column whose last digit is smaller than that never reads the same by chance
DIGITS = 12
FEWEST_ALIKE = 3  # rows with one and the same marker
MOVED = 0.02  # m; by which the marker moved meanwhile


def check_copies(session: Session, where: Callable[[int], str]) -> None:
    """Refuse rows that are copies of others, and one and the same marker reading in several poses.

    Args:
        session: rows to check.
        where: index of a row -> its place, for the message.

    Raises:
        SessionError: names both places.
    """
    rows = np.flatnonzero(session.marker_seen)
    if len(rows) < 2 or not np.isfinite(session.p_marker_in_station[rows]).all():
        return
    reading = np.column_stack([session.station[rows], session.marker[rows], session.p_marker_in_station[rows]])
    of_reading = _group(reading)
    if len(np.unique(of_reading)) == len(rows):  # by far the most sessions
        return
    _check_rows(session, rows, of_reading, where)
    _check_unseen(session, rows, of_reading, where)


def _check_rows(session: Session, rows: IntArray, of_reading: IntArray, where: Callable[[int], str]) -> None:
    noise = FINE * session.noise.tracker_m
    if not 0.0 < _last_digit(session.p_marker_in_station[rows]) <= noise:
        return
    whole = np.column_stack([of_reading, session.q[rows], session.force_in_tool[rows]])
    group = _group(whole)
    first = np.unique(group, return_index=True)[1]
    copies = np.setdiff1d(np.arange(len(rows)), first)
    if not len(copies):
        return
    if len(np.unique(session.pose[rows[first]])) == 1 and len(session.poses) > 1:
        return  # every pose reads as the first one does: a rehearsal with readings that stand still, of which a note says so
    b = int(rows[copies[0]])
    a = int(rows[first[group[copies[0]]]])
    one, other = int(session.pose[b]), int(session.pose[a])
    what = f"pose {one} is a copy of pose {other}" if one != other else f"this row of pose {one} is a copy of another"
    raise SessionError(
        f"{where(b)}: {what} ({where(a)}): joint_*, force_* and marker_* are the same to the last digit, in {len(copies)} row(s) "
        "of the session; a second measurement has readings of its own, leave copies out"
    )


def _check_unseen(session: Session, rows: IntArray, of_reading: IntArray, where: Callable[[int], str]) -> None:
    """One reading in rows between which the marker moved: what a program writes where no marker was seen."""
    number, times = np.unique(of_reading, return_counts=True)
    for k in number[times >= FEWEST_ALIKE]:
        alike = rows[of_reading == k]
        if not session.on_tool[alike[0]] or len(np.unique(session.pose[alike])) < FEWEST_ALIKE or len(alike) == len(rows):
            continue
        if np.ptp(session.p_tcp_in_base[alike], axis=0).max() < MOVED or (_carried(session) and not _is_filler(session, alike)):
            continue
        x, y, z = session.p_marker_in_station[alike[0]]
        raise SessionError(
            f"{where(int(alike[0]))}: marker_* is ({x:g}, {y:g}, {z:g}) in {len(alike)} rows, between which the TCP moves by "
            f"{np.ptp(session.p_tcp_in_base[alike], axis=0).max():.3g} m: leave the three fields empty where the marker was not "
            "seen"
        )


def _carried(session: Session) -> bool:
    """Whether an external axis may move the base so that the marker stays."""
    return bool(session.ext_axes)


def _is_filler(session: Session, alike: IntArray) -> bool:
    """Whether a reading is a number that no tracker reads three times."""
    return len(np.unique(session.p_marker_in_station[alike[0]])) == 1


def _group(columns: Array) -> IntArray:
    """Number of the distinct row that each row is, (n,)."""
    columns = np.ascontiguousarray(columns + 0.0)  # no negative zeros: bytes are compared
    as_bytes = columns.view(np.dtype((np.void, columns.dtype.itemsize * columns.shape[1]))).ravel()
    return np.unique(as_bytes, return_inverse=True)[1].reshape(-1)


def _last_digit(values: Array) -> float:
    """Unit of the last decimal that is written in a column, m."""
    for digits in range(DIGITS):
        if np.allclose(np.round(values, digits), values, rtol=0.0, atol=1e-14):
            return float(10.0**-digits)
    return float(10.0**-DIGITS)
