# SPDX-License-Identifier: Apache-2.0
"""Whole conversations with a controller that may really stop, on a line with faults and with an intruder of the same address.

The position that the controller executes never makes more than one step of the limits in a cycle. An answer is executed only
with the IPOC of the running cycle; a correction begins at zero only when RSI is started, which takes some cycles. The intruder
repeats, replays and runs ahead, says any Delay, but does not take the place of packets that the controller does not send or that
are lost: nothing could tell it from the controller then.
"""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field

import numpy as np
import pytest
from chain import PERIOD
from hypothesis import given, settings
from hypothesis import strategies as st
from irec_correction.rsi.loop import AHEAD
from irec_correction.rsi.sequence import NEW_CLOCK, RESTART, SHORTEST_PAUSE
from irec_correction.rsi.session import RsiSession
from test_rsi_sequence import COUNTINGS, FAR, STEP, UNCOUNTED, Link, Source

NEAR = 3  # cycles by which an IPOC may be wrong and pass for that of the running cycle
TIMEOUT = 100  # cycles without an answer after which the controller stops RSI
RKORR = re.compile(rb'X="([^"]+)" Y="([^"]+)" Z="([^"]+)".*<IPOC>(\d+)<')


@dataclass
class Controller:
    """Counts late cycles in a row or in all; stops after TIMEOUT of them; is started again after a pause."""

    in_all: bool
    lag: int
    ipoc: int = 4_208_000_000
    held: np.ndarray = field(default_factory=lambda: np.zeros(3))
    row: int = 0
    all: int = 0
    pause: int = 0  # cycles until it is started again; 0: RSI runs
    sessions: int = 1
    clock: int = 0  # where IPOC would be if it had not been set anew
    said: int = 0  # the last IPOC that it sent

    def __post_init__(self) -> None:
        self.shown, self.clock, self.said = [0], self.ipoc, self.ipoc

    @property
    def delay(self) -> int:
        return self.shown[-1 - min(self.lag, len(self.shown) - 1)]

    def cycle_ends(self, replies: list[bytes]) -> None:
        found = [RKORR.search(r).groups() for r in replies]
        mine = [g for g in found if int(g[3]) == self.ipoc]
        if mine:
            self.held = 1e-3 * np.array([float(v) for v in mine[-1][:3]])
        self.row = 0 if mine else self.row + 1
        self.all += not mine
        self.shown.append(self.all if self.in_all else self.row)

    def stop(self, pause: int, ipoc: int | None, forgets: bool) -> None:
        """RSI is off for so many cycles, then begins at zero; ipoc: of its first packet, None: its clock goes on."""
        self.pause, self.held, self.row = pause, np.zeros(3), 0
        self.all = 0 if forgets else self.all
        self.shown = [self.all if self.in_all else 0]
        self.ipoc = self.ipoc + 4 * pause if ipoc is None else ipoc
        self.sessions += 1


class Talk:
    """The bridge's session with such a controller; time within a cycle counts, as it does in the loop."""

    def __init__(self, controller: Controller, rng: random.Random) -> None:
        self.controller, self.rng = controller, rng
        self.source = Source()
        self.session = RsiSession(self.source, "IREC", 4)
        self.begin = 1000.0  # s, of the running cycle
        self.answered_at = -1.0
        self.steps: list[float] = []

    def receive(self, ipoc: int, delay: int | None, at: float) -> bytes | None:
        if self.session.wants_tick and at >= self.answered_at + (1.0 - AHEAD) * PERIOD:
            self.session.tick(at)
        reply = self.session.reply(ipoc, delay, at)
        if reply is not None:
            self.answered_at = at
            self.session.finish(at)
        return reply

    def cycle(self, lost: str = "", intruder: tuple[tuple[float, int, int | None], ...] = ()) -> None:
        """Args: intruder: packets as share of the cycle at which they come, IPOC against the running one in cycles, Delay."""
        c = self.controller
        if not c.pause:
            c.clock = c.ipoc
        if c.pause or lost == "sent":  # what comes in its time would take the place of the controller's own packets
            intruder = tuple(p for p in intruder if not c.said < c.ipoc + 4 * p[1] <= c.clock + 4 * NEAR)
        replies = []
        for share, ahead, delay in sorted(((0.0, None, None), *intruder), key=lambda p: p[0]):
            at = self.begin + share * PERIOD
            if ahead is not None:
                replies.append(self.receive(c.ipoc + 4 * ahead, delay, at))
            elif not c.pause and lost != "sent":
                replies.append(self.receive(c.ipoc, c.delay, at))
                c.said = c.ipoc
        self.begin += PERIOD
        c.clock += 4
        if c.pause:
            c.pause -= 1
            return
        before = c.held
        c.cycle_ends([r for r in replies if r is not None and lost != "answer"])
        self.steps.append(float(np.linalg.norm(c.held - before)))
        c.ipoc += 4
        if c.row >= TIMEOUT:
            c.stop(self.rng.randint(2 * SHORTEST_PAUSE, 3 * RESTART), None, self.rng.random() < 0.5)

    def clean(self, cycles: int) -> Talk:
        for _ in range(cycles):
            self.cycle()
        return self


