# SPDX-License-Identifier: Apache-2.0
"""Hours of the correction as fast as the machine can: memory, handles and threads over time, and the largest step of the offset.

`python tools/endurance/correction.py [--hours 8] [--seconds S] [--json FILE]`; ends after so many hours of the chain or
seconds of this machine, whichever comes first, and prints what was really run; exit code 1 where something grows or a step is
too long.
The chain is the one of `rsi_bridge` without its socket: packets of a controller in, answers out, an answer of the CAN sensor
decoded for each, wrenches through shared memory; now and then a packet or a wrench is missing, an input holds NaN, another model
is put in force, RSI is started again.
"""

from __future__ import annotations

import argparse
import gc
import json
import sys
import time
from pathlib import Path

import numpy as np
from irec_calibration.effects import find_effect
from irec_calibration.model import Envelope, Estimate, Model, Term
from irec_calibration.robot import Robot
from irec_correction.can_ft.netft_can import Assembler, Calibration
from irec_correction.conditioning import FilterSettings
from irec_correction.correction import CorrectionSettings
from irec_correction.rsi.codec import decode_robot, stamp_of
from irec_correction.rsi.session import RsiSession
from irec_correction.rsi.sources import ChainSettings, ChainSource
from irec_correction.shared import WRENCH_SIZE, SharedValues
from irec_correction.state import State
from irec_sim.devices.netft_can import NetFtCan
from slopes import grows, sample, slopes

URDF = Path(__file__).parents[2] / "config/robots/kr120_r2700_extra_ha.urdf"
Q_DEG = (5.0, -86.0, 80.0, 11.0, 29.0, -17.0)
WRENCH = np.array([150.0, -80.0, -900.0, 5.0, 3.0, -1.0])
PERIOD, RATE = 0.004, 250
SWAP, SESSION, FAULT = 60 * RATE, 900 * RATE, 37 * RATE  # cycles between two of each
SAMPLES = 120
OFTEN = 2000  # cycles between two samples where the machine's time is bounded
GROWTH = {"memory_kB": 256.0, "handles": 0.05, "threads": 0.05}  # per hour that counts as none; memory comes in pages
RESOLUTION = 2e-7  # m on the wire


def model(scale: float, robot: Robot) -> Model:
    torsion = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(scale * 4e-7) for k in range(1, 7)})
    bending = Term(find_effect("link_bending"), {f"c_{k}{v}": Estimate(scale * 1e-7) for k in range(1, 7) for v in "ab"})
    envelope = Envelope((-7.0,) * 6, (7.0,) * 6, 2000.0, 500.0)
    return Model((torsion, bending), "KR120-0001", urdf_sha256=robot.sha256, envelope=envelope)


