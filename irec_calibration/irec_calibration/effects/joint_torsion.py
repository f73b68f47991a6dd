# SPDX-License-Identifier: Apache-2.0
"""Torsional compliance about each actuated axis: the 6-DOF model of the paper."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter
from .scales import typical_compliance


class JointTorsion(Effect):
    id = "joint_torsion"
    label = "joint torsion"
    physics = (
        "Gears, bearings and drives twist about each actuated axis in proportion to the torque: sum_k J_k c_k tau_k, "
        "Eq. (11). Part of every model; without it the whole deflection is left over."
    )
    elastic = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        return tuple(
            Parameter(
                f"c_{k + 1}",
                "m/N" if scene.kin.is_prismatic[k] else "rad/(N m)",
                scale[k],
                lower=0.0,
                plausible=(0.0, 100.0 * scale[k]),
                group=f"axis {k + 1}",
            )
            for k in np.flatnonzero(scene.driven)
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        return (scene.J * scene.load_torque()[:, None, :])[:, :, scene.driven]
