# SPDX-License-Identifier: Apache-2.0
"""What comes over wires: packets of a robot controller (RSI) and frames of a force sensor (CAN), read by the real chains."""

from __future__ import annotations

import struct
from functools import cache
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
URDF = ROOT / "config" / "robots" / "kr120_r2700_extra_ha.urdf"
Q_DEG = (5.0, -86.0, 80.0, 11.0, 29.0, -17.0)
WRENCH = np.array([150.0, -80.0, -900.0, 5.0, 3.0, -1.0])
PERIOD, FIRST, WARM, PACKETS, AFTER = 0.004, 1_000_000, 160, 24, 8
NO_DELAY = b'<Delay D="0"/>'
BASE = 0x40  # of the sensor
STEP = 8e-5 + 2e-7  # m: limit of the offset's rate in one cycle, and the resolution on the wire


def packet(ipoc: int, delay: int = 0) -> bytes:
    """One cycle of a controller."""
    joints = " ".join(f'A{k}="{v:.6f}"' for k, v in enumerate(Q_DEG, 1))
    return (
        f'<Rob Type="KUKA"><RIst X="1.0" Y="2.0" Z="3.0" A="0.0" B="0.0" C="0.0"/><AIPos {joints}/>'
        f'<EIPos E1="0.0" E2="0.0" E3="0.0" E4="0.0" E5="0.0" E6="0.0"/><Delay D="{delay}"/><IPOC>{ipoc}</IPOC></Rob>'
    ).encode()


def rsi_packets() -> bytes:
    """The packets that are mutated: they follow WARM good ones."""
    return b"\n".join(packet(FIRST + 4 * (WARM + i)) for i in range(PACKETS))


def read_rsi(folder: Path) -> None:
    """A conversation with the given packets in its middle. Raises ProtocolError where one was refused.

    Raises AssertionError where two answers differ by more than one cycle allows, or an answer is no number.
    """
    from irec_correction.errors import ProtocolError
    from irec_correction.rsi.codec import decode_robot, stamp_of

    session, source, block = _conversation()
    refused: ProtocolError | None = None
    now, before = 1000.0, np.zeros(3)
    unanswered = 0
    try:
        source.start(now)
        good = [packet(FIRST + 4 * i) for i in range(WARM)]
        after = [packet(FIRST + 4 * (WARM + PACKETS + i)) for i in range(AFTER)]
        for data in [*good, *(folder / "rsi.xml").read_bytes().split(b"\n"), *after]:
            block.write(np.array([now, 0.0, 0.0, *WRENCH]))
            if session.wants_tick:
                session.tick(now)
            now += PERIOD
            data = data.replace(NO_DELAY, NO_DELAY.replace(b"0", str(unanswered).encode()))  # a controller counts
            stamp = stamp_of(data[:4096])
            if stamp is None:
                unanswered += 1
                continue
            reply = session.reply(*stamp, now)
            unanswered += reply is None
            if reply is not None:
                session.finish(now)
                sent = session.sequence.sent.translation
                step = float(np.linalg.norm(sent - before))
                if not step <= STEP:
                    raise AssertionError(f"two answers are {1e6 * step:.0f} um apart after {data[:120]!r}")
                before = sent.copy()
            try:
                source.take(decode_robot(data[:4096]), now)
            except ProtocolError as error:
                refused = error
    finally:
        block.close()
    if refused is not None:
        raise refused


@cache
def _robot_and_model() -> tuple[str, object]:
    from irec_calibration.effects import find_effect
    from irec_calibration.model import Envelope, Estimate, Model, Term
    from irec_calibration.robot import Robot

    text = URDF.read_text()
    robot = Robot(text, str(URDF))
    torsion = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(4e-7) for k in range(1, 7)})
    return text, Model((torsion,), "S", urdf_sha256=robot.sha256, envelope=Envelope((-7.0,) * 6, (7.0,) * 6, 2000.0, 500.0))


def _conversation():  # type: ignore[no-untyped-def]
    from irec_correction.conditioning import FilterSettings
    from irec_correction.correction import CorrectionSettings
    from irec_correction.rsi.session import RsiSession
    from irec_correction.rsi.sources import ChainSettings, ChainSource
    from irec_correction.shared import WRENCH_SIZE, SharedValues

    text, model = _robot_and_model()
    block = SharedValues.create(WRENCH_SIZE)
    source = ChainSource(ChainSettings(CorrectionSettings(), FilterSettings(), text, block.name))
    source.put_in_force(model, 1000.0)
    return RsiSession(source, "IREC", 4), source, block


def can_frames() -> bytes:
    """Records of identifier (2 bytes), length (1) and 8 bytes: answers of both kinds."""
    from irec_sim.devices.netft_can import NetFtCan

    sensor, out = NetFtCan(lambda: WRENCH, clock=lambda: 1000.0), b""
    for _ in range(6):
        for what in (b"\x01", b"\x02"):
            for identifier, data in sensor.answer(BASE, what):
                out += struct.pack("<HB", identifier, len(data)) + bytes(data).ljust(8, b"\0")
    return out


def read_can(folder: Path) -> None:
    """All frames into both assemblers. ProtocolError where one was refused, AssertionError where a reading is no number."""
    from irec_correction.can_ft.netft_can import Assembler, Calibration
    from irec_correction.errors import ProtocolError

    data, refused = (folder / "can.bin").read_bytes(), None
    assemblers = [Assembler(BASE, Calibration()), Assembler(BASE, Calibration(), short=True)]
    for i in range(0, len(data) - 10, 11):
        identifier, length = struct.unpack_from("<HB", data, i)
        for assembler in assemblers:
            try:
                reading = assembler.take(identifier, data[i + 3 : i + 3 + min(length, 8)])
            except ProtocolError as error:
                refused = error
                continue
            if reading is not None:
                if not np.all(np.isfinite(reading.wrench)) or not all(isinstance(e, str) for e in reading.errors):
                    raise AssertionError(f"a reading that is none: {reading}")
    if refused is not None:
        raise refused
