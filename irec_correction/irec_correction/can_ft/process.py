# SPDX-License-Identifier: Apache-2.0
"""The sensor's process: readings go into shared memory for the loop that corrects, and as datagrams to whoever watches."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import sys
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np
from irec_calibration.errors import IrecError

from ..realtime import prefer_thread, settle_memory
from ..shared import WRENCH_SIZE, SharedValues
from .netft_can import Reading
from .reader import ReaderSettings, SensorReader

# time (CLOCK_REALTIME, s), wrench(6), status, sample, then readings, unanswered, gaps, repeated, bad, bus failures
RECORD = struct.Struct("<7d2I6Q")


@dataclass(frozen=True)
class SensorSetup:
    """Attributes: block: name under which the shared memory is created. priority: SCHED_FIFO, 0: none."""

    reader: ReaderSettings
    block: str
    priority: int = 0


class SensorProcess:
    """Reader, shared memory and the commands of the other side."""

    def __init__(self, setup: SensorSetup, pipe: Connection, records: socket.socket) -> None:
        """Open bus and block. Raises IrecError."""
        self._pipe: Connection | None = pipe
        self._records = records
        self.reader = SensorReader(setup.reader, self._tell)
        self._block = SharedValues.create(WRENCH_SIZE, setup.block)
        self._values = np.zeros(WRENCH_SIZE)
        self._running = True
        self._told = 0.0

    def run(self) -> None:
        """Until a signal. The other side may go away."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        try:
            self.reader.run(self._goes_on)
        finally:
            self.reader.close()
            self._block.close()

    def _on_signal(self, number: int, frame: object) -> None:
        self._running = False

    def _tell(self, reading: Reading, now: float) -> None:
        v = self._values
        v[0], v[1], v[2] = now, self.reader.counts.readings, float(reading.status if reading.errors else 0)
        v[3:9] = reading.wrench
        self._block.write(v)
        self._record(reading.wrench, reading.status, reading.sample)

    def _record(self, wrench: np.ndarray, status: int, sample: int) -> None:
        c = self.reader.counts
        self._told = time.time()
        data = RECORD.pack(
            self._told, *wrench.tolist(), status, sample, c.readings, c.unanswered, c.gaps, c.repeated, c.bad, c.bus_failures
        )
        with contextlib.suppress(OSError):  # nobody reads, or too slowly: the loop comes first
            self._records.send(data, socket.MSG_DONTWAIT)

    def _goes_on(self) -> bool:
        if time.time() - self._told > 0.5:  # tell the counters even while the sensor is silent
            self._record(np.full(6, np.nan), 0, 0)
        if self._pipe is not None:
            try:
                if self._pipe.poll(0):
                    self._pipe.send(self._obey(self._pipe.recv()))
            except (EOFError, OSError):
                self._pipe = None
                print("can_ft_node: the ROS side has gone; the sensor is read on", file=sys.stderr)
        return self._running

    def _obey(self, command: object) -> str:
        if command != "bias":
            return f"the sensor's process can't {command}"
        try:
            self.reader.bias()
        except (IrecError, OSError) as error:
            return str(error)
        return ""


def run_sensor(pipe: Connection, records: socket.socket) -> int:
    """Body of the process: receive a SensorSetup (or None: end), then read. Exit code."""
    try:
        setup = pipe.recv()
    except (EOFError, KeyboardInterrupt):
        return 2
    if setup is None:
        return 2
    refused = [prefer_thread(setup.priority)]
    try:
        process = SensorProcess(setup, pipe, records)
    except IrecError as error:
        pipe.send(("failed", str(error)))
        return 2
    if setup.priority and os.name == "posix":
        refused += settle_memory()
    pipe.send(("ready", [r for r in refused if r]))
    process.run()
    return 0
