# SPDX-License-Identifier: Apache-2.0
"""The RSI loop against a controller that speaks the same bytes: answers, late packets, lost packets, strangers."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from chain import PERIOD, ROBOT, URDF, WRENCH, Q, model
from irec_correction.conditioning import FilterSettings
from irec_correction.correction import CorrectionSettings
from irec_correction.deflection import Deflection
from irec_correction.errors import CorrectionError, SettingsError
from irec_correction.rsi.loop import Link, RsiLoop
from irec_correction.rsi.report import REPORT_SIZE, WHERE, counts
from irec_correction.rsi.sequence import RESTART
from irec_correction.rsi.sources import OFFSET_SIZE, ChainSettings, ChainSource, GivenSource
from irec_correction.shared import WRENCH_SIZE, SharedValues
from irec_correction.state import State
from irec_correction.watchdog import Fault, Finding
from irec_sim.devices.rsi_controller import RobotState, RsiController

pytestmark = pytest.mark.timed

RATE = CorrectionSettings().limits.translation.rate
STEP = RATE * PERIOD * (1 + 1e-9) + 2e-7  # packets carry 0.1 um
PATIENT = replace(  # a shared machine may hold this process up for longer than a real cell would accept
    CorrectionSettings(),
    watchdog=replace(CorrectionSettings().watchdog, wrench_timeout=1.0, joints_timeout=2.0, frozen_after=1.5),
)
STATE = RobotState(Q, np.array([1.5, 0.0, 1.2]), np.zeros(3))
LONG = 30.0  # s, in which a chain that works comes to ACTIVE


class Cell:
    """Controller and loop in two threads, wrench written as the sensor's process would."""

    def __init__(self, settings: CorrectionSettings = PATIENT) -> None:
        self.wrench = SharedValues.create(WRENCH_SIZE)
        self.report = SharedValues.create(REPORT_SIZE)
        self.source = ChainSource(ChainSettings(settings, FilterSettings(cutoff=0.0), URDF.read_text(), self.wrench.name))
        self.source.put_in_force(model(), time.monotonic())
        self.loop = RsiLoop(Link(port=0), self.source, self.report)
        self.controller = RsiController(("127.0.0.1", self.loop.port))
        self.sensor_works, self.running = True, True
        self.rng, self.count = np.random.default_rng(0), 0
        self.thread = threading.Thread(target=self.loop.run, args=(lambda: self.running,))
        self.thread.start()

    def state(self) -> RobotState:
        if self.sensor_works:
            self.count += 1
            noisy = WRENCH + self.rng.normal(0, 0.2, 6)
            self.wrench.write(np.array([time.monotonic(), self.count, 0.0, *noisy]))
        return STATE

    @property
    def sent(self) -> list[np.ndarray]:
        """Offset that acts in the controller, one per cycle."""
        return self.controller.acted

    def drive(self, seconds: float) -> None:
        self.controller.run(round(seconds / PERIOD), self.state)

    def until(self, state: State, seconds: float = LONG) -> None:
        self.until_true(lambda: self.source.state is state, state.name, seconds)

    def until_true(self, condition: Callable[[], bool], what: str, seconds: float = LONG) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"no {what}; {self.source.state.name} ({self.source.reason})"
            self.drive(0.05)

    @property
    def largest_step(self) -> float:
        """Between two cycles of the controller, whatever was lost between them."""
        return self.largest_step_since(0)

    def largest_step_since(self, cycle: int) -> float:
        """Between two cycles of the controller from that one on."""
        return float(np.linalg.norm(np.diff(np.array(self.sent[cycle:]), axis=0), axis=1).max())

    def close(self) -> None:
        self.running = False
        self.thread.join(5.0)
        for c in (self.loop, self.controller, self.wrench, self.report):
            c.close()


@pytest.fixture
def cell():
    made = Cell()
    yield made
    made.close()


@pytest.fixture
def active(cell):
    cell.drive(0.1)
    cell.source.start(time.monotonic())
    cell.until(State.ACTIVE)
    return cell


