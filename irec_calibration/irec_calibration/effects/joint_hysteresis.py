# SPDX-License-Identifier: Apache-2.0
"""Friction in the gear: deflection that depends on the order of the load cases."""

from __future__ import annotations

import numpy as np

from ..scene import Scene
from ..typing import Array
from .base import Effect, Parameter
from .scales import rated_torque, typical_compliance

FRACTIONS_OF_RATED = (0.01, 0.03, 0.08, 0.2)


class JointHysteresis(Effect):
    id = "joint_hysteresis"
    label = "joint hysteresis"
    physics = (
        "Dry friction inside the gear holds back a part of the wind-up, up to a threshold of torque, until the torque "
        "turns: -J_k h_k stop(tau_k) (Prandtl-Ishlinskii, history within a pose from the relaxed reference on). Missing, "
        "the same load reached from different sides disagrees; repeats reveal it. In absolute sessions the sign of the "
        "last step decides."
    )
    needs = ("order",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if scene.kind == "absolute":
            return tuple(
                Parameter(f"h_{k + 1}", "rad", 1e-4, plausible=(-3e-3, 3e-3), group=f"axis {k + 1}")
                for k in np.flatnonzero(scene.driven)
            )
        scale = typical_compliance(scene.robot)
        axes = tuple(
            Parameter(
                f"h_{k + 1}", "rad/(N m)", 0.3 * scale[k], plausible=(-20.0 * scale[k], 20.0 * scale[k]), group=f"axis {k + 1}"
            )
            for k in np.flatnonzero(scene.driven)
        )
        return (*axes, Parameter("r", "share of rated torque", 0.03, 0.001, 1.0, start=0.03, grid=FRACTIONS_OF_RATED))

    def displacement(self, scene: Scene, theta: Array) -> Array:
        if scene.kind == "absolute":
            return self._by_last_step(scene) @ theta
        return self._columns(scene, theta[-1]) @ theta[:-1]

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.kind == "absolute":
            return self._by_last_step(scene)
        h = 1e-4
        columns = self._columns(scene, theta[-1])
        by_threshold = (self._columns(scene, theta[-1] + h) - self._columns(scene, theta[-1] - h)) @ theta[:-1] / (2 * h)
        return np.concatenate([columns, by_threshold[:, :, None]], axis=2)

    def _by_last_step(self, scene: Scene) -> Array:
        resolved = np.where(np.abs(scene.step) > 1e-4, np.sign(scene.step), 0.0)
        return (0.5 * scene.J * resolved[:, None, :])[:, :, scene.driven]

    def _columns(self, scene: Scene, fraction: float) -> Array:
        """Displacement per unit of h_k: minus the part of the torque that friction holds (the stop operator)."""
        r = fraction * rated_torque(scene.robot)
        played = np.zeros_like(scene.tau)
        for i in np.lexsort((scene.load_case, scene.stamp)):
            before = scene.previous[i]
            # relaxed at the reference: the operator starts in the middle of its band, at zero process torque
            last = played[before] if before >= 0 else np.zeros(scene.n_joints)
            played[i] = np.clip(last, scene.tau[i] - r, scene.tau[i] + r)
        return (scene.J * (played - scene.tau)[:, None, :])[:, :, scene.driven]