class Chain:
    """One controller, one sensor, one chain, in a time of their own."""

    def __init__(self) -> None:
        text = URDF.read_text()
        self.robot = Robot(text, str(URDF))
        self.block = SharedValues.create(WRENCH_SIZE)
        self.settings = CorrectionSettings()
        self.source = ChainSource(ChainSettings(self.settings, FilterSettings(), text, self.block.name))
        self.session = RsiSession(self.source, "IREC", 4)
        self.now, self.ipoc, self.delay, self.cycles = 1000.0, 1_000_000, 0, 0
        self.rng = np.random.default_rng(0)
        self.load = WRENCH.copy()
        self.sensor = NetFtCan(lambda: self.load, clock=lambda: self.now)
        self.assembler = Assembler(0x40, Calibration())
        self.held, self.largest = np.zeros(3), 0.0
        self.source.put_in_force(model(1.0, self.robot), self.now)
        self.source.start(self.now)

    def cycle(self) -> None:
        """One interpolation cycle."""
        self.cycles += 1
        i = self.cycles
        if i % SWAP == 0:
            self.source.put_in_force(model(1.0 + 0.5 * (i // SWAP % 2), self.robot), self.now)
        if i % SESSION == 0:
            self.ipoc += 4 * 400
            self.now += 400 * PERIOD
            self.delay, self.held = 0, np.zeros(3)
        self._read_sensor(missing=i % FAULT < 10, nan=i % (3 * FAULT) == FAULT // 2)
        if self.session.wants_tick:
            self.session.tick(self.now)
        self.now += PERIOD
        self.ipoc = (self.ipoc + 4) % (1 << 32)
        if i % (FAULT // 2) == 0:  # a packet gets lost
            self.delay += 1
            return
        self._answer()
        if self.source.state is State.FAULT:
            self.source.start(self.now)

    def _read_sensor(self, missing: bool, nan: bool) -> None:
        self.load = WRENCH + self.rng.normal(0.0, 0.5, 6)
        reading = None
        for identifier, data in self.sensor.answer(0x40, b"\x01"):
            reading = self.assembler.take(identifier, data)
        if missing or reading is None:
            return
        wrench = np.full(6, np.nan) if nan else reading.wrench
        self.block.write(np.array([self.now, self.cycles, 0.0, *wrench]))

    def _answer(self) -> None:
        joints = " ".join(f'A{k}="{v + 0.01 * np.sin(1e-3 * self.cycles):.6f}"' for k, v in enumerate(Q_DEG, 1))
        packet = (
            f'<Rob Type="KUKA"><RIst X="1.0" Y="2.0" Z="3.0" A="0.0" B="0.0" C="0.0"/><AIPos {joints}/>'
            f'<Delay D="{self.delay}"/><IPOC>{self.ipoc}</IPOC></Rob>'
        ).encode()
        stamp = stamp_of(packet)
        if stamp is None:
            raise RuntimeError(f"the codec does not read this packet: {packet!r}")
        reply = self.session.reply(*stamp, self.now)
        self.session.finish(self.now)
        self.source.take(decode_robot(packet), self.now)
        if reply is None:
            self.delay += 1
            return
        self.delay = 0
        sent = self.session.sequence.sent.translation
        self.largest = max(self.largest, float(np.linalg.norm(sent - self.held)))
        self.held = sent.copy()


def run(hours: float, seconds: float = 0.0) -> dict:
    """Figures of so many hours of the chain's time, or of what the machine did of it in so many seconds (0: no limit)."""
    chain, samples = Chain(), []
    cycles = max(SAMPLES, round(hours * 3600 * RATE))
    every = min(cycles // SAMPLES, OFTEN) if seconds else cycles // SAMPLES
    began = told = time.monotonic()
    for i in range(1, cycles + 1):
        chain.cycle()
        if i % every == 0:
            gc.collect()
            samples.append(sample(i * PERIOD / 3600))
            if time.monotonic() - told > 10.0:
                told = time.monotonic()
                left = (told - began) * (cycles - i) / i
                print(f"{samples[-1].hours:.2f} h of {hours:g} h, {left:.0f} s left", file=sys.stderr)
            if seconds and time.monotonic() - began > seconds:
                break
    wall = time.monotonic() - began
    growth = slopes(samples)
    step = chain.settings.limits.translation.rate * PERIOD
    counts, sequence = chain.source.chain.counts, chain.session.sequence
    chain.block.close()
    return {
        "hours": round(i * PERIOD / 3600, 3), "wall_s": round(wall, 1), "cycles": i, "us_per_cycle": round(1e6 * wall / i, 1),
        "memory_MB": [round(samples[0].memory_kB / 1024, 1), round(samples[-1].memory_kB / 1024, 1)],
        **{k: str(v) for k, v in growth.items()},
        "largest_step_um": round(1e6 * chain.largest, 2), "limit_um": round(1e6 * step, 2),
        "ticks": counts.ticks, "held": counts.held, "sessions": sequence.sessions, "lost": sequence.lost,
        "passed": bool(not grows(growth, GROWTH) and chain.largest <= step + RESOLUTION),
    }  # fmt: skip


def main() -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=8.0, help="of the chain's time (default 8)")
    parser.add_argument("--json", type=Path, help="write the figures there too")
    parser.add_argument("--seconds", type=float, default=0.0, help="of this machine; 0: no limit")
    options = parser.parse_args()
    figures = run(options.hours, options.seconds)
    for name, value in figures.items():
        print(f"{name:>18}: {value}")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1))
    return 0 if figures["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