def test_controller_gets_minus_the_deflection_of_the_model_and_its_own_ipoc_back(active):
    expected, _ = Deflection(model(), ROBOT)(Q, WRENCH[:3], WRENCH[3:], PERIOD)
    active.until_true(lambda: np.linalg.norm(active.sent[-1] + expected) < 3e-6, "offset as large as the deflection")
    assert active.controller.counts.wrong == 0
    assert active.controller.counts.answered > 0
    values = np.zeros(REPORT_SIZE)

    def told() -> bool:  # the report is of the last cycle that was answered, which the controller may not have acted on yet
        return active.report.read(values) and np.allclose(values[WHERE["translation"]], active.sent[-1], rtol=0.0, atol=1e-6)

    active.until_true(told, "report of the offset that acts")
    np.testing.assert_allclose(values[WHERE["deflection"]], expected, atol=3e-6)
    np.testing.assert_allclose(values[WHERE["wrench"]], WRENCH, atol=2.0)
    np.testing.assert_allclose(values[WHERE["q"]], Q, atol=1e-6)
    told = counts(values)
    assert told["sessions"] == 1 and told["ticks"] > 0


@pytest.mark.parametrize("packets", [1, 5, 60])
@pytest.mark.parametrize("fault", ["lose_sent", "lose_answers", "late_answers", "double_sent", "old_again"])
def test_faults_of_the_link_make_no_step_and_do_not_stop_the_robot(active, packets, fault):
    setattr(active.controller.faults, fault, packets)
    active.drive(0.1 + packets * PERIOD)
    active.until(State.ACTIVE)
    assert not active.controller.stopped
    if fault in ("double_sent", "old_again"):
        heard = active.loop.session.sequence, active.loop.counts
        active.until_true(lambda: heard[0].duplicate + heard[1].late_here >= packets, f"count of {packets} packets")
    else:
        assert active.controller.counts.most_late_in_a_row >= packets
    assert active.largest_step <= STEP


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["lose_sent", "lose_answers", "late_answers"])
def test_faults_while_the_offset_changes_fast_make_no_step(active, fault):
    before = len(active.sent)
    for i in range(12):
        active.source.put_in_force(model(scale=1.0 + i % 2), time.monotonic())
        active.drive(0.1)
        setattr(active.controller.faults, fault, 1 + i % 4)
        active.drive(0.05)
    assert np.ptp(np.linalg.norm(active.sent, axis=1)[before:]) > 1e-4
    assert active.largest_step <= STEP


def test_a_new_session_of_the_controller_begins_at_zero_and_ramps_in(active):
    active.controller.start_again()
    before = len(active.sent)
    active.until_true(lambda: active.loop.session.sequence.sessions == 2, "second session")
    assert np.linalg.norm(active.sent[before - 1]) < 1e-7, "the controller holds none of the last session"
    assert active.largest_step_since(before - 1) <= STEP, "so no answer begins with the offset of the last session"
    active.until(State.ACTIVE)
    active.until_true(lambda: np.linalg.norm(active.sent[-1]) > 5e-4, "offset after the ramp")
    assert active.largest_step_since(before - 1) <= STEP


def test_after_a_silence_that_stops_rsi_the_next_session_begins_at_zero(active):
    active.controller.start_again(2 * RESTART)
    before = len(active.sent)
    active.until_true(lambda: active.loop.session.sequence.sessions == 2, "second session")
    assert np.linalg.norm(active.sent[before - 1]) < 1e-7, "the controller holds none of the last session"
    assert active.largest_step_since(before - 1) <= STEP, "so no answer begins with the offset of the last session"


def test_two_hundred_lost_packets_reach_the_timeout_of_the_robot(active):
    active.controller.faults.lose_answers = 200
    active.drive(1.0)
    assert "100 packets in a row" in active.controller.stopped
    assert active.largest_step <= STEP


@pytest.mark.slow
def test_a_dead_sensor_is_held_then_faded_while_every_packet_is_answered(active):
    active.sensor_works = False
    active.until(State.FAULT)
    assert active.sent[-1] == pytest.approx(0.0, abs=2e-7)
    assert active.largest_step <= STEP
    assert active.controller.counts.most_late_in_a_row < active.controller.timeout
    assert "no wrench" in active.source.reason


def test_another_model_under_way_makes_no_step(active):
    active.source.put_in_force(model(scale=1.6), time.monotonic())
    active.until(State.ACTIVE)
    active.drive(0.7)
    assert active.largest_step <= STEP


