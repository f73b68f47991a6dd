# SPDX-License-Identifier: Apache-2.0
"""Spring or gas balancer on axis 2: its effective compliance varies with the angle."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import ColumnLaw, LeftOut, LiveForm, Tick
from .scales import SURELY, typical_compliance
from .scene import Scene
from .traits import Family

AXIS = 1  # index of joint_2
NAMES = ("a", "b", "a_twice", "b_twice")
PRELOAD = ("p_a", "p_b", "p_a_twice", "p_b_twice")
HEAVY = 1000.0  # N m about axis 2 by the arm's own weight; arms below that have no balancer
WITHOUT = -5.0  # odds of 150 against one, natural log
# Of the compliance of axis 2, beside a balancer. Those of heavy arms change it by +-10 to 25 % with posture; chosen: three times
# that, as it is on the simulators of others.
LEAST_LEFT = 0.25


class Counterbalance(Effect):
    id = "counterbalance"
    label = "counterbalance"
    physics = (
        "A spring or gas balancer acts in parallel with axis 2; the share of the load that it carries varies with its angle: "
        "J_2 (a sin q_2 + b cos q_2 + a_twice sin 2 q_2 + b_twice cos 2 q_2) tau_2: its force times the change of its lever, and "
        "its stiffness times the square of that. Missing, the compliance of axis 2 seems to vary with q_2. What it carries of "
        "the weight turns the axis by an angle of that form too, which an absolute session sees: J_2 (p_a sin q_2 + p_b cos q_2 "
        "+ p_a_twice sin 2 q_2 + p_b_twice cos 2 q_2), as an eccentric encoder does. A loaded session sees no difference of it."
    )
    family = Family.TORQUE_LAW
    needs = ("weight",)
    by_angle = True
    turns_by_angle = True

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        if scene.n_joints <= AXIS or not scene.driven[AXIS]:
            return ()
        scale = 0.3 * typical_compliance(scene.robot)[AXIS]
        # without limits of their own: over a narrow range of angles they all but cancel; `why_impossible` asks their sum
        by_load = [Parameter(name, "rad/(N m)", scale, group="stiffness", axis=AXIS) for name in NAMES]
        carried = max(float(scene.gravity.largest[AXIS]), 1.0) * scale
        limits = (-20.0 * carried, 20.0 * carried)
        by_weight = [Parameter(name, "rad", carried, plausible=limits, group="preload", axis=AXIS) for name in PRELOAD]
        return (*by_load, *by_weight)

    def log_odds(self, scene: Scene) -> float:
        return WITHOUT if _light(scene) else 0.0

    def rather(self, values: Mapping[str, float], compliance: Mapping[str, float], scene: Scene) -> str:
        return "encoder_harmonics" if _light(scene) else ""

    def regressor(self, scene: Scene, theta: Array) -> Array:
        waves = harmonics(scene.q[:, AXIS])[:, None, :]
        axis_2 = scene.J[:, :, AXIS, None]
        by_load = axis_2 * scene.load_torque()[:, None, AXIS, None] * waves
        by_weight = axis_2 * waves if scene.kind == "absolute" else np.zeros_like(by_load)
        return np.concatenate([by_load, by_weight], axis=2)

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        own = compliance.get(f"c_{AXIS + 1}")
        if own is None:  # no axis is without, and what stands for it is no balancer
            return f"the model has no compliance of axis {AXIS + 1} of which a balancer could take a part"
        total = own + harmonics(scene.q[:, AXIS]) @ [values.get(name, (0.0, 0.0))[0] for name in NAMES]
        least, most = float(total.min()), float(total.max())
        if least >= LEAST_LEFT * most:
            return ""
        return (
            f"with it the compliance of axis {AXIS + 1} would be between {least:.3g} and {most:.3g} rad/(N m) within the session,"
            f" and a balancer takes at most {1.0 - LEAST_LEFT:.0%} of it"
        )

    def also_called(self, scene: Scene, theta: Array, se: Array) -> str:
        """What it carries of the weight, by itself, is what an eccentric encoder of axis 2 does."""
        varies = (np.abs(theta) > SURELY * se)[: len(NAMES)].any()
        return "" if scene.kind != "absolute" or varies else "encoder_harmonics"

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return _Balancer(*theta[: len(NAMES)]) if len(theta) else LeftOut("has no axis to act on in this robot")


def _light(scene: Scene) -> bool:
    """Whether an arm of an absolute session needs no balancer, nor has one."""
    return bool(scene.kind == "absolute" and scene.gravity.largest[AXIS] < HEAVY)


def harmonics(q: Array) -> Array:
    """What each parameter is multiplied by at angles of axis 2, rad, (n,) -> (n, 4)."""
    return np.stack([np.sin(q), np.cos(q), np.sin(2.0 * q), np.cos(2.0 * q)], axis=1)


class _Balancer(ColumnLaw):
    columns = (f"joint_{AXIS + 1}",)

    def __init__(self, a: float, b: float, a_twice: float, b_twice: float) -> None:
        self._a, self._b, self._a_twice, self._b_twice = float(a), float(b), float(a_twice), float(b_twice)

    def displacement(self, tick: Tick, tau: Array) -> Array:
        s, c = math.sin(tick.q[AXIS]), math.cos(tick.q[AXIS])
        return (self._a * s + self._b * c + self._a_twice * 2.0 * s * c + self._b_twice * (2.0 * c * c - 1.0)) * tau
