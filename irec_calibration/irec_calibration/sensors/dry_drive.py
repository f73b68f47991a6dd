# SPDX-License-Identifier: Apache-2.0
"""Both sides of the gears on a drive without process, from a recording: what secondary encoders read that no process causes.

Gravity winds the gears up, and encoders are eccentric; on the same course it is the same under the process. Rows are told at the
stamps of the link-side angles, with the motor-side angles between their samples, and averaged over short ways.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import RecordingError
from ..joint_states import contradiction, named_twice
from ..recording import BagReader
from ..typing import Array

LINK = "link_"  # before the name of a joint: the column of its link-side angle
APART = 1e-3  # rad, any joint, between two rows
GAP = 0.05  # s between motor-side samples, over which nothing is told
_LARGEST = 0.05  # rad between both sides; more are angles of different joints or units


@dataclass(frozen=True)
class DryDriveTable:
    """Joint names, motor-side angles q (k, n) and link-side ones (k, n), rad; samples: of the recording that rows are made of."""

    names: tuple[str, ...]
    q: Array
    link: Array
    samples: int


def read_dry_drive(file: Path, joints: str, links: str) -> DryDriveTable:
    """Read a recording with joint states of both sides; the link-side message may name them in another order.

    Raises:
        RecordingError: a topic or a joint is missing, values are not finite or of different joints, or nothing moves.
    """
    bag = BagReader(file)
    kinds = {n: kind for kind, topic in (("motor", joints), ("link", links)) for n in (topic, f"/{topic}")}
    found: dict[str, list[tuple[float, list[float]]]] = {"motor": [], "link": []}
    names: dict[str, tuple[str, ...]] = {}
    for raw in bag.messages(kinds):
        message, kind = bag.decode(raw), kinds[raw.topic.name]
        now = tuple(message.name)
        if names.setdefault(kind, now) != now:
            raise RecordingError(f"{file}: joints on '{raw.topic.name}' are named {now}, before they were {names[kind]}")
        if why := contradiction(named_twice(now, set(now)), message.position):
            raise RecordingError(f"{file}: '{raw.topic.name}': {why}")
        if len(message.position) == len(now):
            found[kind].append((message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, list(message.position)))
    for kind, topic in (("motor", joints), ("link", links)):
        if len(found[kind]) < 2:
            raise RecordingError(f"{file}: {len(found[kind])} messages on '{topic}'; irec inspect shows what is in it")
    wanted = names["link"]
    missing = [n for n in wanted if n not in names["motor"]]
    if missing:
        raise RecordingError(f"{file}: '{links}' names joints that '{joints}' does not have: {', '.join(missing)}")
    t, q = _sorted(found["motor"])
    stamps, link = _sorted(found["link"])
    if not (np.isfinite(q).all() and np.isfinite(link).all()):
        raise RecordingError(f"{file}: joint angles hold values that are not finite")
    after = np.searchsorted(t, stamps)
    exact = np.isin(stamps, t)
    inside = exact | ((after > 0) & (after < len(t)))
    inside &= exact | (t[np.clip(after, 0, len(t) - 1)] - t[np.clip(after - 1, 0, len(t) - 1)] <= GAP)
    if not inside.any():
        raise RecordingError(f"{file}: no link-side angles have motor-side ones within {GAP:g} s before and after")
    order = [names["motor"].index(n) for n in wanted]
    motor = np.stack([np.interp(stamps[inside], t, x) for x in q[:, order].T], axis=1)
    link = link[inside]
    off = float(np.abs(link - motor).max())
    if off > _LARGEST:
        raise RecordingError(
            f"{file}: both sides of a gear differ by {off:.3f} rad, limit {_LARGEST:g} rad: other joints or units?"
        )
    return DryDriveTable(wanted, *_thinned(motor, link), int(inside.sum()))


def _sorted(rows: list[tuple[float, list[float]]]) -> tuple[Array, Array]:
    rows = sorted(rows, key=lambda row: row[0])
    stamps = np.array([t for t, _ in rows])
    new = np.r_[True, np.diff(stamps) > 0.0]
    return stamps[new], np.array([x for _, x in rows], dtype=float)[new]


def _thinned(motor: Array, link: Array) -> tuple[Array, Array]:
    """Means over ways of APART."""
    way = np.r_[0.0, np.cumsum(np.abs(np.diff(motor, axis=0)).max(axis=1))]
    _, group = np.unique(np.floor(way / APART).astype(int), return_inverse=True)
    count = np.bincount(group)
    mean = [np.stack([np.bincount(group, x) / count for x in side.T], axis=1) for side in (motor, link)]
    return mean[0], mean[1]
