# SPDX-License-Identifier: Apache-2.0
"""The CAN force sensor: bytes, faults, and the reader against a sensor that speaks the same protocol."""

from __future__ import annotations

import struct
import threading
import time
import uuid
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irec_correction.can_ft.netft_can import Assembler, Calibration, Request, advance, errors_of, request
from irec_correction.can_ft.reader import Bus, ReaderSettings, SensorReader
from irec_correction.errors import CorrectionError, ProtocolError, SettingsError
from irec_sim.devices.netft_can import NetFtCan, SlcanAdapter, serve

LOAD = np.array([120.5, -80.25, -900.0, 3.5, -2.25, 0.125])
CALIBRATION = Calibration(1e6, 1e6)


def feed(assembler: Assembler, frames):
    out = [assembler.take(i, d) for i, d in frames]
    return out[-1] if out else None


def test_request_is_one_byte_on_the_base_identifier():
    assert request(0x40, Request.LONG) == (0x40, b"\x01")
    assert request(0x40, Request.BIAS) == (0x40, b"\x04")


def test_long_answer_is_four_frames_of_two_little_endian_numbers():
    frames = [
        (0x41, bytes.fromhex("80841e0040420f00")),  # 2 000 000, 1 000 000 counts
        (0x42, bytes.fromhex("c0bdf0ff00000000")),  # -1 000 000
        (0x43, bytes.fromhex("00000000ffffffff")),
        (0x44, bytes.fromhex("000000002a000000")),
    ]
    reading = feed(Assembler(0x40, CALIBRATION), frames)
    np.testing.assert_allclose(reading.wrench, [2.0, -1.0, 0.0, 1.0, 0.0, -1e-6])
    assert reading.status == 0 and reading.sample == 42


def test_short_answer_is_two_frames_of_four_numbers():
    calibration = Calibration(100.0, 1000.0)
    frames = [(0x45, struct.pack("<hhhh", 1000, 500, -200, 0)), (0x46, struct.pack("<hhHH", -32768, 1, 0x8000, 7))]
    reading = feed(Assembler(0x40, calibration, short=True), frames)
    np.testing.assert_allclose(reading.wrench, [10.0, -2.0, -327.68, 0.5, 0.0, 0.001])
    assert reading.errors == ["status 0x8000"] and reading.sample == 7


def test_units_other_than_newton_are_converted():
    sensor = NetFtCan(lambda: LOAD / 4.4482216)
    reading = feed(Assembler(0x40, Calibration(1e6, 1e6, 4.4482216, 4.4482216)), sensor.answer(0x40, b"\x01"))
    np.testing.assert_allclose(reading.wrench, LOAD, atol=1e-5)


@given(st.tuples(*(st.floats(-2000, 2000) for _ in range(6))), st.booleans())
def test_what_the_sensor_sends_is_what_is_read(load, short):
    divisor = 100.0 if short else 1.0
    sensor = NetFtCan(lambda: np.array(load), counts_per_force=1000.0, counts_per_torque=1000.0, short_divisor=divisor)
    calibration = Calibration(1000.0, 1000.0, short_scale=(divisor,) * 6)
    reading = feed(Assembler(0x40, calibration, short), sensor.answer(0x40, b"\x02" if short else b"\x01"))
    np.testing.assert_allclose(reading.wrench, load, atol=0.06 if short else 6e-4)


def test_an_answer_that_lost_a_frame_gives_no_reading_and_the_next_one_is_whole():
    sensor, assembler = NetFtCan(lambda: LOAD), Assembler(0x40, CALIBRATION)
    assert feed(assembler, sensor.answer(0x40, b"\x01")[1:]) is None
    assembler.begin()
    assert assembler.incomplete == 1
    assert feed(assembler, sensor.answer(0x40, b"\x01")) is not None


def test_frames_of_somebody_else_are_ignored_and_those_of_wrong_length_refused():
    assembler = Assembler(0x40, CALIBRATION)
    assert assembler.take(0x123, b"\0" * 8) is None
    assert assembler.foreign == 1
    with pytest.raises(ProtocolError, match="0x41.*3 bytes"):
        assembler.take(0x41, b"abc")


def test_bias_takes_the_present_load_as_zero():
    sensor, assembler = NetFtCan(lambda: LOAD), Assembler(0x40, CALIBRATION)
    assert sensor.answer(*request(0x40, Request.BIAS)) == []
    np.testing.assert_allclose(feed(assembler, sensor.answer(0x40, b"\x01")).wrench, 0.0)


