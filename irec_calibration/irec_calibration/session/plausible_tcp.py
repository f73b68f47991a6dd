# SPDX-License-Identifier: Apache-2.0
"""Whether the TCP columns of a session are where joint angles and robot description have it, and what would mend it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from ..errors import RobotError
from ..typing import Array, BoolArray, IntArray
from .data import Session

TCP_M = 0.01  # m; controllers and descriptions differ by a calibrated tool and links, not more
BEST_OF_OTHERS = 0.2  # an alteration that brings a misfit below this share of it, and below the limit, is named
MANY_ROWS = 0.2  # of the rows: these are no mistakes of single rows
DISTINCT = 0.3  # of how far rows beyond the limit are off (median), that the others may be


def tcp(session: Session) -> tuple[list[str], list[str]]:
    """TCP columns against forward kinematics of the joint columns: doubts and notes."""
    q, p = session.q, session.p_tcp_in_base
    rows = some_rows(len(q))
    off = _apart(session, q, rows)
    if off > TCP_M:
        kin = session.robot.kinematics(q[rows])
        hint = mended(off, TCP_M, {name: _apart(session, changed, rows) for name, changed in altered_joints(q)})
        if not hint:
            scales = ((1e-3, "tcp_* in mm"), (1e3, "lengths of robot.urdf in m, not mm (or tcp_* in km)"), (1e-2, "tcp_* in cm"))
            hint = mended(off, TCP_M, {what: median_norm(kin.p_tcp - p[rows] * f) for f, what in scales})
        if not hint:
            hint = _constant_difference(session, rows, p[rows] - kin.p_tcp, off) or standing(session)
        return [
            f"tcp_* is {off:.4g} m (median) from the forward kinematics of joint_*, at most {TCP_M} m is expected{hint}; check "
            "joint columns, units and robot description"
        ], []
    apart = np.linalg.norm(session.robot.kinematics(q).p_tcp - p, axis=1)
    return beyond_limit(session, apart > TCP_M, apart, "tcp_*", "from the forward kinematics of joint_*", TCP_M)


def beyond_limit(
    session: Session, beyond: BoolArray, apart: Array, what: str, where: str, limit: float
) -> tuple[list[str], list[str]]:
    """Rows beyond a limit that the median keeps: a doubt where they are many, else a note."""
    if not beyond.any():
        return [], []
    i = int(np.argmax(beyond))
    said = (
        f"{what} is more than {limit} m {where} in {int(beyond.sum())} of {len(beyond)} rows (median of these "
        f"{np.median(apart[beyond]):.3g} m), first in pose {session.pose[i]}, load_case {session.load_case[i]}"
    )
    if beyond.mean() <= MANY_ROWS:
        return [], [said]
    if not beyond.all() and np.median(apart[~beyond]) > DISTINCT * np.median(apart[beyond]):
        return [], []  # all are about at the limit: nothing happened to some of them
    since = ", and in every row from there on" if beyond[i:].mean() > 0.95 else ""
    return [f"{said}{since}: another tool or robot, or a joint that is no longer read?"], []


def _constant_difference(session: Session, rows: IntArray, difference: Array, off: float) -> str:
    """Whether one constant of the tool or of a joint explains where the TCP is, in words."""
    kin = session.robot.kinematics(session.q[rows])
    in_tool = np.einsum("nji,nj->ni", kin.R_tool, difference)
    middle = np.median(in_tool, axis=0)
    if median_norm(in_tool - middle) < min(BEST_OF_OTHERS * off, TCP_M):
        x, y, z = 1e3 * middle
        return f"; it would fit with tool0 at ({x:.1f}, {y:.1f}, {z:.1f}) mm from where the description has it, in tool0"
    J = kin.jacobian(kin.p_tcp)
    found = {}
    for k in range(J.shape[2]):
        column = J[:, :, k]
        angle = float(np.median((column * difference).sum(axis=1) / np.maximum((column**2).sum(axis=1), 1e-12)))
        unit = f"{angle:.4g} m" if session.robot.is_prismatic[k] else f"{np.rad2deg(angle):.3g} deg"
        found[f"joint_{k + 1} larger by {unit}"] = median_norm(difference - angle * column)
    return mended(off, TCP_M, found)


def _apart(session: Session, q: Array, rows: IntArray) -> float:
    try:
        return median_norm(session.robot.kinematics(q[rows]).p_tcp - session.p_tcp_in_base[rows])
    except RobotError:
        return np.inf


def altered_joints(q: Array) -> Iterator[tuple[str, Array]]:
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


def mended(misfit: float, limit: float, others: dict[str, float]) -> str:
    """The alteration that brings the misfit below the limit and far below what it is, in words; else empty."""
    best = min(others, key=lambda k: others[k])
    return f"; it would fit with {best}" if others[best] < min(BEST_OF_OTHERS * misfit, limit) else ""


def standing(session: Session) -> str:
    """Joints that read the same in every row, in words."""
    still = [k for k in range(session.q.shape[1]) if np.ptp(session.q[:, k]) == 0.0]
    moves = len(still) < session.q.shape[1] and len(session.poses) > 2
    return "".join(f"; joint_{k + 1} has the same value in every row" for k in still) if moves else ""


def some_rows(n: int, most: int = 400) -> IntArray:
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))


def median_norm(v: Array) -> float:
    return float(np.median(np.linalg.norm(v, axis=1)))
