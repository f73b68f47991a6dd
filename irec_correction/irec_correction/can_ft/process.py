# SPDX-License-Identifier: Apache-2.0
"""The sensor's process: readings go into shared memory for the loop that corrects, and as datagrams to whoever watches.

It serves one setup after another: `release` closes bus and block, and the next setup opens them.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import sys
import time
from dataclasses import astuple, dataclass, fields
from multiprocessing.connection import Connection

import numpy as np
from irec_calibration.errors import IrecError

from ..realtime import prefer_thread, settle_memory
from ..setups import ending_signals, next_setup
from ..shared import WRENCH_SIZE, SharedValues
from .netft_can import Reading
from .reader import ReaderCounts, ReaderSettings, SensorReader

COUNTS = tuple(f.name for f in fields(ReaderCounts))
# time (CLOCK_REALTIME, s), wrench(6), status, sample, then the counts
RECORD = struct.Struct(f"<7d2I{len(COUNTS)}Q")


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
        self.reader = SensorReader(setup.reader, self._deliver)
        self._block = SharedValues.create(WRENCH_SIZE, setup.block)
        self._values = np.zeros(WRENCH_SIZE)
        self._running = True
        self._passes_on = False  # until told so
        self._recorded = 0.0
        self._released = False
        self.stopped = False  # by a signal, not by `release`

    def run(self) -> None:
        """Until a signal or `release`. The other side may go away."""
        before = {number: signal.signal(number, self._on_signal) for number in ending_signals()}
        try:
            self.reader.run(self._continue)
        finally:
            self.reader.close()
            self._block.close()
            for number, handler in before.items():
                signal.signal(number, handler)
        if self._released and self._pipe is not None:
            with contextlib.suppress(OSError):  # the other side has gone meanwhile
                self._pipe.send("")  # only now bus and block are free

    def _on_signal(self, number: int, frame: object) -> None:
        self._running, self.stopped = False, True

    def _deliver(self, reading: Reading, now: float) -> None:
        if not self._passes_on:
            return
        v = self._values
        v[0], v[1], v[2] = now, self.reader.counts.readings, float(reading.status if reading.errors else 0)
        v[3:9] = reading.wrench
        self._block.write(v)
        self._record(reading.wrench, reading.status, reading.sample, time.time() - (time.monotonic() - now))

    def _record(self, wrench: np.ndarray, status: int, sample: int, stamp: float) -> None:
        self._recorded = time.monotonic()
        data = RECORD.pack(stamp, *wrench.tolist(), status, sample, *astuple(self.reader.counts))
        with contextlib.suppress(OSError):  # nobody reads, or too slowly: the loop comes first
            self._records.send(data, socket.MSG_DONTWAIT)

    def _continue(self) -> bool:
        if time.monotonic() - self._recorded > 0.5:  # the counters, even while the sensor is silent
            self._record(np.full(6, np.nan), 0, 0, time.time())
        if self._pipe is not None:
            try:
                if self._pipe.poll(0):
                    answer = self._execute(self._pipe.recv())
                    if not self._released:
                        self._pipe.send(answer)
            except (EOFError, OSError):
                self._pipe = None
                print("can_ft_node: the ROS side has gone; the sensor is read on", file=sys.stderr)
        return self._running

    def _execute(self, command: object) -> str:
        match command:
            case "pass on" | "pause":
                self._passes_on = command == "pass on"
            case "release":
                self._running, self._released = False, True
            case "bias":
                try:
                    self.reader.bias()
                except (IrecError, OSError) as error:
                    return str(error)
            case other:
                return f"the sensor's process can't {other}"
        return ""


def run_sensor(pipe: Connection, records: socket.socket) -> int:
    """Body of the process: receive a SensorSetup (or None: end), read, and again. Exit code."""
    while True:
        setup, code = next_setup(pipe)
        if setup is None:
            return code
        refused = [prefer_thread(setup.priority)]
        try:
            process = SensorProcess(setup, pipe, records)
        except IrecError as error:
            pipe.send(("failed", str(error)))
            continue
        if setup.priority and os.name == "posix":
            refused += settle_memory()
        pipe.send(("ready", [r for r in refused if r]))
        process.run()
        if process.stopped:
            return 0
