# SPDX-License-Identifier: Apache-2.0
"""Start and end of a node's process: wrong ROS arguments and unknown parameters are a line, not a trace; signals only ask."""

from __future__ import annotations

import re
import signal
import sys
import threading
from collections.abc import Callable
from difflib import get_close_matches
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from .guard import Guarded


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


def ending_signals() -> tuple[signal.Signals, ...]:
    """The signals that ask a process to end."""
    hang_up = () if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (signal.SIGHUP,)
    return (signal.SIGINT, signal.SIGTERM, *hang_up)


def stop_on_signals() -> threading.Event:
    """Set by SIGINT, SIGTERM and SIGHUP, which do nothing else from now on: whoever runs the node ends it in order.

    SIGHUP comes where the terminal or the connection to it is closed; under `nohup` it stays ignored.

    Needs `begin(..., signal_handler_options=SignalHandlerOptions.NO)`, or rclpy takes the context away first.
    """
    asked = threading.Event()
    for number in ending_signals():
        signal.signal(number, lambda *_: asked.set())
    return asked


def spin_until(
    asked: threading.Event, spin_once: Callable[..., None], period: float = 0.2, done: Callable[[], bool] = lambda: False
) -> None:
    """Work until a signal has come; what is under way is finished, and the context is still there to publish with.

    spin_once: of an executor, or a guarded one; period: s between looks; done: what ends it besides.
    """
    while not asked.is_set() and rclpy.ok() and not done():
        spin_once(timeout_sec=period)


def run_process(name: str, work: Callable[[threading.Event], None], *refusals: type[Exception]) -> int:
    """Exit code of a node's process: 0 ended by a signal, 2 where arguments, a parameter or a file can't be used.

    Args:
        name: for messages on stderr.
        work: makes the nodes and works until the event is set.
        refusals: what it raises where something that the user gave can't be used; parameters that ROS refuses are among them.
    """
    if not begin(name, signal_handler_options=SignalHandlerOptions.NO):
        return 2
    asked_to_stop = stop_on_signals()
    try:
        work(asked_to_stop)
    except (ParameterException, *refusals) as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0


def spin_node(node: Node, asked: threading.Event, done: Callable[[], bool] = lambda: False) -> None:
    """Let one node work in this thread until a signal has come, or it is done."""
    executor = EventsExecutor()
    executor.add_node(node)
    spin_until(asked, executor.spin_once, done=done)


def run_node(name: str, make: Callable[[], Node], *refusals: type[Exception]) -> int:
    """As `run_process`, for one node that does nothing but answer."""
    return run_process(name, lambda asked: spin_node(make(), asked), *refusals)


def refuse_unknown_parameters(*guarded: Guarded) -> None:
    """Call when all nodes of the process have declared theirs: what is given on the command line goes for each of them.

    ROS ignores a parameter with a misspelt name, and with it a limit that somebody set.

    Raises:
        ParameterException: a parameter was given that none of them has; says which, and which one is like it.
    """
    nodes: tuple[Any, ...] = guarded
    given = {name for node in nodes for name in node.given_parameters}
    unknown = sorted(n for n in given if not any(node.has_parameter(n) for node in nodes) and not n.startswith("qos_overrides."))
    if not unknown:
        return
    known = sorted(name for node in nodes for name in node.get_parameters_by_prefix(""))
    like = get_close_matches(unknown[0], known, n=1)
    raise ParameterException(f"{nodes[0].get_name()} has no such parameter{f' (but {like[0]})' if like else ''}", unknown)
