# SPDX-License-Identifier: Apache-2.0
"""A node of the test itself, in a context of its own that ends with it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from irec_ros.seen import SeenBy

START = 90.0  # s for a process to come up on a busy machine


class RosSide:
    """Publishers, subscriptions and clients of `node`; nothing happens but in `until` and `spin`."""

    def __init__(self, name: str) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node(name, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def collect(self, kind: Any, topic: str) -> list[Any]:
        """Messages of a topic as they come in."""
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, 50)
        return messages

    def spin(self, timeout: float = 0.0) -> None:
        """Whatever has come in."""
        self.executor.spin_once(timeout_sec=timeout)

    def until(
        self, condition: Callable[[], Any], what: str, seconds: float = START, each: Callable[[], None] | None = None
    ) -> None:
        """Spin until a condition holds; `each` is called in between."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what}: not within {seconds} s"
            if each is not None:
                each()
            self.spin(0.0 if each is not None else 0.05)

    def call(self, kind: Any, name: str, request: Any, each: Callable[[], None] | None = None) -> Any:
        """Answer of a service."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f"service {name}", each=each)
        self.until(SeenBy(self.node, name), f"server of {name} finds this client", each=each)
        answer = client.call_async(request)
        self.until(answer.done, f"answer of {name}", each=each)
        self.node.destroy_client(client)
        return answer.result()

    def close(self) -> None:
        """Destroy everything."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
