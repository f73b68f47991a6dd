# SPDX-License-Identifier: Apache-2.0
"""Link lengths, axis offsets and joint zeros differ from the robot description."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter


class GeometryError(Effect):
    id = "geometry_error"
    label = "geometry error"
    physics = (
        "A joint's zero, the place of its axis or the axis' direction differ from the robot description: derivative of the forward kinematics "
        "by zero offset (zero_k), displacement (x_k, y_k, z_k) and tilt (tilt_ka, tilt_kb) in each joint's frame. In a loaded session it shows in "
        "proportion to the commanded displacement only."
    )

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        out = []
        for k in range(scene.n_joints):
            group = f"axis {k + 1}"
            unit = "m" if scene.kin.is_prismatic[k] else "rad"
            out.append(Parameter(f"zero_{k + 1}", unit, 1e-3, -0.5, 0.5, plausible=(-0.1, 0.1), group=group))
            out += [Parameter(f"{a}_{k + 1}", "m", 1e-3, -0.5, 0.5, plausible=(-0.05, 0.05), group=group) for a in "xyz"]
            out += [Parameter(f"tilt_{k + 1}{v}", "rad", 1e-3, -0.5, 0.5, plausible=(-0.05, 0.05), group=group) for v in "ab"]
        return tuple(out)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        n, k = scene.q.shape
        out = np.empty((n, 3, k, 6))
        out[..., 0] = scene.J
        out[..., 1:4] = np.swapaxes(scene.kin.R_joint, 1, 2) * scene.moves_with_arm[:, None, None, None]
        out[..., 4:6] = scene.V.reshape(n, 3, k, 2)
        return out.reshape(n, 3, 6 * k)
