# SPDX-License-Identifier: Apache-2.0
"""What is odd about the rows of a session and may be so: readings that stand still, saturate or are far from zero at rest.

These are notes. A robot may have five axes that move, a load cell may measure one axis, and a pose may be held on purpose.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..typing import Array, IntArray
from .data import Session
from .plausible_side import AXES, as_stated, constant

FEWEST_POSES = 6
FEWEST_ROWS = 5
HELD = 0.2  # of the poses through which a joint reads the same to the last digit while it never did before
SAME_POSE = 2e-3  # rad or m; poses nearer than that are one
AT_REST = 0.12  # of the force, that a reference may read
OFFSET = 0.05  # of the largest nominal force, by which all load cases may be off alike
STOPPED = 0.05  # of the loaded rows that read one and the same largest value
WARM_AIR = 45.0  # degC; air where robots and trackers stand is not that warm
AIR = ("ambient", "air", "room", "shop", "hall")


def remarks(session: Session) -> Iterator[str]:
    """What is odd about rows, a sentence each."""
    yield from _joints(session)
    yield from _air(session)
    if session.kind == "loaded" and (session.load_case != 0).any() and (session.load_case == 0).any():
        yield from _reference(session)
        yield from _channels(session)


def _joints(session: Session) -> Iterator[str]:
    """Joints that read the same everywhere, or from one pose on."""
    first = np.unique(session.pose, return_index=True)[1]
    first = first[np.argsort(session.stamp[first], kind="stable")] if session.clock != "none" else np.sort(first)
    if len(first) < FEWEST_POSES:
        return
    q = session.q[first]
    moves = np.ptp(q, axis=0) > SAME_POSE
    if not moves.any():
        yield f"all {len(first)} poses have the same joint angles (within {SAME_POSE:g} rad or m): nothing tells axes apart"
        return
    for k in range(q.shape[1]):
        if np.ptp(session.q[:, k]) == 0.0:
            yield f"joint_{k + 1} has the same value in every row: is it read? (an axis that is held shows nothing of itself)"
        elif moves[k]:
            yield from _held(session, first, k)


def _held(session: Session, first: IntArray, k: int) -> Iterator[str]:
    """Whether a joint that has another value in each pose keeps one to the last digit through many poses."""
    value = session.q[first, k]
    start = np.flatnonzero(np.r_[True, np.diff(value) != 0.0])
    length = np.diff(np.r_[start, len(value)])
    longest = int(length.argmax())
    n, at = int(length[longest]), int(start[longest])
    other = np.delete(value, np.arange(at, at + n))
    if n < max(FEWEST_ROWS, HELD * len(value)) or len(other) < FEWEST_ROWS or len(np.unique(other)) < len(other):
        return  # an axis that is put to round angles, or held now and then
    poses = session.pose[first[at : at + n]]
    within = session.q[np.isin(session.pose, poses), k]
    if np.ptp(within) > 0.0:
        return
    yield (
        f"joint_{k + 1} is {value[at]:.6g} to the last digit in {n} of {len(value)} poses, from pose {poses[0]} on, and "
        "another in each of the others: does its reading stand still?"
    )


def _air(session: Session) -> Iterator[str]:
    for name, values in session.temperature.items():
        if name.lower().startswith(AIR) and np.isfinite(values).any() and (middle := float(np.nanmedian(values))) > WARM_AIR:
            yield f"temp_{name} is {middle:.4g} degC (median), at most {WARM_AIR:g} is usual (F for degC?)"


def _reference(session: Session) -> Iterator[str]:
    """What the force reads at rest, and by how much load cases are off alike."""
    at_rest = session.load_case == 0
    usual = float(np.median(np.linalg.norm(session.force_in_tool[~at_rest], axis=1)))
    rest = np.median(session.force_in_tool[at_rest], axis=0)
    size = float(np.median(np.linalg.norm(session.force_in_tool[at_rest], axis=1)))
    if session.contact is None and size > AT_REST * usual:
        yield (
            f"the reference (load_case 0) reads {size:.4g} N (median; x, y, z: {rest[0]:.4g}, {rest[1]:.4g}, "
            f"{rest[2]:.4g}), near 0 is expected where {usual:.4g} N is the load: tool weight, bias of the sensor, or not "
            "relaxed?"
        )
    stated = as_stated(session)
    if stated is None:
        return
    for k in np.flatnonzero(np.nan_to_num(stated.slope) > 0.5):
        off = float(stated.off[k] - rest[k])
        if abs(off) > OFFSET * stated.largest:
            yield (
                f"force_{AXES[k]} is {off:.4g} N off load_cases in all load cases alike, and not in the reference: "
                "is the sensor turned, or was its bias set in between?"
            )


def _channels(session: Session) -> Iterator[str]:
    """Force channels that do not change, or stop at a largest value."""
    loaded: Array = session.force_in_tool[session.load_case != 0]
    varied = [len(np.unique(loaded[:, k])) > 0.5 * len(loaded) for k in range(3)]
    for k in range(3):
        value = constant(session, k)
        if value is not None and any(varied):
            yield f"force_{AXES[k]} is exactly {value:g} N in every loaded row: is it measured, or does it saturate?"
            continue
        values, times = np.unique(loaded[:, k], return_counts=True)
        if len(values) < FEWEST_ROWS:
            continue
        for i in (0, len(values) - 1):
            others = np.delete(times, [0, len(values) - 1])
            if (
                times[i] >= max(FEWEST_ROWS, STOPPED * len(loaded))
                and times[i] > 3 * max(int(others.max()), 1)
                and values[i] != 0.0
            ):
                yield (
                    f"force_{AXES[k]} reads exactly {values[i]:g} N in {times[i]} of {len(loaded)} loaded rows, and never more: "
                    "does it saturate?"
                )
