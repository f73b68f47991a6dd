# SPDX-License-Identifier: Apache-2.0
"""How a process that never imports ROS waits for the setups that its node sends through a pipe, one after another."""

from __future__ import annotations

import signal
from multiprocessing.connection import Connection
from typing import Any


def ending_signals() -> tuple[signal.Signals, ...]:
    """The signals that ask a process to end; SIGHUP is one where it is not ignored, as it is under `nohup`."""
    hang_up = () if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (signal.SIGHUP,)
    return (signal.SIGINT, signal.SIGTERM, *hang_up)


def next_setup(pipe: Connection) -> tuple[Any, int]:
    """The next setup and 0; or None and the exit code of the process: 0 after a signal, 2 where the node has ended or refused."""
    for number in ending_signals():  # while it waits; what is set up takes signals itself
        # by name: a process that a script has put into the background was born with SIGINT ignored
        signal.signal(number, signal.default_int_handler)
    try:
        setup = pipe.recv()
    except KeyboardInterrupt:
        return None, 0
    except EOFError:
        return None, 2
    return setup, 2 if setup is None else 0
