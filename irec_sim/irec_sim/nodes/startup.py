# SPDX-License-Identifier: Apache-2.0
"""Start of a node's process: ROS arguments that can't be read, and parameters that nobody knows, are a line, not a trace."""

from __future__ import annotations

import re
import sys
from typing import Any

import rclpy
from rclpy.node import Node

from ..errors import SimError


def begin(name: str, **options: Any) -> bool:
    """`rclpy.init(**options)`; False, with the reason on stderr, where the ROS arguments are wrong.

    Such are: a parameter file that is missing or no YAML, a rule or flag that ROS doesn't know.
    """
    try:
        rclpy.init(**options)
    except RuntimeError as error:  # the bindings have no public class for it
        text = str(error).removeprefix("failed to initialize rcl: ")
        text = " ".join(re.sub(r",? at \S+:\d+", "", text).split())  # places in the sources of rcl
        print(f"{name}: ROS arguments can't be used: {text}", file=sys.stderr)
        return False
    return True


def refuse_unknown_parameters(*nodes: Node) -> None:
    """Call when all nodes of the process have declared theirs: what is given on the command line goes for each of them.

    Raises:
        SimError: a parameter was given that none of them has. ROS would ignore it, misspelt as it may be.
    """
    given = {name for node in nodes for name in node._parameter_overrides}  # there is no public list of what was given
    unknown = sorted(n for n in given if not any(node.has_parameter(n) for node in nodes) and not n.startswith("qos_overrides."))
    if unknown:
        raise SimError(f"there is no parameter '{unknown[0]}'; ros2 param list says which there are")
