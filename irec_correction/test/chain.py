# SPDX-License-Identifier: Apache-2.0
"""A correction on the AFP robot with its inputs at hand, for tests of the chain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from irec_calibration.effects import find_effect
from irec_calibration.model import Envelope, Estimate, Model, Term
from irec_calibration.robot import Robot
from irec_correction.conditioning import Conditioner
from irec_correction.correction import Correction, CorrectionSettings, Output
from irec_correction.watchdog import RailRange

URDF = Path(__file__).parents[2] / "config/robots/kr120_r2700_extra_ha.urdf"
ROBOT = Robot.from_urdf(URDF)
PERIOD = 0.004
Q = np.array([0.1, -1.5, 1.4, 0.2, 0.5, -0.3])
WRENCH = np.array([150.0, -80.0, -900.0, 5.0, 3.0, -1.0])
TORSION = (2.5e-7, 2.0e-7, 3.0e-7, 1.0e-6, 1.2e-6, 1.8e-6)


def model(scale: float = 1.0, envelope: bool = True) -> Model:
    torsion = Term(find_effect("joint_torsion"), {f"c_{k}": Estimate(scale * c) for k, c in enumerate(TORSION, 1)})
    bending = Term(find_effect("link_bending"), {f"c_{k}{v}": Estimate(scale * 1e-7) for k in range(1, 7) for v in "ab"})
    within = Envelope(tuple((Q - 0.5).tolist()), tuple((Q + 0.5).tolist()), 1200.0) if envelope else None
    return Model((torsion, bending), serial="S-1", urdf_sha256=ROBOT.sha256, envelope=within)


class Rig:
    """Feeds a correction at 250 Hz (joints at 125 Hz) and remembers what it sent."""

    def __init__(self, settings: CorrectionSettings | None = None, **changes: object) -> None:
        self.settings = replace(settings or CorrectionSettings(), **changes)  # type: ignore[arg-type]
        self.correction = Correction(self.settings, ROBOT, Conditioner([]), RailRange(-1.5, 1.5))
        self.correction.put_in_force(model(), 0.0)
        self.now, self.ticks = 100.0, 0
        self.rng = np.random.default_rng(1)
        self.q, self.wrench, self.rail = Q.copy(), WRENCH.copy(), 0.0
        self.sent: list[np.ndarray] = [np.zeros(6)]
        self.outputs: list[Output] = []

    def run(self, seconds: float, wrench: bool = True, joints: bool = True) -> Output:
        for _ in range(round(seconds / PERIOD)):
            self.now += PERIOD
            self.ticks += 1
            if joints and self.ticks % 2:
                self.correction.take_joints(self.now, self.now, self.q, self.rail)
            if wrench:
                noisy = self.wrench + self.rng.normal(0, (1, 1, 1, 0.1, 0.1, 0.1))
                self.correction.take_wrench(self.now, self.now, "tool0", noisy)
            self.tick()
        return self.outputs[-1]

    def tick(self) -> None:
        self.outputs.append(self.correction.tick(self.now))
        self.sent.append(self.correction.present)

    def active(self) -> Rig:
        self.run(0.1)
        self.correction.start(self.now)
        self.run(1.2)
        return self

    @property
    def largest_step(self) -> float:
        return float(np.linalg.norm(np.diff(np.array(self.sent)[:, :3], axis=0), axis=1).max())