def disturb(talk: Talk) -> None:
    """One thing that goes wrong, for some cycles."""
    rng, c = talk.rng, talk.controller
    what = rng.choice(["clean", "lost", "repeat", "in step", "burst", "replay", "restart", "boot"])
    cycles = rng.choice([1, 2, 3, 9, 10, 11, 12, 30, 60, 120])
    ahead = rng.choice([-1000, -200, -60, -12, -10, -9, -2, -1, 1, 2, 3, 9, 10, 11, 12, 13, 40, 200, 100_000])
    says = rng.choice(["none", "zero", "own", "large"])
    share = rng.uniform(0.05, 0.95)
    lost = rng.choice(["", "", "", "sent", "answer"])
    if lost:
        cycles = min(cycles, NEW_CLOCK - 1)  # in more the intruder could pass for the controller
    if rng.random() < 0.5:
        talk.source.target = np.array([rng.uniform(-3e-3, 3e-3) for _ in range(3)])

    def delay() -> int | None:
        return {"none": None, "zero": 0, "own": c.delay, "large": 500}[says]

    if what in ("restart", "boot") and not c.pause:
        ipoc = None if what == "restart" else c.ipoc + 4 * rng.choice([-1, 1]) * rng.randint(300, 10**6)
        pause = rng.choice([SHORTEST_PAUSE + 1, 30, 120, 200, 2000]) if what == "restart" else rng.choice([2 * RESTART, 2000])
        c.stop(pause, ipoc, rng.random() < 0.5)
        for _ in range(pause):
            talk.cycle()
    elif what == "clean":
        talk.clean(cycles)
    elif what == "lost":
        which = rng.choice(["sent", "answer"])
        for _ in range(cycles):
            talk.cycle(which if rng.random() < 0.8 else "")
    elif what == "repeat":
        first = c.ipoc
        for _ in range(cycles):
            talk.cycle(lost, ((share, ahead - (c.ipoc - first) // 4, delay()),))
    elif what == "in step":  # one a cycle
        for _ in range(cycles):
            talk.cycle(lost, ((share, ahead, delay()),))
    elif what == "burst":
        talk.cycle(lost, tuple((share * k / cycles, ahead + k, delay()) for k in range(1, cycles + 1)))
    elif what == "replay":  # a burst of packets in step, in each of some cycles
        for n in range(min(cycles, 12)):
            talk.cycle(lost, tuple((share * k / 9, ahead + 9 * n + k, delay()) for k in range(1, 10)))


def a_conversation(seed: int, in_all: bool, lag: int) -> Talk:
    rng = random.Random(f"{seed} {in_all} {lag}")
    talk = Talk(Controller(in_all, lag), rng).clean(rng.choice([5, 40, 120]))
    for _ in range(rng.randint(1, 8)):
        disturb(talk)
        talk.clean(rng.choice([0, 1, 5, 30]))
    return talk.clean(30)


@pytest.mark.parametrize("lag", [0, 1])
@pytest.mark.parametrize("in_all", [False, True])
@settings(max_examples=400, derandomize=True)
@given(seed=st.integers(0, 10**9))
def test_the_controller_never_executes_more_than_one_step_of_the_limits(in_all, lag, seed):
    talk = a_conversation(seed, in_all, lag)
    assert max(talk.steps) <= STEP


@pytest.mark.parametrize("counting", [*COUNTINGS, *UNCOUNTED])
@pytest.mark.parametrize("ahead", [3, 9, 12, 40])
def test_one_packet_ahead_repeated_until_it_is_in_its_time_is_no_new_clock_for_the_packets_after_it(counting, ahead):
    link = Link(counting).run(200)
    for _ in range(ahead):  # the controller's packets are held up meanwhile, and counted by it
        link.now += PERIOD
        link.row, link.all = link.row + 1, link.all + 1
        link.shown.append((link.all if counting.in_all else link.row) if counting.counts else 0)
        link.receive((link.ipoc + 4 * ahead, 0))
    link.run(90)
    assert max(link.largest_step_sent, link.steps.max()) <= STEP
    assert link.sequence.sessions == 1


@pytest.mark.parametrize("in_all", [False, True])
@pytest.mark.parametrize("pause", [SHORTEST_PAUSE + 1, 50, 2 * RESTART])
def test_a_controller_that_was_really_started_again_is_answered_from_zero(in_all, pause):
    talk = Talk(Controller(in_all, 0), random.Random(1)).clean(200)
    np.testing.assert_allclose(talk.controller.held, FAR, atol=1e-6)
    talk.controller.stop(pause, None, False)
    talk.clean(pause + 200)
    assert max(talk.steps) <= STEP
    assert talk.session.sequence.sessions == 2
    np.testing.assert_allclose(talk.controller.held, FAR, atol=1e-6)


@pytest.mark.parametrize("pause", [SHORTEST_PAUSE + 1, 2 * RESTART])
def test_a_stranger_in_the_place_of_a_stopped_controller_can_not_be_told_and_costs_no_more_than_the_offset(pause):
    """What docs/security.md says: the controller begins at zero, the bridge goes on with what the stranger has asked for."""
    talk = Talk(Controller(False, 0), random.Random(1)).clean(200)
    c = talk.controller
    c.stop(pause, None, True)
    while c.pause:
        assert talk.receive(c.ipoc - 4 * c.pause, 0, talk.begin) is not None
        talk.begin += PERIOD
        c.pause -= 1
    talk.steps.clear()
    talk.clean(50)
    assert talk.session.sequence.sessions == 1, "if this fails it can be told: say so in docs/security.md"
    assert STEP < max(talk.steps) <= float(np.linalg.norm(FAR)) + STEP
