# SPDX-License-Identifier: Apache-2.0
"""Computations in a process of their own: spawned (never forked: libraries with threads do not survive it), with progress, to be
cancelled. A worker that does not listen to a cancel is ended and started again."""

from __future__ import annotations

import asyncio
import multiprocessing
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from typing import Any, TypeVar

from ..errors import Cancelled, IrecError
from .desk import Desk

PATIENCE = 2.0  # s that a worker has to notice a cancel before it is ended
POLL = 0.05  # s
Progress = Callable[[float, str], None]
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Running:
    """A process with a `Desk` in it, our end of its pipe, and the event that asks it to stop."""

    process: Any
    pipe: Connection
    stop: Event

    def end(self) -> None:
        """End it in the middle of whatever it does."""
        if self.process.is_alive():
            self.process.kill()
            self.process.join(5.0)
        self.pipe.close()


class Stock:
    """Processes that wait for work: starting one takes seconds, most of them imports."""

    def __init__(self, effect_files: tuple[str, ...] = (), most: int = 2) -> None:
        self._effect_files = effect_files
        self._most = most
        self._context = multiprocessing.get_context("spawn")
        self._idle: list[Running] = []
        self._lock = threading.Lock()
        self._closed = False

    def fill(self, count: int) -> None:
        """Start processes ahead of work."""
        for _ in range(count):
            self.give_back(self._begin())

    def take(self) -> Running:
        """A process that is ready, or a new one."""
        with self._lock:
            while self._idle:
                running = self._idle.pop()
                if running.process.is_alive():
                    return running
                running.end()
        return self._begin()

    def give_back(self, running: Running) -> None:
        """Keep a process that has nothing to do for the next one who needs it."""
        with self._lock:
            if not self._closed and len(self._idle) < self._most and running.process.is_alive():
                self._idle.append(running)
                return
        running.end()

    def close(self) -> None:
        """End all that wait."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
        for running in idle:
            running.end()

    def _begin(self) -> Running:
        ours, theirs = self._context.Pipe()
        stop = self._context.Event()
        process = self._context.Process(
            target=_work, args=(theirs, stop, self._effect_files), name="irec workbench worker", daemon=True
        )
        process.start()
        theirs.close()
        return Running(process, ours, stop)


class Worker:
    """Calls to a `Desk` in another process; one computation at a time, others wait for their turn."""

    def __init__(self, stock: Stock | None = None) -> None:
        self._stock = stock or Stock(most=0)
        self._running: Running | None = None
        self._turn = asyncio.Lock()
        self._busy = False
        self._asked_at: float | None = None

    @property
    def busy(self) -> bool:
        return self._busy

    async def call(self, task: Callable[..., Answer], *arguments: Any, progress: Progress | None = None) -> Answer:
        """Run one method of the desk.

        Args:
            task: method of `Desk`, e.g. `Desk.view`. arguments: without `progress` and `cancelled`, which the process adds.

        Raises:
            Cancelled: `cancel` was called. IrecError: what the computation says is wrong, or that its process died.
        """
        async with self._turn:
            self._busy, self._asked_at = True, None
            try:
                if self._running is None or not self._running.process.is_alive():
                    self._end()
                    self._running = await asyncio.to_thread(self._stock.take)
                self._running.stop.clear()
                self._running.pipe.send((task, arguments))
                answer: Answer = await self._answer(self._running, progress)
                return answer
            except (EOFError, BrokenPipeError, ConnectionResetError) as error:
                self._end()
                raise IrecError("the computation's process ended unexpectedly; try again") from error
            finally:
                self._busy = False

    async def _answer(self, running: Running, progress: Progress | None) -> Any:
        pipe, process = running.pipe, running.process
        while True:
            if pipe.poll():
                kind, value = pipe.recv()
                if kind == "progress":
                    if progress is not None:
                        progress(*value)
                elif kind == "done":
                    return value
                elif kind == "cancelled":
                    raise Cancelled(value)
                else:
                    raise IrecError(value)
            elif not process.is_alive():
                raise EOFError
            elif self._asked_at is not None and time.monotonic() - self._asked_at > PATIENCE:
                self._end()
                raise Cancelled("cancelled")
            else:
                await asyncio.sleep(POLL if progress is not None else 0.005)

    def cancel(self) -> None:
        """Ask the computation that runs now to stop."""
        if self._busy:
            if self._running is not None:
                self._running.stop.set()
            self._asked_at = time.monotonic()

    def rest(self) -> None:
        """Give the process back where nothing runs in it; the next call takes one again."""
        if self._running is not None and not self._busy:
            self._stock.give_back(self._running)
            self._running = None

    async def warm(self) -> None:
        """Start the process ahead of the first computation."""
        await self.call(Desk.ready)

    def close(self) -> None:
        """End the process."""
        self._end()

    def _end(self) -> None:
        if self._running is not None:
            self._running.end()
        self._running = None


def _work(pipe: Connection, stop: Event, effect_files: tuple[str, ...]) -> None:
    """The loop of the process."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which ends this one

    try:
        desk = Desk(effect_files)
    except IrecError as error:
        pipe.send(("error", str(error)))
        return

    last = 0.0

    def progress(share: float, what: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > 0.1 or share >= 1.0:
            last = now
            pipe.send(("progress", (share, what)))
        if stop.is_set():
            raise Cancelled("cancelled")

    while True:
        try:
            task, arguments = pipe.recv()
        except (EOFError, OSError):
            return  # the server is gone
        try:
            pipe.send(("done", task(desk, *arguments, progress, stop.is_set)))
        except Cancelled as error:
            pipe.send(("cancelled", str(error)))
        except IrecError as error:
            pipe.send(("error", str(error)))
        except Exception as error:  # whatever a user's effect raises must not end the page
            traceback.print_exc()
            pipe.send(("error", f"{type(error).__name__}: {error}"))
