# SPDX-License-Identifier: Apache-2.0
"""The process that asks the sensor at a fixed rate and writes what it says into shared memory."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import can

from ..errors import CorrectionError, ProtocolError, SettingsError
from .netft_can import Assembler, Calibration, Reading, Request, advance, request

SLCAN_WAIT = 0.05  # s; python-can waits 2 s by default
REOPEN = 0.5  # s between tries to open a bus that has gone
COUNTER_BITS = {False: 32, True: 16}
OWED = 2  # periods in which an answer that did not come may still come; nothing is asked meanwhile


@dataclass(frozen=True)
class Bus:
    """A CAN bus as python-can names it.

    Attributes:
        interface: socketcan, slcan, virtual, ... channel: can0, /dev/ttyUSB0, ... bitrate: bit/s.
    """

    interface: str = "socketcan"
    channel: str = "can0"
    bitrate: int = 1_000_000


@dataclass(frozen=True)
class ReaderSettings:
    """How the sensor is asked.

    Attributes:
        base: identifier. rate: requests per second. short: answers of 16 bits.
        sensor_rate: samples per second by which the sensor's own counter goes on.
    """

    bus: Bus = field(default_factory=Bus)
    base: int = 0x40
    rate: float = 250.0
    short: bool = False
    sensor_rate: float = 7000.0
    calibration: Calibration = field(default_factory=Calibration)

    def __post_init__(self) -> None:
        if not 1.0 <= self.rate <= 2000.0:
            raise SettingsError(f"rate of the force sensor is {self.rate} Hz; 1 to 2000 is possible")


@dataclass
class ReaderCounts:
    """What happened on the bus.

    Attributes:
        unanswered: requests without a whole answer within a period. gaps: periods that the sensor's counter says are missing.
        repeated: answers with the counter of the one before; not passed on. bad: frames of the wrong length.
        incomplete: answers that lost a frame, or that another one cut off.
        late: answers that were seen in a later period than their request; passed on with the time of the request.
        unrequested: whole answers that nobody here has asked for. foreign_requests, foreign_bias: requests of another device, and
            those of them that set the sensor's zero.
        ignored: error, remote, extended and FD frames.
        flooded: periods in which more frames came than can be read in one; nothing is passed on then.
    """

    readings: int = 0
    unanswered: int = 0
    gaps: int = 0
    repeated: int = 0
    bad: int = 0
    incomplete: int = 0
    bus_failures: int = 0
    late: int = 0
    unrequested: int = 0
    foreign_requests: int = 0
    foreign_bias: int = 0
    ignored: int = 0
    flooded: int = 0


def open_bus(bus: Bus, base: int) -> Any:
    """Open, listening to this sensor and to requests that others send it. Raises CorrectionError."""
    filters = [{"can_id": base + i, "can_mask": 0x7FF, "extended": False} for i in range(7)]
    try:
        extra: dict[str, Any] = {"sleep_after_open": SLCAN_WAIT} if bus.interface == "slcan" else {}
        return can.Bus(interface=bus.interface, channel=bus.channel, bitrate=bus.bitrate, can_filters=filters, **extra)
    except Exception as error:  # each interface of python-can has errors of its own
        raise CorrectionError(f"CAN: can't open {bus.interface}:{bus.channel} at {bus.bitrate} bit/s: {error}") from error


class SensorReader:
    """Asks, collects, passes on. A bus that goes away is opened again; nothing is passed on meanwhile."""

    def __init__(self, settings: ReaderSettings, deliver: Callable[[Reading, float], None]) -> None:
        """Open the bus. Args: deliver: called with each reading and its time (CLOCK_MONOTONIC, s). Raises CorrectionError."""
        self._settings, self._deliver = settings, deliver
        self._assembler = Assembler(settings.base, settings.calibration, settings.short)
        self.counts = ReaderCounts()
        self._bus: Any = open_bus(settings.bus, settings.base)
        self._sample: int | None = None
        self._tried = 0.0
        self._owed: tuple[float, int] | None = None  # time of a request without an answer, periods in which it may come

    def bias(self) -> None:
        """Take the present reading as zero, in the sensor. Only without contact. Raises CorrectionError without a bus."""
        if self._bus is None:
            raise CorrectionError("the CAN bus of the force sensor is not open")
        self._assembler.begin()  # half an answer with the old zero, half with the new one is no reading
        self._send(Request.BIAS)

    def run(self, is_running: Callable[[], bool]) -> None:
        """One request per period until `is_running` says no."""
        period = 1.0 / self._settings.rate
        due = time.monotonic()
        while is_running():
            due = max(due + period, time.monotonic() - 5 * period)  # after a pause: go on from now, do not catch up
            if self._bus is None and not self._reopen():
                time.sleep(period)
                continue
            try:
                self._ask(due)
            except (can.CanError, OSError, ValueError):
                self._lose_bus()
            left = due - time.monotonic()
            if left > 0.0:
                time.sleep(left)

    def _send(self, what: Request) -> None:
        identifier, data = request(self._settings.base, what)
        self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def _ask(self, until: float) -> None:
        """One period: a request and its answer, or the rest of the one before."""
        if self._owed is None:
            if not self._discard_waiting(until):
                self.counts.flooded += 1
                return
            self._assembler.begin()
            asked = time.monotonic()
            self._send(Request.SHORT if self._settings.short else Request.LONG)
            periods_left = OWED
        else:
            asked, periods_left = self._owed
        reading = self._listen(until)
        if reading is not None:
            now = time.monotonic()
            late = self._owed is not None or now > until  # a reader that was held up does not know when the answer came
            self.counts.late += late
            self._owed = None
            self._pass_on(reading, asked if late else now)
            return
        if self._owed is None:
            self.counts.unanswered += 1
        self._owed = (asked, periods_left - 1) if periods_left > 0 else None

    def _listen(self, until: float) -> Reading | None:
        """Frames up to a time (CLOCK_MONOTONIC, s) or a whole answer; what waits then, for a period at most."""
        end = until + 1.0 / self._settings.rate
        while time.monotonic() < end:
            frame = self._bus.recv(max(0.0, until - time.monotonic()))
            if frame is None:
                return None
            reading = self._take(frame)
            if reading is not None:
                return reading
        return None

    def _discard_waiting(self, until: float) -> bool:
        """Before a request: what waits is no answer to it, however many another device has made the sensor send.

        False: there was more than could be read up to a time, s; without an end to it nobody could end this process.
        """
        end = max(until, time.monotonic() + 1.0 / self._settings.rate)
        while (frame := self._bus.recv(0.0)) is not None:
            self.counts.unrequested += self._take(frame) is not None
            if time.monotonic() > end:
                return False
        return True

    def _take(self, frame: Any) -> Reading | None:
        if frame.is_error_frame or frame.is_remote_frame or frame.is_extended_id or frame.is_fd:
            self.counts.ignored += 1
            return None
        if frame.arbitration_id == self._settings.base:
            self.counts.foreign_requests += 1
            self.counts.foreign_bias += bytes(frame.data[:1]) == bytes([Request.BIAS])
            self._assembler.begin()  # the sensor begins anew, and what comes now may be of another sample or another zero
            return None
        try:
            return self._assembler.take(frame.arbitration_id, frame.data)
        except ProtocolError:
            self.counts.bad += 1
            return None
        finally:
            self.counts.incomplete = self._assembler.incomplete

    def _pass_on(self, reading: Reading, now: float) -> None:
        before, self._sample = self._sample, reading.sample
        if before is not None:
            steps = advance(before, reading.sample, COUNTER_BITS[self._settings.short])
            if steps == 0:
                self.counts.repeated += 1
                return
            self.counts.gaps += max(0, round(steps * self._settings.rate / self._settings.sensor_rate) - 1)
        self.counts.readings += 1
        self._deliver(reading, now)

    def _lose_bus(self) -> None:
        self.counts.bus_failures += 1
        with contextlib.suppress(Exception):
            self._bus.shutdown()
        self._bus, self._tried, self._owed = None, time.monotonic(), None

    def _reopen(self) -> bool:
        if time.monotonic() - self._tried < REOPEN:
            return False
        self._tried = time.monotonic()
        with contextlib.suppress(CorrectionError):
            self._bus = open_bus(self._settings.bus, self._settings.base)
        return self._bus is not None

    def close(self) -> None:
        """Let go of the bus."""
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None
