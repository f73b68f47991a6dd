# SPDX-License-Identifier: Apache-2.0
"""A session with the residuals of a model as an MCAP that viewers of other people open: standard messages, no ROS needed.

Topics: /robot_description, /tf, /tf_static, /joint_states, /wrench, /irec/scene (markers: residuals, pose numbers, surface),
/irec/residual. Everything is in base_link; times are those of the session.
"""

from __future__ import annotations

import os
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer

from ..diagnose.result import Comparison
from ..errors import RecordingError
from ..files import write_file
from ..robot.transforms import LinkTree, Transform
from ..session import Session
from ..typing import Array, IntArray

LINE_LIST, TEXT, TRIANGLES = 5, 9, 11
SEPARATOR = "=" * 80 + "\n"
HEADER = SEPARATOR + "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
TIME = SEPARATOR + "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
VECTOR = SEPARATOR + "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
POINT = SEPARATOR + "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
QUATERNION = SEPARATOR + "MSG: geometry_msgs/Quaternion\nfloat64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
COLOUR = SEPARATOR + "MSG: std_msgs/ColorRGBA\nfloat32 r\nfloat32 g\nfloat32 b\nfloat32 a\n"
DURATION = SEPARATOR + "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n"
POSE = SEPARATOR + "MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n"
TRANSFORM = (
    SEPARATOR + "MSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\nTransform transform\n"
    + SEPARATOR + "MSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n"
)  # fmt: skip
MARKER = """int32 ARROW=0
int32 CUBE=1
int32 SPHERE=2
int32 CYLINDER=3
int32 LINE_STRIP=4
int32 LINE_LIST=5
int32 CUBE_LIST=6
int32 SPHERE_LIST=7
int32 POINTS=8
int32 TEXT_VIEW_FACING=9
int32 MESH_RESOURCE=10
int32 TRIANGLE_LIST=11
int32 ARROW_STRIP=12
int32 ADD=0
int32 MODIFY=0
int32 DELETE=2
int32 DELETEALL=3
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
string texture_resource
sensor_msgs/CompressedImage texture
UVCoordinate[] uv_coordinates
string text
string mesh_resource
MeshFile mesh_file
bool mesh_use_embedded_materials
"""
MARKERS = "".join(
    (
        "Marker[] markers\n", SEPARATOR, "MSG: visualization_msgs/Marker\n", MARKER, HEADER, TIME, POSE, POINT, QUATERNION,
        VECTOR, COLOUR, DURATION,
        SEPARATOR, "MSG: sensor_msgs/CompressedImage\nstd_msgs/Header header\nstring format\nuint8[] data\n",
        SEPARATOR, "MSG: visualization_msgs/UVCoordinate\nfloat32 u\nfloat32 v\n",
        SEPARATOR, "MSG: visualization_msgs/MeshFile\nstring filename\nuint8[] data\n",
    )
)  # fmt: skip
JOINTS = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n" + HEADER + TIME
WRENCH = (
    "std_msgs/Header header\nWrench wrench\n" + HEADER + TIME
    + SEPARATOR + "MSG: geometry_msgs/Wrench\nVector3 force\nVector3 torque\n" + VECTOR
)  # fmt: skip
RESIDUAL = "std_msgs/Header header\nVector3 vector\n" + HEADER + TIME + VECTOR
TF = "geometry_msgs/TransformStamped[] transforms\n" + TRANSFORM + HEADER + TIME + VECTOR + QUATERNION


