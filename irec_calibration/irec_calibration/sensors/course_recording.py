# SPDX-License-Identifier: Apache-2.0
"""A course from a recording at equal steps of time, from where the TCP begins to move to where it stops, and the force on it:
along the path, across it and along the tool's axis."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..errors import RecordingError
from ..joint_states import contradiction, named_twice
from ..recording import BagReader
from ..typing import Array

LEAST = 3.0  # s
_SLOW = 0.02  # share of the largest speed below which the TCP counts as standing


@dataclass(frozen=True)
class RecordedCourse:
    """Samples `period` s apart.

    Attributes:
        names: of the joints; q: (k, n), rad; share: of the way, 0 .. 1, (k,); R_tool: tool0 in base_link, (k, 3, 3).
        path: columns along, across, along the tool's z axis as far as it is square to the path, in base_link, (k, 3, 3).
        force: in tool0, (k, 3), N; zero rows where the recording holds no wrench.
        stamp: s; p: TCP by the controller in base_link, (k, 3), m.
    """

    names: tuple[str, ...]
    q: Array
    share: Array
    R_tool: Array
    path: Array
    force: Array
    period: float
    stamp: Array
    p: Array

    def along_path(self) -> Array:
        """Force in the axes of the path, (k, 3), N."""
        return _turned(self.path.swapaxes(1, 2), _turned(self.R_tool, self.force))

    def in_tool(self, along_path: Array) -> Array:
        """Force in tool0, (k, 3), N, from one in the axes of the path."""
        return _turned(self.R_tool.swapaxes(1, 2), _turned(self.path, along_path))


def read_course(
    file: Path, wrench: str, pose: str, joints: str, rate: float = 250.0, need_force: bool = True
) -> RecordedCourse:  # fmt: skip
    """Read a recording; topics: wrench at the TCP in tool0, TCP by the controller in base_link, joint states.

    Raises:
        RecordingError: a topic is missing, the joints change their names, or the TCP does not move for long enough.
    """
    bag = BagReader(file)
    names = {n: kind for kind, topic in (("wrench", wrench), ("pose", pose), ("joints", joints)) for n in (topic, f"/{topic}")}
    found: dict[str, list[tuple[float, list[float]]]] = {"wrench": [], "pose": [], "joints": []}
    joint_names: tuple[str, ...] = ()
    for raw in bag.messages(names):
        message, kind = bag.decode(raw), names[raw.topic.name]
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if kind == "wrench":
            f = message.wrench.force
            found[kind].append((stamp, [f.x, f.y, f.z]))
        elif kind == "pose":
            p, o = message.pose.position, message.pose.orientation
            found[kind].append((stamp, [p.x, p.y, p.z, o.x, o.y, o.z, o.w]))
        else:
            now = tuple(message.name)
            if joint_names and now != joint_names:
                raise RecordingError(f"{file}: joints on '{joints}' are named {now}, before they were {joint_names}")
            joint_names = now
            if why := contradiction(named_twice(now, set(now)), message.position):
                raise RecordingError(f"{file}: '{raw.topic.name}': {why}")
            found[kind].append((stamp, list(message.position)))
    table: dict[str, tuple[Array, Array]] = {}
    for kind, topic in (("wrench", wrench), ("pose", pose), ("joints", joints)):
        if len(found[kind]) < 2 and (kind != "wrench" or need_force):
            raise RecordingError(f"{file}: {len(found[kind])} messages on '{topic}'; irec inspect shows what is in it")
        rows = sorted(found[kind], key=lambda row: row[0])
        stamps = np.array([t for t, _ in rows])
        new = np.r_[True, np.diff(stamps) > 0.0] if len(stamps) else np.zeros(0, dtype=bool)
        table[kind] = stamps[new], np.array([x for _, x in rows])[new] if len(rows) else np.zeros((0, 3))
        if not np.isfinite(table[kind][1]).all():
            raise RecordingError(f"{file}: messages on '{topic}' hold values that are not finite")
    return _sampled(file, table, joint_names, 1.0 / rate)


def _sampled(file: Path, table: dict[str, tuple[Array, Array]], names: tuple[str, ...], period: float) -> RecordedCourse:
    there = [stamps for stamps, _ in table.values() if len(stamps)]
    t = np.arange(max(s[0] for s in there), min(s[-1] for s in there), period)
    if len(t) * period < LEAST:
        raise RecordingError(f"{file}: its topics overlap for {len(t) * period:.1f} s; {LEAST:g} s are needed")

    def even(kind: str, columns: slice) -> Array:
        stamps, values = table[kind]
        if not len(stamps):
            return np.zeros((len(t), 3))
        return np.stack([np.interp(t, stamps, x) for x in values[:, columns].T], axis=1)

    stamps, values = table["pose"]
    p, q, force = even("pose", slice(0, 3)), even("joints", slice(None)), even("wrench", slice(None))
    R = Slerp(stamps, Rotation.from_quat(values[:, 3:]))(np.clip(t, stamps[0], stamps[-1])).as_matrix()
    wide = max(3, round(0.1 / period) | 1)  # 0.1 s, so that single steps of the controller are no change of direction
    flat = np.stack([np.convolve(np.pad(x, wide // 2, mode="edge"), np.ones(wide) / wide, "valid") for x in p.T], axis=1)
    velocity = np.gradient(flat, period, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    moving = np.flatnonzero(speed > _SLOW * speed.max()) if speed.max() > 1e-4 else np.zeros(0, dtype=int)
    if len(moving) * period < LEAST:
        raise RecordingError(f"{file}: the TCP moves for {len(moving) * period:.1f} s; a course of {LEAST:g} s or more is needed")
    part = slice(moving[0], moving[-1] + 1)
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(flat[part], axis=0), axis=1))]
    along = velocity[part] / np.maximum(speed[part], 1e-9)[:, None]
    out = R[part, :, 2] - (R[part, :, 2] * along).sum(axis=1, keepdims=True) * along
    size = np.linalg.norm(out, axis=1, keepdims=True)
    if float(size.min()) < 0.1:
        raise RecordingError(f"{file}: the tool's z axis lies along the path; its force can't be told along and across the path")
    out /= size
    path = np.stack([along, np.cross(out, along), out], axis=2)
    return RecordedCourse(names, q[part], way / way[-1], R[part], path, force[part], period, t[part], p[part])


def _turned(R: Array, v: Array) -> Array:
    return np.asarray((R @ v[:, :, None])[..., 0])