@pytest.mark.parametrize(("status", "short", "errors"), [
    (0, False, 0), (0, True, 0), (1 << 16, False, 0), (1 << 9, False, 1), (1 << 17 | 1 << 31, False, 2), (1, True, 1),
])  # fmt: skip
def test_a_status_bit_is_an_error_unless_it_is_known_to_be_none(status, short, errors):
    assert len(errors_of(status, short)) == errors


def test_counter_goes_on_over_its_end():
    assert advance(0xFFFF, 1, 16) == 2
    assert advance(0xFFFFFFFF, 0, 32) == 1


@pytest.mark.parametrize(
    "make", [lambda: Calibration(0.0), lambda: Assembler(0x7FA, CALIBRATION), lambda: ReaderSettings(rate=0.0)]
)
def test_settings_that_can_not_be_are_refused(make):
    with pytest.raises(SettingsError):
        make()


def test_a_bus_that_is_not_there_is_named():
    with pytest.raises(CorrectionError, match="slcan:/dev/not_there"):
        SensorReader(ReaderSettings(Bus("slcan", "/dev/not_there")), lambda *_: None)


class Running:
    """Sensor and reader at work, on a virtual bus of this process."""

    def __init__(self, settings: ReaderSettings) -> None:
        self.readings: list = []
        self.stamped: list = []
        self.going = True
        self.reader = SensorReader(settings, self.deliver)
        self.thread = threading.Thread(target=self.reader.run, args=(lambda: self.going,))
        self.thread.start()

    def deliver(self, reading, now: float) -> None:
        self.stamped.append((reading, now))
        self.readings.append(reading)

    def until(self, condition, seconds: float = 30.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, self.reader.counts
            time.sleep(0.01)

    def close(self) -> None:
        self.going = False
        self.thread.join(5.0)
        self.reader.close()


@pytest.fixture
def on_virtual_bus():
    import can

    channel = uuid.uuid4().hex
    sensor, going = NetFtCan(lambda: LOAD), [True]
    bus = can.Bus(interface="virtual", channel=channel)
    thread = threading.Thread(target=serve, args=(sensor, bus, lambda: going[0]))
    thread.start()
    running = Running(ReaderSettings(Bus("virtual", channel), rate=100.0))
    yield sensor, running
    running.close()
    going[0] = False
    thread.join(5.0)
    bus.shutdown()


def test_reader_passes_on_what_acts_on_the_sensor(on_virtual_bus):
    _, running = on_virtual_bus
    running.until(lambda: len(running.readings) > 10)
    np.testing.assert_allclose(running.readings[-1].wrench, LOAD, atol=1e-5)


def test_a_sensor_that_repeats_one_sample_is_not_passed_on(on_virtual_bus):
    sensor, running = on_virtual_bus
    running.until(lambda: running.readings)
    sensor.faults.frozen = True
    running.until(lambda: running.reader.counts.repeated > 5)
    read = len(running.readings)
    running.until(lambda: running.reader.counts.repeated > 10)
    assert len(running.readings) == read


def test_a_silent_sensor_is_counted_and_comes_back(on_virtual_bus):
    sensor, running = on_virtual_bus
    running.until(lambda: running.readings)
    sensor.faults.silent = True
    running.until(lambda: running.reader.counts.unanswered > 5)
    sensor.faults.silent = False
    read = len(running.readings)
    running.until(lambda: len(running.readings) > read + 2)
    assert running.reader.counts.gaps > 0


def test_status_bits_arrive(on_virtual_bus):
    sensor, running = on_virtual_bus
    sensor.faults.status = 1 << 5 | 1 << 16
    running.until(lambda: running.readings and running.readings[-1].errors)
    assert running.readings[-1].errors == ["bit 5 (supply voltage too low)"]


def test_over_a_serial_adapter_the_reader_survives_that_it_is_unplugged():
    adapter = SlcanAdapter(NetFtCan(lambda: LOAD))
    running = Running(ReaderSettings(Bus("slcan", adapter.channel), rate=50.0))
    running.until(lambda: len(running.readings) > 5)
    np.testing.assert_allclose(running.readings[-1].wrench, LOAD, atol=1e-5)
    adapter.unplug()
    running.until(lambda: running.reader.counts.bus_failures > 0)
    running.close()


class Sluggish(NetFtCan):
    """A sensor whose answers wait for a condition, or whose bus carries frames of others."""

    def __init__(self) -> None:
        super().__init__(lambda: LOAD)
        self.hold_back_until: Callable[[], bool] | None = None

    def answer(self, identifier, data):
        frames = super().answer(identifier, data)
        end = time.monotonic() + 10.0
        while frames and self.hold_back_until and not self.hold_back_until() and time.monotonic() < end:
            time.sleep(0.001)
        return frames


@pytest.fixture
def sluggish():
    import can

    channel = uuid.uuid4().hex
    sensor, going = Sluggish(), [True]
    buses = [can.Bus(interface="virtual", channel=channel) for _ in range(2)]
    thread = threading.Thread(target=serve, args=(sensor, buses[0], lambda: going[0]))
    thread.start()
    running = Running(ReaderSettings(Bus("virtual", channel), rate=20.0))
    yield sensor, running, buses[1]
    running.close()
    going[0] = False
    thread.join(5.0)
    for bus in buses:
        bus.shutdown()


def age(running: Running, last: int = 1) -> float:
    """Between the sensor's sample and the time that a reading is passed on with, s: the least of the last ones.

    The least, since a machine that holds up this process makes one reading old, and a reader that is a request behind all.
    """
    return min(stamp - reading.sample / 7000.0 for reading, stamp in running.stamped[-last:])


def test_a_late_answer_is_passed_on_with_the_time_of_its_request_and_the_next_ones_are_new_again(sluggish):
    sensor, running, _ = sluggish
    running.until(lambda: len(running.readings) > 3)
    counts = running.reader.counts
    unanswered, late = counts.unanswered, counts.late
    sensor.hold_back_until = lambda: counts.unanswered > unanswered  # the period of its request is over
    running.until(lambda: counts.late > late)
    sensor.hold_back_until = None
    assert age(running) < 0.05
    read = len(running.readings)
    running.until(lambda: len(running.readings) > read + 5)
    assert age(running, last=5) < 0.05, "not every reading is a period old"


class HeldUp:
    """A bus whose next frame is fetched some periods after it came, as by a process that did not get to run."""

    def __init__(self, bus, seconds: float) -> None:
        self._bus, self.seconds = bus, seconds

    def recv(self, timeout):
        frame = self._bus.recv(timeout)
        if frame is not None and self.seconds:
            time.sleep(self.seconds)
            self.seconds = 0.0
        return frame

    def __getattr__(self, name):
        return getattr(self._bus, name)


def test_a_reader_that_was_held_up_itself_passes_an_answer_on_with_the_time_of_its_request(sluggish):
    _, running, _ = sluggish
    running.until(lambda: len(running.readings) > 3)
    late = running.reader.counts.late
    running.reader._bus = HeldUp(running.reader._bus, 0.12)  # 2.4 periods
    running.until(lambda: running.reader.counts.late > late)
    running.until(lambda: len(running.stamped) == len(running.readings))
    ages = [stamp - reading.sample / 7000.0 for reading, stamp in running.stamped]
    assert max(ages) < 0.1, "none is told to be of when it was fetched"


def test_a_second_device_that_asks_makes_no_reading_old_and_is_counted(sluggish):
    import can

    sensor, running, other = sluggish
    running.until(lambda: len(running.readings) > 3)
    for _ in range(10):
        for what in (b"\x01", b"\x01", b"\x01"):
            other.send(can.Message(arbitration_id=0x40, data=what, is_extended_id=False))
        read = len(running.readings)
        running.until(lambda read=read: len(running.readings) > read)
    assert age(running, last=5) < 0.05
    counts = running.reader.counts
    assert counts.foreign_requests == 30 and counts.unrequested > 5
    other.send(can.Message(arbitration_id=0x40, data=b"\x04", is_extended_id=False))
    running.until(lambda: counts.foreign_bias == 1)


def test_error_remote_and_extended_frames_are_no_data(sluggish):
    import can

    sensor, running, other = sluggish
    running.until(lambda: len(running.readings) > 3)
    for kind in ({"is_error_frame": True}, {"is_remote_frame": True}, {"is_extended_id": True}):
        for part in range(1, 5):
            given = {"is_extended_id": False, **kind}
            data = {} if "is_remote_frame" in kind else {"data": b"\x7f" * 8}
            other.send(can.Message(arbitration_id=0x40 + part, **data, **given))
    read = len(running.readings)
    running.until(lambda: len(running.readings) > read + 3)
    assert running.reader.counts.ignored > 0
    assert max(np.abs(r.wrench).max() for r in running.readings) < 1000.0


class Wrong(NetFtCan):
    """A sensor whose frames are changed on their way by `change`, where there is one."""

    change: Callable[[list], list] | None = None

    def answer(self, identifier, data):
        frames = super().answer(identifier, data)
        return self.change(frames) if frames and self.change else frames


HALVES = {
    "another device asks in between": lambda f: [*f[:2], (0x40, b"\x01"), *f[2:]],
    "another device sets the zero in between": lambda f: [*f[:2], (0x40, b"\x04"), *f[2:]],
    "a frame is short": lambda f: [f[0], (0x42, f[1][1][:7]), *f[2:]],
    "the first frame of a second answer is short": lambda f: [f[0], (0x41, b""), *f[1:]],
    "a frame comes twice": lambda f: [*f[:2], f[1], *f[2:]],
    "a frame of somebody else has the place of one": lambda f: [f[0], (0x52, f[1][1]), *f[2:]],
    "frames are in another order": lambda f: [f[1], f[0], *f[2:]],
}


@pytest.fixture
def wrong():
    import can

    channel = uuid.uuid4().hex
    sensor, going = Wrong(lambda: LOAD), [True]
    buses = [can.Bus(interface="virtual", channel=channel) for _ in range(2)]
    thread = threading.Thread(target=serve, args=(sensor, buses[0], lambda: going[0]))
    thread.start()
    running = Running(ReaderSettings(Bus("virtual", channel), rate=100.0))
    running.until(lambda: len(running.readings) > 3)
    yield sensor, running, buses[1]
    going[0] = False
    running.close()
    thread.join(5.0)
    for bus in buses:
        bus.shutdown()


@pytest.mark.parametrize("how", HALVES)
def test_halves_of_an_answer_that_something_came_between_are_no_reading_and_are_counted(wrong, how):
    sensor, running, _ = wrong
    sensor.change = HALVES[how]
    counts = running.reader.counts
    unanswered = counts.unanswered
    running.until(lambda: counts.unanswered > unanswered + 2)
    read = len(running.readings)
    running.until(lambda: counts.unanswered > unanswered + 5)
    assert len(running.readings) == read
    assert counts.incomplete > 0
    sensor.change = None
    running.until(lambda: len(running.readings) > read + 3)


def test_a_counter_that_stands_while_the_values_change_is_not_passed_on(wrong):
    sensor, running, _ = wrong
    sensor.change = lambda f: [*f[:3], (f[3][0], f[3][1][:4] + struct.pack("<I", 7))]
    repeated = running.reader.counts.repeated
    running.until(lambda: running.reader.counts.repeated > repeated + 5)
    assert sum(r.sample == 7 for r in running.readings) == 1


class Flood:
    """A bus on which there is always one more frame."""

    def __init__(self, bus, frame) -> None:
        self._bus, self._frame = bus, frame

    def recv(self, timeout):
        return self._bus.recv(0.0) or self._frame

    def __getattr__(self, name):
        return getattr(self._bus, name)


@pytest.mark.parametrize("identifier", [0x41, 0x44])
def test_a_flood_of_frames_with_an_identifier_of_the_sensor_is_no_reading_and_the_reader_can_be_ended(wrong, identifier):
    import can

    _, running, _ = wrong
    frame = can.Message(arbitration_id=identifier, data=b"\x7f" * 8, is_extended_id=False)
    running.reader._bus = Flood(running.reader._bus, frame)
    running.until(lambda: running.reader.counts.flooded > 3)
    assert max(np.abs(r.wrench).max() for r in running.readings) < 1000.0
    running.going = False
    running.thread.join(5.0)
    assert not running.thread.is_alive()


def test_frames_of_two_answers_make_no_reading():
    sensor, assembler = NetFtCan(lambda: LOAD), Assembler(0x40, CALIBRATION)
    first, second = sensor.answer(0x40, b"\x01"), sensor.answer(0x40, b"\x01")
    assert [assembler.take(*f) for f in (first[0], first[1], first[3], *second[2:])] == [None] * 5
    assert assembler.incomplete


frames = st.tuples(st.integers(0x3F, 0x48), st.binary(max_size=8))


@given(st.lists(frames, max_size=40), st.booleans())
def test_whatever_frames_come_a_reading_is_made_of_one_whole_answer_in_order(sequence, short):
    assembler = Assembler(0x40, CALIBRATION, short)
    first, size = (0x45, 2) if short else (0x41, 4)
    ours: list[int] = []
    for identifier, data in sequence:
        try:
            reading = assembler.take(identifier, data)
        except ProtocolError:
            ours.append(-1)  # of the wrong length: the answer that it was part of is none
            continue
        if first <= identifier < first + size:
            ours.append(identifier)
        if reading is not None:
            assert ours[-size:] == list(range(first, first + size))
            assert np.all(np.isfinite(reading.wrench))
