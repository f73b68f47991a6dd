# SPDX-License-Identifier: Apache-2.0
"""Force and motion of the TCP from a recording, in base_link."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import RecordingError
from ..recording import BagReader
from ..typing import Array


@dataclass(frozen=True)
class ForceAndMotion:
    """Stamps in s; force (n, 3), N, and p (m, 3), m, in base_link; tracker (k, 3), m, in the station's frame, may be empty."""

    force_stamp: Array
    force: Array
    pose_stamp: Array
    p: Array
    tracker_stamp: Array
    tracker: Array


def read_force_and_motion(path: Path, wrench: str, pose: str, tracker: str) -> ForceAndMotion:
    """Read a recording. Raises RecordingError: a topic is missing."""
    force: list[tuple[float, list[float]]] = []
    turned: list[tuple[float, list[float], list[float]]] = []
    points: list[tuple[float, list[float]]] = []
    bag = BagReader(path)
    names = {n: k for k, topic in (("wrench", wrench), ("pose", pose), ("tracker", tracker)) for n in (topic, f"/{topic}")}
    for raw in bag.messages(names):
        message = bag.decode(raw)
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        kind = names[raw.topic.name]
        if kind == "wrench":
            force.append((stamp, _xyz(message.wrench.force)))
        elif kind == "pose":
            o = message.pose.orientation
            turned.append((stamp, _xyz(message.pose.position), [o.x, o.y, o.z, o.w]))
        else:
            points.append((stamp, _xyz(message.point)))
    for rows, topic in ((force, wrench), (turned, pose)):
        if len(rows) < 2:
            raise RecordingError(f"{path}: {len(rows)} messages on '{topic}'; irec inspect shows what is in it")
    pose_stamp = np.array([t for t, _, _ in turned])
    force_stamp = np.array([t for t, _ in force])
    nearest = np.clip(np.searchsorted(pose_stamp, force_stamp), 0, len(turned) - 1)
    R = Rotation.from_quat([turned[i][2] for i in nearest]).as_matrix()
    in_base = (R @ np.array([f for _, f in force])[:, :, None])[..., 0]
    order = [int(i) for i in np.argsort([t for t, _ in points], kind="stable")]
    return ForceAndMotion(
        force_stamp, in_base, pose_stamp, np.array([p for _, p, _ in turned]),
        np.array([points[i][0] for i in order]), np.array([points[i][1] for i in order]).reshape(-1, 3),
    )  # fmt: skip


def _xyz(v: Any) -> list[float]:
    return [v.x, v.y, v.z]