def test_of_several_waiting_packets_only_the_newest_is_answered():
    block = SharedValues.create(OFFSET_SIZE)
    loop = RsiLoop(Link(port=0), GivenSource(CorrectionSettings(), block, 0.1))
    controller = RsiController(("127.0.0.1", loop.port))
    controller.cycle(STATE, time.perf_counter())
    assert loop.once()
    for _ in range(3):
        controller.cycle(STATE, time.perf_counter())  # no time to answer
    time.sleep(2 * PERIOD)  # the loop is held up
    assert loop.once()
    assert loop.counts.late_here == 2 and loop.counts.answered == 2
    for closed in (loop, controller, block):
        closed.close()


def test_packets_that_are_unreadable_are_counted_and_not_answered():
    block = SharedValues.create(OFFSET_SIZE)
    loop = RsiLoop(Link(port=0), GivenSource(CorrectionSettings(), block, 0.1))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(b"hello", ("127.0.0.1", loop.port))
        assert not loop.once()
    assert loop.counts.bad == 1
    loop.close()
    block.close()


def test_a_stranger_is_not_answered():
    block = SharedValues.create(OFFSET_SIZE)
    loop = RsiLoop(Link(port=0, peer="127.0.0.2"), GivenSource(CorrectionSettings(), block, 0.1))
    controller = RsiController(("127.0.0.1", loop.port))
    controller.cycle(STATE, time.perf_counter())
    assert not loop.once()
    assert loop.counts.foreign == 1
    for closed in (loop, controller, block):
        closed.close()


@pytest.mark.parametrize("link", [{"address": "0.0.0.0"}, {"peer": "0.0.0.0"}, {"peer": "robot"}, {"port": 70000}])
def test_a_link_that_is_not_one_interface_and_one_peer_is_refused(link):
    with pytest.raises(SettingsError):
        Link(**link)


def test_an_address_that_this_machine_does_not_have_is_refused():
    block = SharedValues.create(OFFSET_SIZE)
    with pytest.raises(CorrectionError, match="192.0.2.1"):
        RsiLoop(Link(address="192.0.2.1"), GivenSource(CorrectionSettings(), block, 0.1))
    block.close()


@pytest.mark.parametrize("own_port", [True, False])
@pytest.mark.parametrize("attack", ["ten cycles ahead", "ten old ones"])
def test_packets_of_somebody_else_at_the_address_of_the_controller_make_no_step(active, attack, own_port):
    controller = active.controller
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 0))
        sender = controller._socket if own_port else stranger
        now = controller.ipoc
        forged = [now + 10 * 4] if attack == "ten cycles ahead" else [now - 4 * k for k in range(60, 50, -1)]
        for ipoc in forged:
            controller.ipoc = ipoc
            sender.sendto(controller.packet(STATE), ("127.0.0.1", active.loop.port))
            controller.ipoc = now
            active.drive(PERIOD)
            now = controller.ipoc
        active.drive(0.3)
    assert active.largest_step <= STEP
    assert active.loop.session.sequence.sessions == 1


def test_a_controller_that_opens_another_socket_for_its_next_session_is_answered(active):
    old = active.controller
    active.controller = RsiController(("127.0.0.1", active.loop.port))
    old.close()
    active.until_true(lambda: active.loop.session.sequence.sessions == 2, "second session")
    active.until_true(lambda: active.controller.counts.answered > 50, "answers in it")
    assert active.largest_step <= STEP


@pytest.mark.parametrize("digits", [20, 320, 3000])
def test_an_ipoc_or_delay_of_many_digits_does_not_end_the_loop(active, digits):
    many = b"9" * digits
    for packet in (b'<Delay D="1"/><IPOC>%s</IPOC>' % many, b'<Delay D="%s"/><IPOC>%d</IPOC>' % (many, active.controller.ipoc)):
        active.controller._socket.sendto(packet, ("127.0.0.1", active.loop.port))
    active.drive(0.1)
    assert active.thread.is_alive()
    assert active.largest_step <= STEP


def given_source() -> tuple[GivenSource, SharedValues]:
    block = SharedValues.create(OFFSET_SIZE)
    return GivenSource(CorrectionSettings(), block, 0.05), block


