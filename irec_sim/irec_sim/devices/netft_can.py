# SPDX-License-Identifier: Apache-2.0
"""An ATI Net F/T on CAN, as far as the protocol goes: answers requests on its base identifier, with faults on demand.

Long answer (request 0x01): base+1 Fx Tx, base+2 Fy Ty, base+3 Fz Tz, base+4 status and counter, little-endian 32 bit. Short
answer (0x02): base+5 Fx Tx Fy Ty, base+6 Fz Tz status counter, 16 bit. 0x04 takes the present load as zero.
"""

from __future__ import annotations

import os
import struct
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SAMPLE_RATE = 7000.0  # Hz, of the sensor's own counter


@dataclass
class Faults:
    """What goes wrong.

    Attributes:
        silent: answers nothing. frozen: repeats one sample for ever. lose_frames: this many frames vanish. status: bits that
            it sends.
    """

    silent: bool = False
    frozen: bool = False
    lose_frames: int = 0
    status: int = 0


class NetFtCan:
    """The sensor. `answer` is pure protocol; `serve` runs it on a python-can bus, `SlcanAdapter` on a serial line."""

    def __init__(
        self,
        load: Callable[[], Array],
        base: int = 0x40,
        counts_per_force: float = 1e6,
        counts_per_torque: float = 1e6,
        short_divisor: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Args: load: the wrench that acts now, (6,), N and N m. short_divisor: the short answer's counts are smaller by this."""
        self._load, self.base, self._clock = load, base, clock
        self._counts = np.array([counts_per_force] * 3 + [counts_per_torque] * 3)
        self._divisor = short_divisor
        self._zero = np.zeros(6)
        self._last: tuple[Array, int] | None = None
        self.faults = Faults()

    def answer(self, identifier: int, data: bytes) -> list[tuple[int, bytes]]:
        """Frames that a request is answered with."""
        if identifier != self.base or len(data) < 1 or self.faults.silent:
            return []
        if data[0] == 0x04:
            self._zero = self._load().copy()
            return []
        wrench, sample = self._sample()
        frames = self._frames(data[0], wrench, sample)
        lost = min(self.faults.lose_frames, len(frames))
        self.faults.lose_frames -= lost
        return frames[lost:]

    def _sample(self) -> tuple[Array, int]:
        if not (self.faults.frozen and self._last is not None):
            self._last = self._load() - self._zero, int(self._clock() * SAMPLE_RATE)
        return self._last

    def _frames(self, kind: int, wrench: Array, sample: int) -> list[tuple[int, bytes]]:
        counts = wrench * self._counts
        if kind == 0x01:
            fx, fy, fz, tx, ty, tz = (int(v) for v in np.clip(np.rint(counts), -(2**31), 2**31 - 1))
            pairs = [struct.pack("<ii", f, t) for f, t in ((fx, tx), (fy, ty), (fz, tz))]
            pairs.append(struct.pack("<II", self.faults.status, sample & 0xFFFFFFFF))
            return [(self.base + 1 + i, pair) for i, pair in enumerate(pairs)]
        if kind == 0x02:
            fx, fy, fz, tx, ty, tz = (int(v) for v in np.clip(np.rint(counts / self._divisor), -(2**15), 2**15 - 1))
            return [
                (self.base + 5, struct.pack("<hhhh", fx, tx, fy, ty)),
                (self.base + 6, struct.pack("<hhHH", fz, tz, self.faults.status & 0xFFFF, sample & 0xFFFF)),
            ]
        return []


def serve(sensor: NetFtCan, bus: Any, goes_on: Callable[[], bool]) -> None:
    """Answer on a python-can bus (for example `virtual`, within one process) until `goes_on` says no."""
    import can

    while goes_on():
        frame = bus.recv(0.05)
        if frame is None:
            continue
        for identifier, data in sensor.answer(frame.arbitration_id, bytes(frame.data)):
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))


class SlcanAdapter:
    """A serial CAN adapter (Lawicel protocol) on a pseudo-terminal with the sensor behind it; nothing leaves the machine."""

    def __init__(self, sensor: NetFtCan) -> None:
        self.sensor = sensor
        self._ours, theirs = os.openpty()
        tty.setraw(self._ours)
        tty.setraw(theirs)
        self._theirs = theirs
        self.channel = os.ttyname(theirs)
        self._open, self._running = False, True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        pending = b""
        while self._running:
            try:
                pending += os.read(self._ours, 4096)
                *commands, pending = pending.split(b"\r")
                for command in commands:
                    self._obey(command)
            except OSError:  # unplugged
                return

    def _obey(self, command: bytes) -> None:
        kind = command[:1]
        if kind == b"O":
            self._open = True
        elif kind == b"C":
            self._open = False
        elif kind == b"t" and self._open and len(command) >= 5:
            identifier, length = int(command[1:4], 16), int(command[4:5])
            data = bytes.fromhex(command[5 : 5 + 2 * length].decode("ascii"))
            frames = self.sensor.answer(identifier, data)
            os.write(self._ours, b"z\r" + b"".join(b"t%03x%d%s\r" % (i, len(d), d.hex().encode()) for i, d in frames))
            return
        os.write(self._ours, b"\r")

    def unplug(self) -> None:
        """The adapter goes away, as when its cable is pulled."""
        if self._running:
            self._running = False
            os.close(self._theirs)
            os.close(self._ours)
