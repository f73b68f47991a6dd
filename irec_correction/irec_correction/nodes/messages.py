# SPDX-License-Identifier: Apache-2.0
"""Between messages and arrays. Messages are filled in place: every scalar a float, nothing allocated that stays."""

from __future__ import annotations

import math
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TransformStamped, WrenchStamped
from irec_calibration.typing import Array
from irec_ros.diagnostics import status
from rclpy.node import Node

from irec_msgs.msg import CorrectionState

from ..correction import Correction, Counts, Output
from ..state import State

LEVELS = {
    State.INACTIVE: DiagnosticStatus.OK, State.RAMP_IN: DiagnosticStatus.OK, State.ACTIVE: DiagnosticStatus.OK,
    State.HOLD: DiagnosticStatus.WARN, State.FADE: DiagnosticStatus.WARN, State.FAULT: DiagnosticStatus.ERROR,
}  # fmt: skip


def seconds(stamp: Time) -> float:
    """A stamp as seconds."""
    return stamp.sec + 1e-9 * stamp.nanosec


def ros_time(t: float) -> Time:
    """Seconds as a stamp."""
    whole = math.floor(t)
    return Time(sec=int(whole), nanosec=int((t - whole) * 1e9))


def fill_vector(target: Any, v: Array) -> None:
    """x, y, z of a message from (3,)."""
    target.x, target.y, target.z = v.tolist()


def fill_quaternion(target: Any, rotation_vector: Array) -> None:
    """Unit quaternion of a rotation vector (3,), rad."""
    x, y, z = rotation_vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    s = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    target.x, target.y, target.z, target.w = s * x, s * y, s * z, math.cos(0.5 * angle)


def fill_offset(message: TransformStamped, out: Output, frame: str) -> None:
    """The offset in base_link or tool0; the stamp is set by the caller."""
    translation, rotation = out.translation, out.rotation
    if frame == "tool0":
        translation, rotation = out.R_tool.T @ translation, out.R_tool.T @ rotation
    message.header.frame_id, message.child_frame_id = frame, "tool0"
    fill_vector(message.transform.translation, translation)
    fill_quaternion(message.transform.rotation, rotation)


def fill_wrench(message: WrenchStamped, stamp: Time, wrench_at_tcp: Array) -> None:
    """Process wrench (6,) in tool0."""
    message.header.stamp, message.header.frame_id = stamp, "tool0"
    fill_vector(message.wrench.force, wrench_at_tcp[:3])
    fill_vector(message.wrench.torque, wrench_at_tcp[3:])


def fill_state(message: CorrectionState, stamp: Time, out: Output, counts: Counts, serial: str, digest: str) -> None:
    """What the correction does and why."""
    message.header.stamp, message.header.frame_id = stamp, "base_link"
    message.state, message.reason = int(out.state), out.reason
    fill_vector(message.deflection, out.deflection)
    fill_vector(message.offset, out.translation)
    fill_vector(message.wrench_process.force, out.wrench_at_tcp[:3])
    fill_vector(message.wrench_process.torque, out.wrench_at_tcp[3:])
    message.model_serial, message.model_sha256 = serial, digest
    message.limited, message.held, message.late = counts.limited, counts.held, counts.late


def correction_status(node: Node, serial: str, correction: Correction, note: str = "") -> DiagnosticStatus:
    """State, reason and counters. Args: note: something that somebody should look at."""
    state, counts = correction.supervisor.state, correction.counts
    text = f"{state.name}: {correction.supervisor.reason}" if correction.supervisor.reason else state.name
    values: dict[str, object] = {"ticks": counts.ticks, "limited": counts.limited, "held": counts.held, "late": counts.late}
    values |= {f"fault.{f.value}": n for f, n in sorted(correction.watchdog.counters.items())}
    if correction.watchdog.newest is not None:  # the state names why it was entered; this may have come later
        values["newest_finding"] = correction.watchdog.newest.text
    level = LEVELS[state]
    if note:
        text, level = f"{text}; {note}", max(level, DiagnosticStatus.WARN)
    return status(node, "offset", level, text, values, serial)
