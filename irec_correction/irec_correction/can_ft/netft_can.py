# SPDX-License-Identifier: Apache-2.0
"""ATI Net F/T over CAN: requests and answers, counts to N and N m. Frames are (identifier, bytes); no bus in this file.

A request goes to the base identifier with one data byte. The long answer comes in four frames of two little-endian int32 each:
base+1 Fx Tx, base+2 Fy Ty, base+3 Fz Tz, base+4 status and sample counter; the short one in two frames of four int16: base+5
Fx Tx Fy Ty, base+6 Fz Tz status sample. A new request ends an answer that is still being sent.

What this rests on: README.md, "Force sensor over CAN". (NETCANOEM, which public drivers speak, is another protocol of the same
maker: strain gauges, big-endian, identifiers shifted by 4 bits.)
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from irec_calibration.typing import Array

from ..errors import ProtocolError, SettingsError


class Request(IntEnum):
    """First data byte on the base identifier."""

    LONG = 0x01
    SHORT = 0x02
    BIAS = 0x04


# bit of the status code -> what it means. 0 .. 15 after NETCANOEM (ATI 9610-05-1030), 16 .. 31 after the Ethernet Axia (ATI
# 9610-05-Ethernet Axia); the table of the Net F/T itself was not at hand, so messages give the number too
STATUS_BITS = {
    0: "watchdog", 1: "excitation voltage too high", 2: "excitation voltage too low", 3: "artificial analog ground",
    4: "supply voltage too high", 5: "supply voltage too low", 6: "active calibration", 7: "EEPROM", 8: "invalid configuration",
    11: "temperature too high", 12: "temperature too low", 14: "CAN bus", 15: "any error", 16: "monitor condition latched",
    27: "gauge out of range", 29: "checksum of the calibration", 30: "force or torque out of range", 31: "any error",
}  # fmt: skip
NOT_AN_ERROR = 1 << 16
LONG_FRAMES, SHORT_FRAMES = 4, 2


@dataclass(frozen=True)
class Reading:
    """One answer.

    Attributes:
        wrench: force and torque in the sensor frame, (6,), N and N m.
        status: bits as the sensor sends them; sample: its counter. short: both have 16 bits.
    """

    wrench: Array
    status: int
    sample: int
    short: bool = False

    @property
    def errors(self) -> list[str]:
        """What the sensor complains of."""
        return errors_of(self.status, self.short)


def errors_of(status: int, short: bool) -> list[str]:
    """What a status complains of. A bit without a name is an error too: the manual says that the status is normally zero.

    Args:
        short: 16 bits, of which the manual does not say which half of the code they are: any one is an error, none has a name.
    """
    if short:
        return [f"status {status:#06x}"] if status else []
    bits = [bit for bit in range(32) if status >> bit & 1 and not NOT_AN_ERROR >> bit & 1]
    return [f"bit {bit} ({STATUS_BITS.get(bit, 'unknown')})" for bit in bits]


@dataclass(frozen=True)
class Calibration:
    """What turns counts into units; from the sensor's calibration sheet or its web page (netftapi2.xml: cfgcpf, cfgcpt).

    Attributes:
        counts_per_force: 1/N (or of the unit that the sensor is set to, see to_newton). counts_per_torque: 1/(N m).
        to_newton, to_newton_metre: 1 for N and N m; 4.4482216 for lbf; 0.11298483 for lbf in.
        short_scale: counts of the short answer are long ones divided by these, (6,): force then torque.
    """

    counts_per_force: float = 1e6
    counts_per_torque: float = 1e6
    to_newton: float = 1.0
    to_newton_metre: float = 1.0
    short_scale: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        if not (self.counts_per_force > 0.0 and self.counts_per_torque > 0.0):
            raise SettingsError("counts per unit of the force sensor must be above 0; read them off its calibration page")

    @property
    def units_per_count(self) -> Array:
        """(6,), N and N m per count of the long answer."""
        f, t = self.to_newton / self.counts_per_force, self.to_newton_metre / self.counts_per_torque
        return np.array([f, f, f, t, t, t])


def request(base: int, what: Request) -> tuple[int, bytes]:
    """Identifier and data of a request."""
    return base, bytes([what])


@dataclass
class Assembler:
    """Puts the frames of an answer together.

    Attributes:
        short: answers of the short kind. incomplete: answers that a newer one cut off, or that lost a frame. foreign: frames
            of somebody else.
    """

    base: int
    calibration: Calibration
    short: bool = False
    incomplete: int = 0
    foreign: int = 0
    _parts: dict[int, bytes] = field(default_factory=dict)
    _broken: bool = False  # the answer that is coming in is counted as incomplete already

    def __post_init__(self) -> None:
        if not 0 <= self.base <= 0x7FF - 6:
            raise SettingsError(f"CAN base identifier {self.base:#x}; 0 to 0x7f9 is possible with 11 bits")

    def begin(self) -> None:
        """A request has been sent, by whomever: it ends a running answer, and what is incomplete will stay so."""
        if self._parts:
            self.incomplete += 1
            self._parts.clear()
        self._broken = False

    def take(self, identifier: int, data: bytes) -> Reading | None:
        """One frame; a reading when it was the last one of an answer.

        Raises:
            ProtocolError: a frame of the sensor that does not have 8 bytes.
        """
        first, frames = (5, SHORT_FRAMES) if self.short else (1, LONG_FRAMES)
        part = identifier - self.base - first
        if not 0 <= part < frames:
            self.foreign += 1
            return None
        if len(data) != 8:
            self.begin()  # it may have been the first one of another answer
            raise ProtocolError(f"CAN frame {identifier:#x} of the force sensor has {len(data)} bytes, 8 are needed")
        if part == 0:
            self.begin()
        elif part != len(self._parts):  # the frames of an answer come in order: one was lost, or two answers are mixed
            self.incomplete += not self._broken
            self._broken = True
            self._parts.clear()
            return None
        self._parts[part] = bytes(data)
        if len(self._parts) < frames:
            return None
        parts = [self._parts[i] for i in range(frames)]
        self._parts.clear()
        return self._short(parts) if self.short else self._long(parts)

    def _long(self, parts: list[bytes]) -> Reading:
        pairs = [struct.unpack("<ii", p) for p in parts[:3]]
        status, sample = struct.unpack("<II", parts[3])
        counts = np.array([f for f, _ in pairs] + [t for _, t in pairs], dtype=float)
        return Reading(counts * self.calibration.units_per_count, status, sample)

    def _short(self, parts: list[bytes]) -> Reading:
        fx, tx, fy, ty = struct.unpack("<hhhh", parts[0])
        fz, tz, status, sample = struct.unpack("<hhHH", parts[1])
        counts = np.array([fx, fy, fz, tx, ty, tz], dtype=float) * self.calibration.short_scale
        return Reading(counts * self.calibration.units_per_count, status, sample, short=True)


def advance(before: int, now: int, bits: int) -> int:
    """Samples that the sensor took between two readings, from counters of `bits` bits."""
    return (now - before) % (1 << bits)
