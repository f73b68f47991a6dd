# SPDX-License-Identifier: Apache-2.0
"""The port of the controller is kept while packets come from it; another one is taken over only when it has gone silent."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from irec_correction.rsi.peer import KEPT_PORTS, PeerPort
from irec_correction.rsi.sequence import CONFIRM, RESTART, SHORTEST_PAUSE

CYCLE = 0.004


class Line:
    """Packets at the controller's pace."""

    def __init__(self) -> None:
        self.now = 50.0
        self.peer = PeerPort(CYCLE, self.now)

    def send(self, port: int, packets: int) -> list[bool]:
        admitted = []
        for _ in range(packets):
            self.now += CYCLE
            admitted.append(self.peer.admit(port, self.now))
        return admitted

    def wait(self, cycles: int) -> None:
        self.now += cycles * CYCLE


def test_the_first_port_is_taken_at_once():
    line = Line()
    assert line.send(1000, 3) == [True] * 3
    assert not line.peer.is_fresh, "a controller that was running before may hold a correction"


def test_a_port_that_begins_after_long_listening_is_fresh():
    line = Line()
    line.wait(RESTART)
    line.send(1000, 1)
    assert line.peer.is_fresh


def test_another_port_is_dropped_while_packets_of_the_present_one_come():
    line = Line()
    for _ in range(100):
        line.send(1000, 1)
        assert not line.peer.admit(2000, line.now)
    assert line.peer.port == 1000


def test_a_session_on_another_port_is_taken_over_after_a_silence():
    line = Line()
    line.wait(RESTART)
    line.send(1000, 100)
    line.wait(SHORTEST_PAUSE)
    assert line.send(2000, CONFIRM) == [False] * (CONFIRM - 1) + [True]
    assert line.peer.is_fresh


def test_a_port_whose_session_may_still_hold_an_offset_is_not_taken_back_before_it_has_stopped():
    line = Line()
    line.send(1000, 100)
    line.wait(SHORTEST_PAUSE)
    line.send(2000, CONFIRM)
    line.wait(SHORTEST_PAUSE)
    assert not any(line.send(1000, 3 * RESTART))
    line.wait(RESTART)
    assert any(line.send(1000, 2 * CONFIRM))
    assert line.peer.is_fresh


def test_a_flood_of_ports_makes_no_port_fresh():
    line = Line()
    line.wait(RESTART)
    line.send(1000, 10)
    for port in range(2000, 2000 + 3 * KEPT_PORTS):
        line.peer.admit(port, line.now)
    line.wait(SHORTEST_PAUSE)
    line.send(3000, CONFIRM)
    assert line.peer.port == 3000 and not line.peer.is_fresh


@given(st.lists(st.tuples(st.integers(2000, 2020), st.integers(0, 3)), max_size=200))
def test_no_packets_of_others_displace_a_controller_that_sends_each_cycle(others):
    line = Line()
    line.send(1000, 1)
    for port, more in others:
        for _ in range(more):
            line.peer.admit(port, line.now)
        assert line.send(1000, 1) == [True]
