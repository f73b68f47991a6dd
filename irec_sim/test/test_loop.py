# SPDX-License-Identifier: Apache-2.0
"""The loop of the simulation: pace, calls between steps, waiting for followers, failure."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest
from irec_sim.errors import SimError
from irec_sim.nodes.loop import MIN_SLEEP, SimulationLoop

PATIENCE = 10.0  # s


class Counter:
    def __init__(self) -> None:
        self.steps, self.sent = 0, 0
        self.open = threading.Event()
        self.open.set()

    def step(self) -> None:
        self.steps += 1

    def flush(self) -> None:
        self.sent = self.steps


@pytest.fixture
def running() -> Iterator[Callable[..., tuple[Counter, SimulationLoop]]]:
    loops: list[SimulationLoop] = []

    def start(speed: float, step: Callable[[], None] | None = None) -> tuple[Counter, SimulationLoop]:
        counter = Counter()
        loops.append(SimulationLoop(step or counter.step, 0.004, speed, counter.open.is_set, counter.flush))
        loops[-1].start()
        return counter, loops[-1]

    yield start
    for loop in loops:
        loop.stop()


def wait(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.001)


def test_the_simulation_is_never_faster_than_its_speed(running: Callable[..., tuple[Counter, SimulationLoop]]) -> None:
    begin = time.monotonic()
    counter, _ = running(2.0)
    wait(lambda: counter.steps >= 100)
    assert time.monotonic() - begin >= 99 * 0.004 / 2.0 - MIN_SLEEP


def test_everything_said_is_sent_while_the_simulation_waits_for_a_follower(
    running: Callable[..., tuple[Counter, SimulationLoop]],
) -> None:
    counter, _ = running(100.0)
    wait(lambda: counter.steps > 10)
    counter.open.clear()
    wait(lambda: counter.sent == counter.steps)
    held = counter.steps
    time.sleep(0.05)
    assert counter.steps == held
    counter.open.set()
    wait(lambda: counter.steps > held)


def test_a_call_runs_in_the_thread_of_the_simulation_and_returns_its_result(
    running: Callable[..., tuple[Counter, SimulationLoop]],
) -> None:
    _, loop = running(1.0)
    assert loop.call(lambda: threading.current_thread().name) == "simulation"


def test_an_error_of_a_call_is_raised_at_the_caller_and_the_simulation_goes_on(
    running: Callable[..., tuple[Counter, SimulationLoop]],
) -> None:
    counter, loop = running(1.0)
    with pytest.raises(ZeroDivisionError):
        loop.call(lambda: 1 // 0)
    steps = counter.steps
    wait(lambda: counter.steps > steps)
    assert loop.failure is None


def test_an_error_of_a_step_ends_the_simulation_and_is_kept(running: Callable[..., tuple[Counter, SimulationLoop]]) -> None:
    def fail() -> None:
        raise ValueError("no equilibrium")

    _, loop = running(1.0, fail)
    wait(lambda: loop.failure is not None)
    assert str(loop.failure) == "no equilibrium"
    with pytest.raises(SimError, match="ended"):
        loop.call(lambda: None)
