# SPDX-License-Identifier: Apache-2.0
"""RSI packets as the KRC writes and reads them (ETHERNET object, XML over UDP). Millimetres and degrees exist only in this file.

The controller sends `<Rob Type="KUKA">` once per cycle and wants `<Sen Type="...">` with the same IPOC back before the next one.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
from irec_calibration.typing import Array

from ..errors import ProtocolError

MM, DEG = 1e-3, math.pi / 180.0
_NUMBER = rb'"\s*([-+]?[0-9.]{1,24}(?:[eE][-+]?\d{1,2})?)\s*"'
_IPOC = re.compile(rb"<IPOC>\s*(\d{1,15})\s*</IPOC>")  # ms since the controller started, or since 1970
_DELAY = re.compile(rb'<Delay\s+D\s*=\s*"\s*(\d{1,9})\s*"')


def _attributes(tag: bytes, names: str) -> re.Pattern[bytes]:
    return re.compile(rb"<" + tag + rb"\s+" + rb"\s+".join(n.encode() + rb"\s*=\s*" + _NUMBER for n in names.split()) + rb"\s*/>")


_RIST = _attributes(b"RIst", "X Y Z A B C")
_AIPOS = _attributes(b"AIPos", "A1 A2 A3 A4 A5 A6")
_EIPOS = _attributes(b"EIPos", "E1 E2 E3 E4 E5 E6")


@dataclass(frozen=True)
class RobotPacket:
    """What the controller says each cycle.

    Attributes:
        ipoc: time stamp of the interpolation cycle, to be echoed, ms.
        q: measured joint angles A1..A6, (6,), rad.
        p_tcp: measured TCP in the controller's base, (3,), m; abc: its A, B, C (Z, Y', X''), (3,), rad.
        external: E1..E6 as given for linear axes, (6,), m; zeros where the configuration does not send them.
        late: packets that the controller counts as late; 0 where the configuration does not send them.
    """

    ipoc: int
    q: Array
    p_tcp: Array
    abc: Array
    external: Array
    late: int


def decode_robot(packet: bytes) -> RobotPacket:
    """Read one packet of the controller.

    Raises:
        ProtocolError: IPOC, RIst or AIPos is missing or not a number.
    """
    ipoc, rist, aipos = _IPOC.search(packet), _RIST.search(packet), _AIPOS.search(packet)
    if ipoc is None or rist is None or aipos is None:
        missing = [n for n, found in (("IPOC", ipoc), ("RIst", rist), ("AIPos", aipos)) if found is None]
        raise ProtocolError(
            f"RSI packet of {len(packet)} bytes without {', '.join(missing)}: {packet[:80]!r}; the SEND part of the "
            "controller's ethernet"
            " XML must have DEF_RIst and DEF_AIPos (irec rsi-config writes one)"
        )
    try:
        pose = [float(x) for x in rist.groups()]
        q = [float(x) * DEG for x in aipos.groups()]
        external = _EIPOS.search(packet)
        e = [float(x) * MM for x in external.groups()] if external else [0.0] * 6
    except ValueError as error:
        raise ProtocolError(f"RSI packet with a value that is no number: {error}") from error
    delay = _DELAY.search(packet)
    return RobotPacket(
        int(ipoc[1]), np.array(q), np.array(pose[:3]) * MM, np.array(pose[3:]) * DEG, np.array(e), int(delay[1]) if delay else 0
    )


def encode_reply(translation: Array, rotation: Array, ipoc: int, sentype: str = "IREC") -> bytes:
    """An answer with an absolute correction.

    Args:
        translation: (3,), m; rotation: rotation vector (3,), rad; both in the frame that POSCORR is set to.
        ipoc: of the packet that is answered.
    """
    return encode_correction(translation, rotation, sentype) + encode_ipoc(ipoc)


def encode_correction(translation: Array, rotation: Array, sentype: str) -> bytes:
    """An answer up to its IPOC, so that it can be ready before the packet comes."""
    x, y, z = (translation / MM).tolist()
    a, b, c = abc_of_rotation_vector(rotation)
    return (
        f'<Sen Type="{sentype}">'
        f'<RKorr X="{x:.4f}" Y="{y:.4f}" Z="{z:.4f}" A="{a / DEG:.4f}" B="{b / DEG:.4f}" C="{c / DEG:.4f}"/>'
    ).encode("ascii")


def encode_ipoc(ipoc: int) -> bytes:
    """The rest of an answer."""
    return b"<IPOC>%d</IPOC></Sen>" % ipoc


def stamp_of(packet: bytes) -> tuple[int, int | None] | None:
    """IPOC, ms, and Delay (None: not sent) of a packet, without reading the rest; None where it has no IPOC."""
    ipoc = _IPOC.search(packet)
    if ipoc is None:
        return None
    delay = _DELAY.search(packet)
    return int(ipoc[1]), int(delay[1]) if delay else None


def abc_of_rotation_vector(rotation: Array) -> tuple[float, float, float]:
    """KUKA A, B, C (turns about Z, Y', X'') of a rotation vector (3,), rad."""
    x, y, z = rotation.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return z, y, x
    s, w = math.sin(0.5 * angle) / angle, math.cos(0.5 * angle)
    x, y, z = s * x, s * y, s * z
    a = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    b = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    c = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return a, b, c
