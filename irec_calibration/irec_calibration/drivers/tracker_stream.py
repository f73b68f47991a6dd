# SPDX-License-Identifier: Apache-2.0
"""Points of a laser tracker out of a stream of bytes: lines of text, or the packets of Leica's emScon interface."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from ..errors import IrecError

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
COLUMNS = ("x", "y", "z", "time", "station", "-")
LONGEST_LINE = 4096  # bytes; more without an end of line is no line
LARGEST_PACKET = 1_000_000  # bytes
# emScon, little endian, packed to 4 bytes; between header and result stands a status
HEADER = struct.Struct("<ii")  # bytes of the packet, kind
MULTI = struct.Struct("<iiiddd")  # number of points, mode, try mode, temperature, pressure, humidity
VALUE = struct.Struct("<iiiddd")  # status, s, us, three coordinates
MULTI_MEAS_RESULT = 3


class StreamError(IrecError):
    """Settings of a stream that can't be meant, or bytes that are not what they are said to be."""


@dataclass(frozen=True)
class Reading:
    """One point: m in the frame of the station; t: s of the tracker's own clock, None where it sends none; station: or empty."""

    p: tuple[float, float, float]
    t: float | None = None
    station: str = ""


@dataclass
class Lines:
    """Lines of numbers, separated by comma, semicolon or blanks. Lines that begin with # are left out.

    Attributes:
        columns: what stands where: x, y, z, time, station, - for what is not needed; more columns are ignored.
        unit, time_unit: of what is sent. bad: lines that were no reading; last_bad: the newest of them, with the reason.
    """

    columns: Sequence[str] = ("x", "y", "z")
    unit: str = "mm"
    time_unit: str = "s"
    bad: int = 0
    last_bad: str = ""
    _rest: bytes = field(default=b"", repr=False)

    def __post_init__(self) -> None:
        unknown = [c for c in self.columns if c not in COLUMNS]
        if unknown or any(list(self.columns).count(c) != 1 for c in "xyz"):
            others = ", ".join(COLUMNS[3:])
            raise StreamError(f"columns are {','.join(self.columns)}; x, y and z once each, and of {others} what is sent")
        if self.unit not in UNITS or self.time_unit not in TIMES:
            known = f"{', '.join(UNITS)}; and of {', '.join(TIMES)}"
            raise StreamError(f"unit '{self.unit}' and time_unit '{self.time_unit}' have to be of {known}")

    def feed(self, data: bytes) -> Iterator[Reading]:
        """What has become complete. A datagram ends with its last line: feed it with a newline."""
        *lines, self._rest = re.split(rb"\r\n|\n|\r", self._rest + data)
        if len(self._rest) > LONGEST_LINE:
            self._wrong(self._rest[:60].decode(errors="replace"), f"more than {LONGEST_LINE} bytes without an end of line")
            self._rest = b""
        for line in lines:
            reading = self._read(line.decode(errors="replace").strip())
            if reading is not None:
                yield reading

    def _read(self, line: str) -> Reading | None:
        if not line or line.startswith("#"):
            return None
        parts = [part for part in re.split(r"[,;\s]+", line) if part]
        if len(parts) < len(self.columns):
            self._wrong(line, f"{len(parts)} columns, {len(self.columns)} are needed ({','.join(self.columns)})")
            return None
        given = dict(zip(self.columns, parts, strict=False))
        try:
            p = tuple(UNITS[self.unit] * float(given[c]) for c in "xyz")
            t = TIMES[self.time_unit] * float(given["time"]) if "time" in given else None
        except ValueError as error:
            self._wrong(line, str(error))
            return None
        if not all(map(math.isfinite, p)) or (t is not None and not math.isfinite(t)):
            self._wrong(line, "no finite numbers")
            return None
        if not any(p):
            return None  # this is how loggers say that the beam is broken
        return Reading((p[0], p[1], p[2]), t, given.get("station", ""))

    def _wrong(self, line: str, why: str) -> None:
        self.bad += 1
        self.last_bad = f"'{line[:60]}': {why}"


@dataclass
class EmScon:
    """Packets of continuous measurements as Leica's emScon interface sends them over TCP (port 700); others are left out.

    The measurement is started by the tracker's own software; nothing is sent to the tracker. `unit` is what that software has
    set (ES_C_SetUnits); coordinates have to be Cartesian and right-handed.
    """

    unit: str = "mm"
    bad: int = 0
    last_bad: str = ""
    _rest: bytes = field(default=b"", repr=False)

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise StreamError(f"unit '{self.unit}' is one of {', '.join(UNITS)}")

    def feed(self, data: bytes) -> Iterator[Reading]:
        """What has become complete. StreamError where the bytes are no packets: connect again."""
        self._rest += data
        while len(self._rest) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._rest)
            if not HEADER.size <= size <= LARGEST_PACKET:
                self._rest = b""
                raise StreamError(f"a packet of {size} bytes: this is no emScon stream, or it began in the middle of a packet")
            if len(self._rest) < size:
                return
            packet, self._rest = self._rest[:size], self._rest[size:]
            if kind == MULTI_MEAS_RESULT:
                yield from self._points(packet)

    def _points(self, packet: bytes) -> Iterator[Reading]:
        at = HEADER.size + 4 + MULTI.size  # the status of the result stands before the number
        if len(packet) < at:
            self.bad += 1
            self.last_bad = f"a result of {len(packet)} bytes"
            return
        (status,) = struct.unpack_from("<i", packet, HEADER.size)
        (number,) = struct.unpack_from("<i", packet, HEADER.size + 4)
        if status or not 0 <= number <= (len(packet) - at) // VALUE.size:
            self.bad += 1
            self.last_bad = f"a result of status {status} with {number} points in {len(packet)} bytes"
            return
        for k in range(number):
            point_status, seconds, micro, x, y, z = VALUE.unpack_from(packet, at + k * VALUE.size)
            p = tuple(UNITS[self.unit] * v for v in (x, y, z))
            if point_status == 0 and all(map(math.isfinite, p)) and any(p):
                yield Reading((p[0], p[1], p[2]), seconds + 1e-6 * micro)
