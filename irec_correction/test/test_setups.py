# SPDX-License-Identifier: Apache-2.0
"""How a process that waits for its setup ends."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

WAITS = """
import multiprocessing, sys
from irec_correction.setups import next_setup
ours, theirs = multiprocessing.Pipe()
class Telling:
    def recv(self):
        print("waits", flush=True)
        return ours.recv()
sys.exit(next_setup(Telling())[1])
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_wait_of_a_process_that_was_started_in_the_background_of_a_script(number):
    ignore = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); os.execv(sys.executable, sys.argv[1:])"
    command = [sys.executable, "-c", ignore, sys.executable, "-c", WAITS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "waits\n"
        process.send_signal(number)
        try:
            assert process.wait(60) == 0
        finally:
            process.kill()