def test_given_offsets_are_followed_then_held_and_faded_when_they_stop():
    source, block = given_source()
    wanted = np.array([5e-4, -2e-4, 1e-4])
    sent, now = [np.zeros(3)], 50.0
    block.write(np.array([now, 1.0, *wanted, 0, 0, 0]))
    source.start(now)
    for i in range(1200):
        now += PERIOD
        if i < 400:
            block.write(np.array([now, 1.0, *wanted, 0, 0, 0]))
        sent.append(source.offset(now)[0].copy())
        if i == 399:
            np.testing.assert_allclose(sent[-1], wanted, atol=1e-9)
    assert source.state is State.FAULT
    np.testing.assert_allclose(sent[-1], 0.0, atol=1e-8)
    assert np.linalg.norm(np.diff(np.array(sent), axis=0), axis=1).max() <= RATE * PERIOD * (1 + 1e-9)
    block.close()


def test_a_source_that_is_started_before_the_first_offset_waits_for_it():
    source, block = given_source()
    source.start(50.0)
    for i in range(1000):
        source.offset(50.0 + i * PERIOD)
    assert source.state is State.INACTIVE and "waiting for the first offset" in source.reason
    wanted = np.array([2e-4, 0, 0])
    for i in range(200):
        block.write(np.array([60.0 + i * PERIOD, 1.0, *wanted, 0, 0, 0]))
        sent = source.offset(60.0 + i * PERIOD)[0]
    assert source.state is State.ACTIVE
    np.testing.assert_allclose(sent, wanted, atol=1e-9)
    block.close()


def fed(source, block):
    """Start a source; a function that gives it an offset along x, m (None: none), for some seconds and tells its state, and the
    list of what it sends, (3,) each."""
    now, sent = 50.0, []
    source.start(now)

    def run(seconds: float, offset: float | None) -> State:
        nonlocal now
        for _ in range(round(seconds / PERIOD)):
            now += PERIOD
            if offset is not None:
                block.write(np.array([now, 1.0, offset, 0, 0, 0, 0, 0]))
            sent.append(source.offset(now)[0].copy())
        return source.state

    return run, sent


def test_after_a_fault_offsets_are_followed_again_once_their_source_has_begun_at_zero():
    source, block = given_source()
    run, states = fed(source, block)
    assert run(1.0, 3e-4) is State.ACTIVE
    assert run(3.0, None) is State.FAULT
    assert run(1.0, 3e-4) is State.FAULT
    assert run(1.0, 0.0) is State.ACTIVE
    assert run(1.0, 3e-4) is State.ACTIVE
    assert np.linalg.norm(np.diff(np.array(states), axis=0), axis=1).max() <= RATE * PERIOD * (1 + 1e-9)
    block.close()


def test_offsets_that_end_at_zero_are_no_fault_and_the_next_ones_are_followed():
    source, block = given_source()
    run, _ = fed(source, block)
    assert run(1.0, 3e-4) is State.ACTIVE
    assert run(0.3, 0.0) is State.ACTIVE
    assert run(3.0, None) is State.INACTIVE and "ended at zero" in source.reason
    assert run(1.0, 3e-4) is State.ACTIVE
    block.close()


def test_offsets_that_were_refused_are_held_and_faded_with_the_reason():
    source, block = given_source()
    source.start(50.0)
    now = 50.0
    for i in range(1000):
        now += PERIOD
        block.write(np.array([now, 1.0, 3e-4, 0, 0, 0, 0, 0]))
        if i == 300:
            source.refuse("offset topic", Finding(Fault.OFFSET_FRAME, "offset comes in frame 'tool0'"))
        source.offset(now)
    assert source.state is State.FAULT and "'tool0'" in source.reason
    block.close()


def test_shared_values_of_a_writer_that_died_in_the_middle_are_not_used():
    block = SharedValues.create(4)
    reader = SharedValues.attach(block.name, 4)
    block.write(np.arange(4.0))
    into = np.zeros(4)
    assert reader.read(into) and into[3] == 3.0
    block._sequence[0] += 1
    assert not reader.read(into)
    reader.close()
    block.close()
    with pytest.raises(CorrectionError, match="does not exist"):
        SharedValues.attach("irec_nobody_wrote_this", 4)
