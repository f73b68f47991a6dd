# SPDX-License-Identifier: Apache-2.0
"""Start of a node's process: ROS arguments that can't be read, and parameters that nobody knows, are a line, not a trace."""

from __future__ import annotations

import re
import sys
from difflib import get_close_matches
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.node import Node


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


def refuse_unknown_parameters(node: Node) -> None:
    """Call when everything is declared. ROS ignores a parameter with a misspelt name, and with it a limit that somebody set.

    Raises:
        ParameterException: a parameter was given that the node does not have; says which, and which one is like it.
    """
    given = node._parameter_overrides  # there is no public list of what was given
    unknown = [name for name in given if not node.has_parameter(name) and not name.startswith("qos_overrides.")]
    if not unknown:
        return
    like = get_close_matches(unknown[0], sorted(node._parameters), n=1)
    raise ParameterException(f"{node.get_name()} has no such parameter{f' (but {like[0]})' if like else ''}", unknown)
