# SPDX-License-Identifier: Apache-2.0
"""Spring or gas balancer on axis 2: its effective compliance varies with the angle."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import ColumnLaw, LeftOut, LiveForm, Tick
from .scales import typical_compliance
from .scene import Scene
from .traits import Family

AXIS = 1  # index of joint_2


class Counterbalance(Effect):
    id = "counterbalance"
    label = "counterbalance"
    physics = (
        "A spring or gas balancer acts in parallel with axis 2; the share of the load that it carries varies with its angle: "
        "J_2 (a sin q_2 + b cos q_2) tau_2. Missing, the compliance of axis 2 seems to vary with q_2."
    )
    family = Family.TORQUE_LAW
    by_angle = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if scene.n_joints <= AXIS or not scene.driven[AXIS]:
            return ()
        scale = 0.3 * typical_compliance(scene.robot)[AXIS]
        limits = (-20.0 * scale, 20.0 * scale)
        return (
            Parameter("a", "rad/(N m)", scale, plausible=limits, axis=AXIS),
            Parameter("b", "rad/(N m)", scale, plausible=limits, axis=AXIS),
        )

    def regressor(self, scene: Scene, theta: Array) -> Array:
        axis_2 = scene.J[:, :, AXIS] * scene.load_torque()[:, None, AXIS]
        angle = scene.q[:, None, AXIS]
        return np.stack([axis_2 * np.sin(angle), axis_2 * np.cos(angle)], axis=2)

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float]) -> str:
        own = compliance.get(f"c_{AXIS + 1}")
        (a, a_se), (b, b_se) = values.get("a", (0.0, 0.0)), values.get("b", (0.0, 0.0))
        most = math.hypot(a, b)
        if own is None or not most > own + 2.0 * math.hypot(a_se, b_se):
            return ""
        return (
            f"it would change the compliance of axis {AXIS + 1} by up to {most:.3g} rad/(N m),"
            f" and a balancer can't take more than the {own:.3g} that the axis has"
        )

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return _Balancer(*theta) if len(theta) else LeftOut("has no axis to act on in this robot")


class _Balancer(ColumnLaw):
    columns = (f"joint_{AXIS + 1}",)

    def __init__(self, a: float, b: float) -> None:
        self._a, self._b = float(a), float(b)

    def displacement(self, tick: Tick, tau: Array) -> Array:
        return (self._a * math.sin(tick.q[AXIS]) + self._b * math.cos(tick.q[AXIS])) * tau
