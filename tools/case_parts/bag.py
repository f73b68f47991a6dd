# SPDX-License-Identifier: Apache-2.0
"""Recordings (MCAP) of simulated courses and taps, with the topics of the nodes, for `irec latency` and `irec modes`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irec_calibration.typing import Array
from irec_sim.kinematics import quaternion_of_rotation
from irec_sim.production.ways import PERIOD
from mcap_ros2.writer import Writer

_HEADER = "std_msgs/Header header\n"
_LINE = "=" * 80
_STAMP = f"{_LINE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{_LINE}\n" + (
    "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
_VECTOR = f"{_LINE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
_POINT = f"{_LINE}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
_TYPES = {
    "geometry_msgs/msg/WrenchStamped": _HEADER
    + "geometry_msgs/Wrench wrench\n"
    + _STAMP
    + f"{_LINE}\nMSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"
    + _VECTOR,
    "geometry_msgs/msg/PoseStamped": _HEADER
    + "geometry_msgs/Pose pose\n"
    + _STAMP
    + f"{_LINE}\nMSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    + _POINT
    + f"{_LINE}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/msg/PointStamped": _HEADER + "geometry_msgs/Point point\n" + _STAMP + _POINT,
}


def _xyz(v: Array) -> dict[str, float]:
    return {"x": float(v[0]), "y": float(v[1]), "z": float(v[2])}


def write_bag(
    path: Path, force_in_tool: Array, p_tcp: Array, R_tool: Array, tracker: Array | None = None, period: float = PERIOD
) -> Path:
    """wrench in tool0, tcp_pose by the controller in base_link, tracker/point of the tool in base_link where it is given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(file)
        schema = {name: writer.register_msgdef(name, text) for name, text in _TYPES.items()}
        for k in range(len(force_in_tool)):
            at = 1_000_000_000_000 + round(k * period * 1e9)
            stamp = {"sec": at // 10**9, "nanosec": at % 10**9}

            def put(topic: str, kind: str, frame: str, at: int = at, stamp: dict[str, int] = stamp, **content: object) -> None:
                message = {"header": {"stamp": stamp, "frame_id": frame}, **content}
                writer.write_message(topic, schema[f"geometry_msgs/msg/{kind}"], message, at, at)

            put("wrench", "WrenchStamped", "tool0", wrench={"force": _xyz(force_in_tool[k]), "torque": _xyz(np.zeros(3))})
            turn = quaternion_of_rotation(R_tool[k])
            put(
                "tcp_pose",
                "PoseStamped",
                "base_link",
                pose={"position": _xyz(p_tcp[k]), "orientation": {**_xyz(turn), "w": float(turn[3])}},
            )
            if tracker is not None:
                put("tracker/point", "PointStamped", "base_link", point=_xyz(tracker[k]))
        writer.finish()
    return path
