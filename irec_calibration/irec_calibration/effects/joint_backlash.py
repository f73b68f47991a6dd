# SPDX-License-Identifier: Apache-2.0
"""Lost motion: gear play that is crossed when the total torque of an axis changes sign."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter
from .scales import rated_torque

UNDEFINED_SHARE_OF_RATED = 1e-3  # below this share of the rated torque the side on which the gear lies is not defined


class JointBacklash(Effect):
    id = "joint_backlash"
    label = "joint backlash"
    physics = (
        "Gear play: the joint moves by a fixed angle b_k when its total torque (process and gravity) changes sign: J_k b_k "
        "sign/2. Missing, the residual jumps by the same angle whatever the load. An axis whose total torque never changes "
        "sign shows nothing."
    )

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"b_{k + 1}", "rad", 1e-4, lower=0.0, plausible=(0.0, 3e-3), group=f"axis {k + 1}")
            for k in np.flatnonzero(scene.driven)
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        soft = UNDEFINED_SHARE_OF_RATED * rated_torque(scene.robot)
        side = 0.5 * np.tanh((scene.tau + scene.tau_gravity) / soft)
        return (scene.J * side[:, None, :])[:, :, scene.driven]
