# SPDX-License-Identifier: Apache-2.0
"""`irec_msgs/msg/LoadCaseRecord` without ROS: its definition for MCAP, and its CDR encoding.

A session can thus be converted where no ROS is installed. That the definition is that of irec_msgs is tested.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from ..errors import RecordingError
from ..recording import TypeCatalogue

TYPE = "irec_msgs/msg/LoadCaseRecord"
TOPIC = "/irec/procedure/load_case"
EVENT_TYPE = "std_msgs/msg/String"
EVENT_TOPIC = "/irec/procedure/event"  # JSON: kind, pose, repeat, load_case, text

_FIELDS = {
    "irec_msgs/LoadCaseRecord": """\
std_msgs/Header header
float64 time
uint32 pose
uint32 load_case
uint32 repeat
string[] joint_names
float64[] joint_position
float64[] joint_target
geometry_msgs/Point p_tcp_in_base
geometry_msgs/Point p_marker_in_station
string marker
string station
geometry_msgs/Wrench wrench_in_tool
string[] temperature_names
float64[] temperature
uint32 samples
float64 marker_std
float64 force_std
""",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Wrench": "Vector3 force\nVector3 torque\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
}


class Catalogue(TypeCatalogue):
    """Stands in for the catalogue of installed interface packages, for what a session needs."""

    def definition(self, type_name: str) -> str:
        """Concatenated definition (ros2msg). RecordingError for another type."""
        if type_name == EVENT_TYPE:
            return "string data\n"
        if type_name != TYPE:
            raise RecordingError(f"the type '{type_name}' is none that a session needs")
        head, *rest = _FIELDS
        separator = "=" * 80
        return _FIELDS[head] + "".join(f"{separator}\nMSG: {name}\n{_FIELDS[name]}" for name in rest)

    def type_hash(self, type_name: str) -> str:
        """Unknown here."""
        return ""


class _Cdr:
    """Little-endian CDR; alignment counts from the end of the 4-byte header."""

    def __init__(self) -> None:
        self.data = bytearray(b"\x00\x01\x00\x00")

    def _align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - 4) % size)

    def u32(self, *values: int) -> None:
        self._align(4)
        self.data += struct.pack(f"<{len(values)}I", *values)

    def i32(self, value: int) -> None:
        self._align(4)
        self.data += struct.pack("<i", value)

    def f64(self, *values: float) -> None:
        if values:
            self._align(8)
            self.data += struct.pack(f"<{len(values)}d", *values)

    def text(self, value: str) -> None:
        raw = value.encode() + b"\x00"
        self.u32(len(raw))
        self.data += raw

    def texts(self, values: Sequence[str]) -> None:
        self.u32(len(values))
        for value in values:
            self.text(value)

    def numbers(self, values: Sequence[float]) -> None:
        self.u32(len(values))
        self.f64(*values)


def encode_event(text: str) -> bytes:
    """One std_msgs/String in CDR."""
    cdr = _Cdr()
    cdr.text(text)
    return bytes(cdr.data)


def encode(
    *,
    stamp_ns: int,
    time: float,
    pose: int,
    load_case: int,
    repeat: int,
    joint_names: Sequence[str],
    joint_position: Sequence[float],
    joint_target: Sequence[float],
    p_tcp_in_base: Sequence[float],
    p_marker_in_station: Sequence[float],
    marker: str,
    station: str,
    wrench_in_tool: Sequence[float],
    temperature_names: Sequence[str],
    temperature: Sequence[float],
) -> bytes:
    """One LoadCaseRecord in CDR; fields, units and frames as in the message. wrench_in_tool: force (3), torque (3)."""
    cdr = _Cdr()
    cdr.i32(stamp_ns // 1_000_000_000)
    cdr.u32(stamp_ns % 1_000_000_000)
    cdr.text("base_link")
    cdr.f64(time)
    cdr.u32(pose, load_case, repeat)
    cdr.texts(joint_names)
    cdr.numbers(joint_position)
    cdr.numbers(joint_target)
    cdr.f64(*p_tcp_in_base, *p_marker_in_station)
    cdr.text(marker)
    cdr.text(station)
    cdr.f64(*wrench_in_tool)
    cdr.texts(temperature_names)
    cdr.numbers(temperature)
    cdr.u32(0)
    cdr.f64(float("nan"), float("nan"))
    return bytes(cdr.data)
