# SPDX-License-Identifier: Apache-2.0
"""Which signals ask a node to end in order."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")

WAITS = """
from irec_ros.startup import stop_on_signals
asked = stop_on_signals()
print("waits", flush=True)
asked.wait(60)
print("in order", flush=True)
"""


def told(number: signal.Signals) -> str:
    """What the process says once it was sent a signal."""
    with subprocess.Popen([sys.executable, "-c", WAITS], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == "waits\n"
            process.send_signal(number)
            return process.stdout.readline()
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_node_that_is_asked_to_end_or_whose_terminal_is_closed_ends_in_order(number: signal.Signals) -> None:
    assert told(number) == "in order\n"


def test_a_node_under_nohup_goes_on_when_the_terminal_is_closed() -> None:
    ignore = "import os, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); os.execv(sys.executable, sys.argv[1:])"
    asks = "from irec_ros.startup import ending_signals; print(*(number.name for number in ending_signals()))"
    command = [sys.executable, "-c", ignore, sys.executable, "-c", asks]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "SIGINT SIGTERM\n"
