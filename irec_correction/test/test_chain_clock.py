# SPDX-License-Identifier: Apache-2.0
"""The time of the chain where ROS time is that of a simulation which stops."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

pytest.importorskip("irec_msgs.msg._correction_state", reason="irec_msgs is not built: run `make test`")
from irec_correction.nodes import chain_clock
from irec_correction.nodes.chain_clock import LOOK, STANDS, ChainClock

TICK = 0.004  # s


class Times:
    """A simulated and a steady clock that are set by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ros, self.steady = 1000.0, 50.0
        monkeypatch.setattr(chain_clock, "time", SimpleNamespace(monotonic=lambda: self.steady, time=lambda: self.steady + 1e9))
        parameter = SimpleNamespace(value=True)
        clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=round(1e9 * self.ros)))
        self.chain = ChainClock(SimpleNamespace(get_parameter=lambda _: parameter, get_clock=lambda: clock))  # type: ignore[arg-type]

    def tick(self, seconds: float, each: float = TICK, ros: bool = False) -> float:
        """Time of the chain after so long, asked for at every tick; `ros`: the simulation goes on too."""
        for _ in range(round(seconds / each)):
            self.steady += each
            self.ros += each if ros else 0.0
            self.chain.now()
        return self.chain.now()


def test_a_simulation_that_waits_for_a_busy_machine_costs_no_time(monkeypatch):
    assert Times(monkeypatch).tick(0.9 * STANDS) == pytest.approx(1000.0)


def test_a_simulated_clock_that_has_stopped_goes_on_with_the_steady_one(monkeypatch):
    assert Times(monkeypatch).tick(STANDS + 2.0) == pytest.approx(1002.0, abs=2 * TICK)


def test_a_simulated_clock_that_comes_back_counts_again(monkeypatch):
    times = Times(monkeypatch)
    times.tick(STANDS + 2.0)
    assert times.tick(0.1, ros=True) == pytest.approx(1000.1)


def test_time_in_which_the_node_itself_was_stopped_is_not_counted(monkeypatch):
    times = Times(monkeypatch)
    times.tick(0.1)
    times.steady += 100.0
    assert times.chain.now() == pytest.approx(1000.0)
    assert times.tick(STANDS - 0.1 - 2 * LOOK) == pytest.approx(1000.0)


def test_before_the_first_time_of_the_simulation_nothing_goes_on(monkeypatch):
    times = Times(monkeypatch)
    times.ros = 0.0
    assert times.tick(STANDS + 2.0) == 0.0
