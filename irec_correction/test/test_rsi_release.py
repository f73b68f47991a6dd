# SPDX-License-Identifier: Apache-2.0
"""The process of the RSI loop between two setups."""

from __future__ import annotations

import multiprocessing
import socket
import threading
import time

import numpy as np
import pytest
from chain import PERIOD, Q
from irec_correction.correction import CorrectionSettings
from irec_correction.rsi.bridge import BridgeSetup, run_bridge
from irec_correction.rsi.loop import Link
from irec_correction.rsi.report import KEPT, REPORT_SIZE
from irec_correction.rsi.sources import OFFSET_SIZE
from irec_correction.shared import SharedValues
from irec_sim.devices.rsi_controller import RobotState, RsiController

pytestmark = pytest.mark.timed  # an answer that is late is acted on by no controller
STATE = RobotState(Q, np.array([1.5, 0.0, 1.2]), np.zeros(3))
WAIT = 30.0  # s
WANTED = 4e-4  # m


class NodeSide:
    """What the node does, in a thread: the loop needs the main one for its signals."""

    def __init__(self, pipe) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
            s.bind(("127.0.0.1", 0))
            self.port = int(s.getsockname()[1])
        self.pipe, self.heard, self.stop = pipe, [], threading.Event()
        self.report, self.latency = SharedValues.create(REPORT_SIZE), SharedValues.create(KEPT)
        self.offset = SharedValues.create(OFFSET_SIZE)
        self.sent_at_answer = np.nan

    def setup(self) -> BridgeSetup:
        link = Link(port=self.port)
        return BridgeSetup(link, CorrectionSettings(), self.report.name, self.latency.name, None, self.offset.name, 1.0)

    def wait_for(self, kind: str):
        end = time.monotonic() + WAIT
        while time.monotonic() < end:
            self.offset.write(np.array([time.monotonic(), 1.0, WANTED, 0, 0, 0, 0, 0]))
            self.controller.run(1, lambda: STATE)
            while self.pipe.poll(0):
                self.heard.append(self.pipe.recv())
                if self.heard[-1][0] == kind:
                    return self.heard[-1][1]
        raise AssertionError(f"no '{kind}' within {WAIT} s; {self.heard}")

    def run(self) -> None:
        self.controller = RsiController(("127.0.0.1", self.port), timeout=10**6)
        try:
            self.pipe.send(self.setup())
            self.heard.append(self.pipe.recv())
            self.pipe.send(("start", None))
            self.wait_for("answer")
            end = time.monotonic() + WAIT
            while np.linalg.norm(self.controller.acted[-1]) < 0.9 * WANTED and time.monotonic() < end:
                self.offset.write(np.array([time.monotonic(), 1.0, WANTED, 0, 0, 0, 0, 0]))
                self.controller.run(1, lambda: STATE)
            self.pipe.send(("release", None))
            self.wait_for("answer")
            self.sent_at_answer = float(np.linalg.norm(self.controller.acted[-1]))
            self.pipe.send(self.setup())
            self.heard.append(self.pipe.recv())
        finally:
            self.pipe.send(("release", None))
            self.pipe.send(None)
            self.largest_step = float(np.linalg.norm(np.diff(np.array(self.controller.acted), axis=0), axis=1).max())
            self.controller.close()


def test_a_release_is_answered_when_the_offset_has_faded_and_the_port_is_free_for_the_next_setup():
    ours, theirs = multiprocessing.Pipe()
    side = NodeSide(theirs)
    thread = threading.Thread(target=side.run)
    thread.start()
    try:
        run_bridge(ours)
    finally:
        thread.join(WAIT)
        for block in (side.report, side.latency, side.offset):
            block.close()
    assert side.sent_at_answer < 1e-7
    assert side.heard[-1][0] == "ready" and side.heard[-1][1][0] == side.port
    assert side.largest_step <= 0.02 * PERIOD + 2e-7