def write_scene(
    session: Session, comparison: Comparison, path: Path, *, magnify: float, surface: tuple[Array, IntArray] | None = None
) -> int:
    """Write the file; returns the number of messages. Raises RecordingError: it exists, or can't be written.

    Args:
        magnify: how much residuals are drawn longer than they are; surface: vertices (v, 3), m, in base_link, and triangles.
    """
    tree = LinkTree(session.robot.urdf_text, session.robot.source)
    count = 0
    if os.path.lexists(path):
        raise RecordingError(f"{path} exists already; recordings are never overwritten: name another file")
    with BytesIO() as file:
        writer = Writer(file)
        types = {
            "/robot_description": ("std_msgs/msg/String", "string data\n"), "/tf": ("tf2_msgs/msg/TFMessage", TF),
            "/joint_states": ("sensor_msgs/msg/JointState", JOINTS), "/wrench": ("geometry_msgs/msg/WrenchStamped", WRENCH),
            "/irec/scene": ("visualization_msgs/msg/MarkerArray", MARKERS),
            "/irec/residual": ("geometry_msgs/msg/Vector3Stamped", RESIDUAL),
        }  # fmt: skip
        schema = {topic: writer.register_msgdef(name, text) for topic, (name, text) in types.items()}
        schema["/tf_static"] = schema["/tf"]

        def put(topic: str, message: dict[str, Any], seconds: float) -> None:
            nonlocal count
            ns = int(max(seconds, 0.0) * 1e9)
            writer.write_message(topic, schema[topic], message, log_time=ns, publish_time=ns)
            count += 1

        begin = float(session.stamp.min())
        put("/robot_description", {"data": session.robot.urdf_text}, begin)
        put("/tf_static", {"transforms": [_transform(t, begin) for t in tree.fixed()]}, begin)
        put("/irec/scene", {"markers": _markers(session, comparison, magnify, surface, begin)}, begin)
        residual = {int(r): comparison.residual[i] for i, r in enumerate(comparison.rows)}
        for row in np.argsort(session.stamp, kind="stable"):
            now = float(session.stamp[row])
            at = dict(zip(session.robot.joint_names, session.q[row].tolist(), strict=True))
            at |= {name: float(values[row]) for name, values in session.ext.items()}
            names, values = list(at), list(at.values())
            put("/joint_states", {"header": _header(now), "name": names, "position": values, "velocity": [], "effort": []}, now)
            put("/tf", {"transforms": [_transform(t, now) for t in tree.at(at)]}, now)
            wrench = {"force": _vector(session.force_in_tool[row]), "torque": _vector(session.torque_in_tool[row])}
            put("/wrench", {"header": _header(now, "tool0"), "wrench": wrench}, now)
            if int(row) in residual:
                put("/irec/residual", {"header": _header(now), "vector": _vector(residual[int(row)])}, now)
        writer.finish()
        write_file(path, file.getvalue(), error=RecordingError)
    return count


def _markers(
    session: Session, c: Comparison, magnify: float, surface: tuple[Array, IntArray] | None, now: float
) -> list[dict[str, Any]]:
    start = session.p_tcp_in_base[c.rows]
    ends = np.stack([start, start + magnify * c.residual], axis=1).reshape(-1, 3)
    size = np.linalg.norm(c.residual, axis=1)
    share = np.repeat(size / max(float(size.max(initial=0.0)), 1e-12), 2)
    colours = [{"r": float(s), "g": float(0.45 + 0.4 * s), "b": float(0.7 * (1 - s)), "a": 1.0} for s in share]
    out = [_marker("residual", 0, LINE_LIST, now, points=ends, colours=colours, width=0.004)]
    for n in np.unique(session.pose[c.rows]):
        at = start[session.pose[c.rows] == n].mean(axis=0)
        out.append(_marker("pose", int(n), TEXT, now, at=at + [0.0, 0.0, 0.03], text=str(int(n)), width=0.04))
    if surface is not None:
        out.append(_marker("surface", 0, TRIANGLES, now, points=surface[0][surface[1]].reshape(-1, 3), width=1.0, alpha=0.4))
    return out


def _marker(
    ns: str, number: int, kind: int, now: float, *, points: Array | None = None, colours: list[dict[str, float]] | None = None,
    at: Array | None = None, text: str = "", width: float = 1.0, alpha: float = 1.0,
) -> dict[str, Any]:  # fmt: skip
    size = {"x": width, "y": 1.0 if kind == TRIANGLES else 0.0, "z": width if kind != LINE_LIST else 0.0}
    image = {"header": _header(now), "format": "", "data": b""}
    place = {"position": _vector(at if at is not None else np.zeros(3)), "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    return {
        "header": _header(now), "ns": ns, "id": number, "type": kind, "action": 0, "scale": size, "frame_locked": False,
        "pose": place,
        "color": {"r": 0.7, "g": 0.72, "b": 0.75, "a": alpha}, "lifetime": {"sec": 0, "nanosec": 0},
        "points": [_vector(p) for p in points] if points is not None else [], "colors": colours or [], "texture_resource": "",
        "texture": image, "uv_coordinates": [], "text": text, "mesh_resource": "", "mesh_file": {"filename": "", "data": b""},
        "mesh_use_embedded_materials": False,
    }  # fmt: skip


def _transform(t: Transform, now: float) -> dict[str, Any]:
    x, y, z, w = (float(v) for v in t.quat_xyzw)
    inside = {"translation": _vector(t.xyz), "rotation": {"x": x, "y": y, "z": z, "w": w}}
    return {"header": _header(now, t.parent), "child_frame_id": t.child, "transform": inside}


def _header(now: float, frame: str = "base_link") -> dict[str, Any]:
    ns = int(max(now, 0.0) * 1e9)
    return {"stamp": {"sec": ns // 1_000_000_000, "nanosec": ns % 1_000_000_000}, "frame_id": frame}


def _vector(v: Array) -> dict[str, float]:
    return {"x": float(v[0]), "y": float(v[1]), "z": float(v[2])}
