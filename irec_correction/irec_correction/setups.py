# SPDX-License-Identifier: Apache-2.0
"""How a process that never imports ROS waits for the setups that its node sends through a pipe, one after another."""

from __future__ import annotations

import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

TO_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def on_end(handler: Callable[[int, Any], Any]) -> dict[int, Any]:
    """Call the handler for each signal that asks a process to end; what was called before, by number of the signal.

    SIGHUP stays ignored in a process that was started so, as by nohup.
    """
    asked = [n for n in TO_END if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    return {number: signal.signal(number, handler) for number in asked}


def next_setup(pipe: Connection) -> tuple[Any, int]:
    """The next setup and 0; or None and the exit code of the process: 0 after a signal, 2 where the node has ended or refused."""
    # while it waits; what is set up takes signals itself.
    # by name: a process that a script has put into the background was born with SIGINT ignored
    on_end(signal.default_int_handler)
    try:
        setup = pipe.recv()
    except KeyboardInterrupt:
        return None, 0
    except EOFError:
        return None, 2
    return setup, 2 if setup is None else 0
