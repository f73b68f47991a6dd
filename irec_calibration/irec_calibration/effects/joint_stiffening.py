# SPDX-License-Identifier: Apache-2.0
"""Gear stiffness that grows with torque."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter
from .scales import rated_torque, typical_compliance

FRACTIONS_OF_RATED = (0.05, 0.15, 0.4, 1.5)


class JointStiffening(Effect):
    id = "joint_stiffening"
    label = "joint stiffening"
    physics = (
        "A gear is soft at small torque and stiffens as more teeth carry: extra deflection J_k [g(tau_k + tau_g,k) - "
        "g(tau_g,k)] with g(x) = a_k (x - x_0 tanh(x / x_0)): cubic below x_0, a piecewise line above it; a < 0 stiffens. "
        "Missing, the residual is odd and nonlinear in the torque of one axis, shifted by its gravity preload."
    )
    needs = ("load",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        scale = typical_compliance(scene.robot)
        axes = tuple(
            Parameter(
                f"a_{k + 1}", "rad/(N m)", 0.5 * scale[k], plausible=(-50.0 * scale[k], 10.0 * scale[k]), group=f"axis {k + 1}"
            )
            for k in np.flatnonzero(scene.driven)
        )
        return (*axes, Parameter("x_0", "share of rated torque", 0.15, 0.01, 3.0, start=0.15, grid=FRACTIONS_OF_RATED))

    def displacement(self, scene: Scene, theta: Array) -> Array:
        return self._columns(scene, theta[-1]) @ theta[:-1]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        h = 1e-3
        columns = self._columns(scene, theta[-1])
        by_break = (self._columns(scene, theta[-1] + h) - self._columns(scene, theta[-1] - h)) @ theta[:-1] / (2 * h)
        return np.concatenate([columns, by_break[:, :, None]], axis=2)

    def _columns(self, scene: Scene, fraction: float) -> Array:
        x_0 = fraction * rated_torque(scene.robot)

        def g(x: Array) -> Array:
            return x - x_0 * np.tanh(x / x_0)

        total = g(scene.tau + scene.tau_gravity)
        bent = total - g(scene.tau_gravity) if scene.kind == "loaded" else total
        return (scene.J * bent[:, None, :])[:, :, scene.driven]
