# SPDX-License-Identifier: Apache-2.0
"""Whether a server has found this process: before that, what it answers is lost."""

from __future__ import annotations

import time

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

AGAIN = 0.5  # s after which a question without an answer is asked again


class SeenBy:
    """A condition to wait for, between `service_is_ready` or `server_is_ready` and the first request of a new client.

    A client that has found its server is not yet found by it, and an answer to a reader that the server does not know is dropped
    (by rmw_fastrtps after 0.1 s), although the request was carried out. Nobody can ask a server whom it knows. But a process
    announces its readers in the order in which it made them, and each other process takes them in in this order. So a question
    that does no harm, for the parameters of the server's node, is asked by a client that is made after all others, again and
    again: when its answer arrives, the server's process knows the others too.
    """

    def __init__(self, node: Node, service: str) -> None:
        """service: name as given to `create_client`; for an action use `of_action`."""
        self._node, self._service = node, node.resolve_service_name(service)
        self._client: Client | None = None
        self._answers: list[Future] = []
        self._asked = -AGAIN
        self._seen = False

    @classmethod
    def of_action(cls, node: Node, action: str) -> SeenBy:
        """The same for the server of an action."""
        return cls(node, f"{action}/_action/send_goal")

    def __call__(self) -> bool:
        """Whether the server's process knows all readers that this process had when this was first called; asks if need be."""
        if self._seen:
            return True
        if self._client is None:
            server = self._server()
            self._client = self._node.create_client(GetParameters, f"{server}/get_parameters") if server else None
        elif any(answer.done() for answer in self._answers):
            self._node.destroy_client(self._client)
            self._client, self._seen = None, True
        elif self._client.service_is_ready() and time.monotonic() - self._asked > AGAIN:
            self._asked = time.monotonic()
            self._answers.append(self._client.call_async(GetParameters.Request()))
        return self._seen

    def _server(self) -> str:
        """Full name of the node that offers the service; empty while the graph does not show it."""
        for name, space in self._node.get_node_names_and_namespaces():
            if name.startswith("_"):
                continue
            try:
                services = self._node.get_service_names_and_types_by_node(name, space)
            except RuntimeError:  # it has gone in between
                continue
            if self._service in (service for service, _ in services):
                return f"{space.rstrip('/')}/{name}"
        return ""
