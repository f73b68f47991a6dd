# SPDX-License-Identifier: Apache-2.0
"""Whether a topic that one node alone may send on has another sender: by the graph, which knows it before its first message."""

from __future__ import annotations

from typing import Any


def other_senders(node: Any, topic: str, own: int = 0) -> str:
    """Who sends on a topic beside `own` publishers, for people; empty where nobody does.

    Args:
        node: whose graph is asked, some 20 us. topic: fully qualified. own: publishers that belong there.
    """
    if node.count_publishers(topic) <= own:
        return ""
    found = node.get_publishers_info_by_topic(topic)
    names = sorted({f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found})
    return f"{len(found)} publishers of {topic} ({', '.join(names)}), {max(own, 1)} alone can be followed"
