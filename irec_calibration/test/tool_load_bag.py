# SPDX-License-Identifier: Apache-2.0
"""A recording in which the AFP robot turns its tool to all sides without touching anything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irec_calibration.robot import Robot
from irec_calibration.sensors.tool_load import ToolLoad
from mcap_ros2.writer import Writer

URDF = Path(__file__).parents[2] / "config/robots/kr120_r2700_extra_ha.urdf"
HEADER = "\n" + "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + "=" * 80
HEADER += "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
VECTOR = "=" * 80 + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
JOINTS = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort" + HEADER
WRENCH = "std_msgs/Header header\ngeometry_msgs/Wrench wrench" + HEADER + "=" * 80
WRENCH += "\nMSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n" + VECTOR
HOME = np.array([0.0, -1.5708, 1.5708, 0.0, 0.7854, 0.0])
TURNS = ((0, 0, 0), (0, 0.9, 0), (0, -1.6, 0), (1.5, 0.8, 0), (-1.5, 0.8, 0), (0.7, -1.2, 1.5))
R_SENSOR_IN_TOOL = np.eye(3)


def write_bag(path: Path, load: ToolLoad) -> Path:
    """joint_states at 50 Hz, wrench_raw at 100 Hz with noise; 1.5 s of standing per orientation, 1 s of motion between them."""
    robot, rng = Robot.from_urdf(URDF), np.random.default_rng(0)
    poses = [HOME + np.r_[0, 0, 0, t] for t in TURNS]
    knots = np.cumsum([0.0, *[1.5, 1.0] * len(poses)])[:-1]
    angles = np.array([q for q in poses for _ in range(2)])
    t = np.arange(0.0, knots[-1], 0.01)
    q = np.stack([np.interp(t, knots, angles[:, k]) for k in range(6)], axis=1)
    R = robot.kinematics(q).R_tool @ R_SENSOR_IN_TOOL
    empty: dict[str, list[float]] = {"velocity": [], "effort": []}
    with open(path, "wb") as file:
        writer = Writer(file)
        joints = writer.register_msgdef("sensor_msgs/msg/JointState", JOINTS)
        wrench = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", WRENCH)
        text = writer.register_msgdef("std_msgs/msg/String", "string data")
        writer.write_message("/robot_description", text, {"data": robot.urdf_text}, log_time=0)
        for i, now in enumerate(t):
            header = {"stamp": {"sec": int(now), "nanosec": int(now % 1.0 * 1e9)}, "frame_id": ""}
            ns = int(now * 1e9)
            if i % 2 == 0:
                state = {"header": header, "name": list(robot.joint_names), "position": q[i].tolist(), **empty}
                writer.write_message("/joint_states", joints, state, log_time=ns)
            w = load.reading(R[i], np.array([0.0, 0.0, -9.81])) + rng.normal(0, (0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
            parts = {"force": _vector(w[:3]), "torque": _vector(w[3:])}
            writer.write_message("/wrench_raw", wrench, {"header": header, "wrench": parts}, log_time=ns)
        writer.finish()
    return path


def _vector(v: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", v.tolist(), strict=True))
