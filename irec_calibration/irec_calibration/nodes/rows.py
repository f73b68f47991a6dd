# SPDX-License-Identifier: Apache-2.0
"""One averaged row of a session as a message, and plain numbers as the parts of messages."""

from __future__ import annotations

from array import array

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Vector3, Wrench

from irec_msgs.msg import LoadCaseRecord

from ..procedure.commands import Row


def row_message(row: Row, session_start: float) -> LoadCaseRecord:
    """session_start: s of the cell's clock at which the session's own time is 0."""
    window = row.window
    middle = 0.5 * (window.begin + window.end)
    m = LoadCaseRecord()
    m.header.stamp.sec, m.header.stamp.nanosec = divmod(round(middle * 1e9), 1_000_000_000)
    m.header.frame_id = "base_link"
    m.time = float(middle - session_start)
    m.pose, m.load_case, m.repeat = int(row.pose), int(row.load_case), int(row.repeat)
    m.joint_names = list(row.joint_names)
    m.joint_position = array("d", window.q.mean(axis=0))
    m.p_tcp_in_base = point(window.p_tcp_in_base.mean(axis=0))
    seen = len(window.p_marker_in_station) > 0  # NaN: not measured, an empty field of the session
    m.p_marker_in_station = point(window.p_marker_in_station.mean(axis=0) if seen else np.full(3, np.nan))
    m.station = window.station
    m.wrench_in_tool = Wrench(force=vector(window.force_in_tool.mean(axis=0)), torque=vector(window.torque_in_tool.mean(axis=0)))
    m.temperature_names = [f"temp_{name}" for name in sorted(row.temperature)]
    m.temperature = array("d", [row.temperature[name] for name in sorted(row.temperature)])
    m.samples = len(window.p_marker_in_station)
    m.marker_std, m.force_std = window.marker_std, window.force_std
    return m


def point(p: np.ndarray) -> Point:
    """(3,), m."""
    return Point(x=float(p[0]), y=float(p[1]), z=float(p[2]))


def vector(v: np.ndarray) -> Vector3:
    """(3,)."""
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def duration(seconds: float) -> Duration:
    """s, not negative."""
    whole = int(seconds)
    return Duration(sec=whole, nanosec=int((seconds - whole) * 1e9))
