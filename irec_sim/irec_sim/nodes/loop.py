# SPDX-License-Identifier: Apache-2.0
"""Steps the plant in a thread of its own, in real time or faster, and never faster than its followers."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Any

from ..errors import SimError

MIN_SLEEP = 1e-3  # s; being ahead of the clock by less is not worth a sleep
MAX_HOLD = 4e-3  # s of the machine's clock for which what a step has to say may wait for the next steps
FOLLOWER_POLL = 5e-4  # s
MAX_BACKLOG = 0.1  # s of the machine's clock; time lost beyond this is given up, not caught up in a burst
CALL_CHECK = 0.5  # s of the machine's clock after which a waiting call looks whether there still is a simulation


class SimulationLoop:
    """Runs `step` (which advances simulated time by `period`, s) at `speed` times real time.

    Anything that touches the plant from another thread goes through `call`, so that the plant needs no locks.
    """

    def __init__(
        self,
        step: Callable[[], None],
        period: float,
        speed: float,
        may_go_on: Callable[[], bool],
        flush: Callable[[], None],
    ) -> None:
        """flush: sends what the steps have left to say. Waking a receiver costs more than a message, so steps that
        fall into a few milliseconds of the machine's clock are sent together; in real time that is each step alone."""
        self.speed = speed
        self._step, self._period, self._may_go_on, self._flush = step, period, may_go_on, flush
        self._calls: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any]]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)
        self.failure: BaseException | None = None

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop after the step under way."""
        self._stop.set()
        self._thread.join()

    def call(self, function: Callable[[], Any]) -> Any:
        """Run a function between two steps and return its result; what it raises is raised here.

        Raises:
            SimError: the simulation has ended.
        """
        if threading.current_thread() is self._thread:
            return function()
        future: Future[Any] = Future()
        self._calls.put((function, future))
        while self._thread.is_alive():
            if wait([future], CALL_CHECK).done:
                return future.result()
        raise SimError("the simulation has ended")

    def _run(self) -> None:
        try:
            due = flushed = time.monotonic()
            while not self._stop.is_set():
                self._serve_calls()
                if not self._may_go_on():
                    self._flush()
                    time.sleep(FOLLOWER_POLL)
                    continue
                self._step()
                due += self._period / self.speed
                now = time.monotonic()
                if due - now > MIN_SLEEP or now - flushed > MAX_HOLD:
                    self._flush()
                    now = flushed = time.monotonic()
                    time.sleep(max(due - now, 0.0))  # also when late: lets the threads in that take commands
                if due - now < -MAX_BACKLOG:
                    due = now
        except BaseException as error:
            self.failure = error

    def _serve_calls(self) -> None:
        while not self._calls.empty():
            function, future = self._calls.get()
            try:
                future.set_result(function())
            except Exception as error:
                future.set_exception(error)
