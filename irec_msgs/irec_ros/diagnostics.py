# SPDX-License-Identifier: Apache-2.0
"""Diagnostics on /diagnostics, where aggregators listen; the name of a status carries the namespace and the node."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

OK, WARN, ERROR, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE
TOPIC = "/diagnostics"


def status(
    node: Node, task: str, level: bytes, message: str, values: Mapping[str, object] | None = None, hardware_id: str = ""
) -> DiagnosticStatus:
    """One status, named `<namespace>/<node>: <task>` so that two cells on one graph can be told apart."""
    return DiagnosticStatus(
        level=level,
        name=f"{node.get_fully_qualified_name().lstrip('/')}: {task}",
        message=message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()],
    )


class Diagnostics:
    """Publishes statuses of one node."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, TOPIC, 10)

    def publish(self, *statuses: DiagnosticStatus) -> None:
        """Send now; nothing where ROS is being shut down."""
        if self._node.context.ok():
            message = DiagnosticArray(status=list(statuses))
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(message)
