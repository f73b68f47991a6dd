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
from .traits import Family

PRIOR_WIDTH = 3.0  # multiples of the scale


class JointTorsion(Effect):
    id = "joint_torsion"
    label = "joint torsion"
    physics = (
        "Gears, bearings and drives twist about each actuated axis in proportion to the torque: sum_k J_k c_k tau_k, "
        "Eq. (11). Part of every model; without it the whole deflection is left over."
    )
    family = Family.SPRING
    everywhere = True
    elastic = True

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

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        columns = [f"joint_{k + 1}" for k in np.flatnonzero(scene.driven)]
        return Springs(tuple((c, c, float(v)) for c, v in zip(columns, theta, strict=True)))
