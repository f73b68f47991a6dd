# SPDX-License-Identifier: Apache-2.0
"""What the procedure tells the world: its status, each row that was recorded, events, diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from irec_ros.diagnostics import ERROR, OK, WARN, Diagnostics, status
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from irec_msgs.msg import LoadCaseRecord, ProcedureStatus

from ..procedure.commands import Event
from .procedure_run import ProcedureRun, event_text

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EVENTS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


class ProcedureReports:
    """Topics irec/procedure/status, load_case and event, and /diagnostics."""

    def __init__(self, node: Any, serial: str) -> None:
        self._node, self._serial = node, serial
        self._status = node.create_publisher(ProcedureStatus, "irec/procedure/status", LATCHED)
        self._rows = node.create_publisher(LoadCaseRecord, "irec/procedure/load_case", EVENTS)
        self._events = node.create_publisher(String, "irec/procedure/event", EVENTS)
        self._health = Diagnostics(node)

    def happened(self, rows: Sequence[LoadCaseRecord], events: Sequence[Event]) -> None:
        """Tell what a step of the run has brought."""
        for row in rows:
            self._rows.publish(row)
        for event in events:
            self._events.publish(String(data=event_text(event)))
            if event.kind in ("skipped", "nearer", "rejected", "discarded", "unverified", "stopped"):
                where = f"pose {event.pose}, load case {event.load_case}: " if event.pose else ""
                self._node.get_logger().warning(f"{event.kind}: {where}{event.text}")

    def tell(self, run: ProcedureRun | None, last_failed: str) -> ProcedureStatus:
        """Publish status and diagnostics; the status.

        Args:
            last_failed: why the last run did not come to its end, empty where it did.
        """
        message = ProcedureStatus(state="idle")
        message.header.stamp, message.header.frame_id = self._node.get_clock().now().to_msg(), "base_link"
        level, text = OK, "no run"
        if run is not None:
            run.fill(message)
            text = message.message or message.state
            doubtful = message.paused or bool(run.procedure.scale_doubt)
            level = ERROR if run.procedure.stopped_because else WARN if doubtful else OK
        elif last_failed:
            level, text = WARN, f"the last run: {last_failed}"
        self._status.publish(message)
        self._health.publish(
            status(self._node, "procedure", level, text,
                   {"state": message.state, "pose": f"{message.pose} of {message.poses}"}, self._serial)
        )  # fmt: skip
        return message
