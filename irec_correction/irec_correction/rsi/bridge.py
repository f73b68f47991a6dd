# SPDX-License-Identifier: Apache-2.0
"""The process of the RSI loop: commands come through a pipe, measurements go through shared memory, and it outlives whoever
started it.

A process serves one setup after another: `release` ends a loop, and the next setup begins one.
When the other side goes away the offset fades out and the loop goes on answering with zero, so that the robot is not stopped
by its own time-out. On SIGINT, SIGTERM or SIGHUP it fades out, then ends.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection

from irec_calibration.errors import IrecError

from ..correction import CorrectionSettings
from ..realtime import prefer_processor, prefer_thread, settle_memory
from ..setups import next_setup, on_end
from ..shared import SharedValues
from ..state import State
from .loop import Link, RsiLoop
from .report import KEPT, REPORT_SIZE
from .sources import OFFSET_SIZE, ChainSettings, ChainSource, GivenSource

SHUTDOWN_MARGIN = 1.0  # s beyond the fade time within which the loop ends after a signal


@dataclass(frozen=True)
class BridgeSetup:
    """What the loop needs to begin. Names are those of shared memory blocks that the other side has created.

    Attributes:
        chain: run the whole chain here; None: follow `offset_block`, stale after `offset_timeout` s.
        priority: SCHED_FIFO, 0: none. processor: that the loop stays on, below 0: any.
    """

    link: Link
    correction: CorrectionSettings
    report_block: str
    latency_block: str
    chain: ChainSettings | None = None
    offset_block: str = ""
    offset_timeout: float = 0.05
    cycle_ms: int = 4
    priority: int = 0
    processor: int = -1


class Bridge:
    """Loop, source and commands together."""

    def __init__(self, setup: BridgeSetup, pipe: Connection) -> None:
        """Raises IrecError where socket, blocks or robot description can't be used."""
        self._pipe: Connection | None = pipe
        report = SharedValues.attach(setup.report_block, REPORT_SIZE)
        latency = SharedValues.attach(setup.latency_block, KEPT)
        self._blocks = [report, latency]
        self.source: ChainSource | GivenSource
        if setup.chain is not None:
            self.source = ChainSource(setup.chain)
        else:
            block = SharedValues.attach(setup.offset_block, OFFSET_SIZE)
            self._blocks.append(block)
            self.source = GivenSource(setup.correction, block, setup.offset_timeout)
        self.loop = RsiLoop(setup.link, self.source, report, latency, setup.cycle_ms)
        self._state_sent: tuple[State, str] | None = None
        self._problem = ""
        self._fade = setup.correction.times.fade
        self._end: float | None = None
        self._released = False  # the other side waits for the end of this loop
        self.stopped = False  # by a signal or by the end of the other side, not by `release`

    def run(self) -> None:
        """Answer until a signal or `release`, then until the offset has gone."""
        before = on_end(self._on_signal)
        try:
            self.loop.run(self._continue)
        finally:
            self.loop.close()
            for block in self._blocks:
                block.close()
            for number, handler in before.items():
                signal.signal(number, handler)
        if self._released and self._pipe is not None:
            with contextlib.suppress(OSError):  # the other side has gone meanwhile
                self._pipe.send(("answer", ""))  # only now port and blocks are free, and the next setup is waited for

    def _on_signal(self, number: int, frame: object) -> None:
        self.stopped = True
        self._fade_and_end()

    def _fade_and_end(self) -> None:
        if self._end is None:
            self._end = time.monotonic() + self._fade + SHUTDOWN_MARGIN
            self.source.stop(time.monotonic())

    def _continue(self) -> bool:
        if self._pipe is not None:
            self._exchange(self._pipe)
        if self._end is None:
            return True
        return self.source.state not in (State.INACTIVE, State.FAULT) and time.monotonic() < self._end

    def _exchange(self, pipe: Connection) -> None:
        try:
            if pipe.poll(0):
                match pipe.recv():
                    case None:  # the node has given up: nobody waits for an answer
                        self._fade_and_end()
                    case "refused", argument:
                        self.source.refuse(*argument)
                    case "release", _:
                        self._released = True
                        self._fade_and_end()
                    case command, argument:
                        pipe.send(("answer", self._execute(command, argument)))
            now = (self.source.state, self.source.reason)
            sent = self._state_sent  # a reason changes with each value of a running fault; what is waited for does not
            if sent is None or now[0] is not sent[0] or (now[0] is State.INACTIVE and now[1] != sent[1]):
                self._state_sent = now
                pipe.send(("state", (int(now[0]), now[1])))
            if self.loop.problem != self._problem:
                self._problem = self.loop.problem
                pipe.send(("problem", self._problem))
        except (EOFError, OSError):
            asked, self._pipe, self.stopped = self.stopped, None, True
            self.source.stop(time.monotonic())
            if not asked:  # after a signal to both the node is the first to end
                print("rsi_bridge: the ROS side has gone; the offset fades out, packets are answered with zero", file=sys.stderr)

    def _execute(self, command: str, argument: object = None) -> str:
        """Carry out a command; empty, or why not."""
        now = time.monotonic()
        try:
            match command:
                case "model" if isinstance(self.source, ChainSource):
                    self.source.put_in_force(argument, now)  # type: ignore[arg-type]
                case "start":
                    self.source.start(now)
                case "stop":
                    self.source.stop(now)
                case other:
                    return f"the RSI loop can't {other} here"
        except IrecError as error:
            return str(error)
        return ""


def run_bridge(pipe: Connection) -> int:
    """Body of the process: receive a BridgeSetup (or None: end) through the pipe, answer, and again. Exit code."""
    code = _serve(pipe)
    with contextlib.suppress(OSError):  # the other side has gone before
        pipe.send(("ended", ""))  # a signal may have reached this process alone: the other side tells that from a crash
    return code


def _serve(pipe: Connection) -> int:
    while True:
        setup, code = next_setup(pipe)
        if setup is None:
            return code
        refused = [prefer_thread(setup.priority), prefer_processor(setup.processor)]
        try:
            bridge = Bridge(setup, pipe)
        except IrecError as error:
            pipe.send(("failed", str(error)))
            continue
        refused += settle_memory()
        pipe.send(("ready", (bridge.loop.port, [r for r in refused if r])))
        bridge.run()
        if bridge.stopped:
            return 0
