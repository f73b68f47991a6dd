# SPDX-License-Identifier: Apache-2.0
"""Torsional compliance about each actuated axis: the 6-DOF model of the paper."""

from __future__ import annotations

import numpy as np

from ..robot.kinetostatics import deflection_per_compliance
from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Springs
from .scales import softest, typical_compliance
from .scene import Scene
from .traits import Ageing, Axes, Family

PRIOR_WIDTH = 3.0  # multiples of the scale
SOFTER = 0.10  # share of an axis' compliance that a check over the years must find
MUCH_SOFTER = 3.0  # multiples of SOFTER: a gear that has lost more in a year is looked at before it is calibrated away


class JointTorsion(Effect):
    id = "joint_torsion"
    label = "joint torsion"
    physics = (
        "Gears, bearings and drives twist about each actuated axis in proportion to the torque: sum_k J_k c_k tau_k, "
        "Eq. (11). Part of every model; without it the whole deflection is left over."
    )
    family = Family.SPRING
    everywhere = ("loaded", "absolute")
    elastic = True
    compliance_of = Axes.ACTUATED

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        limit = softest(scene, scale, scene.gravity.largest)
        return tuple(
            Parameter(
                f"c_{k + 1}",
                "m/N" if scene.kin.is_prismatic[k] else "rad/(N m)",
                scale[k],
                lower=0.0,
                plausible=(0.0, limit[k]),
                group=f"axis {k + 1}",
                width=PRIOR_WIDTH,
                axis=int(k),
            )
            for k in np.flatnonzero(scene.driven)
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        return deflection_per_compliance(scene.J, scene.load_torque())[:, :, scene.driven]

    def ageing(self, scene: Scene) -> tuple[Ageing, ...]:
        return tuple(
            Ageing(
                p.name, p.group + ": {:.0f} % softer", 100 * SOFTER, SOFTER, "softer", f"check the gear of {p.group}",
                relative=True, renewable=MUCH_SOFTER,
            )
            for p in self.parameters(scene)
        )  # fmt: skip

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        columns = [f"joint_{k + 1}" for k in np.flatnonzero(scene.driven)]
        return Springs(tuple((c, c, float(v)) for c, v in zip(columns, theta, strict=True)))
