# SPDX-License-Identifier: Apache-2.0
"""Whether whoever asked for a run is still there: a service can't be cancelled, and a caller may be killed."""

from __future__ import annotations

import time

from rclpy.node import Node

GONE_AFTER = 3.0  # s of the machine's clock without any client
LOOK_EVERY = 0.5  # s


class CallerWatch:
    """Looks at the clients of a service in the graph. One that was never seen is not missed: discovery may hide it.

    Args:
        service: name of the service, of an action that of its goals: `<action>/_action/send_goal`.
    """

    def __init__(self, node: Node, service: str) -> None:
        self._node, self._name = node, node.resolve_service_name(service)
        self._seen_at: float | None = None
        self._looked_at = 0.0
        self._gone = False

    def gone(self) -> str:
        """Why the run should end; empty while there is a client."""
        now = time.monotonic()
        if now - self._looked_at >= LOOK_EVERY:
            self._looked_at = now
            if self._node.count_clients(self._name) > 0:
                self._seen_at = now
            self._gone = self._seen_at is not None and now - self._seen_at > GONE_AFTER
        return "whoever asked for it has gone" if self._gone else ""
