# SPDX-License-Identifier: Apache-2.0
"""Start of a node's process: ROS arguments that can't be read are a line, not a trace."""

from __future__ import annotations

import re
import sys
from typing import Any

import rclpy


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
