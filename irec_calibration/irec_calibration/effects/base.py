# SPDX-License-Identifier: Apache-2.0
"""The protocol that every physical effect follows, one effect per file.

An effect says where the observed point of a row is moved to by one physical cause. A `loaded` session observes the change of
that against the reference row, an `absolute` session observes it directly; an effect need not care which.

To write one: subclass `Effect`, give `id`, `label`, `physics`, `parameters()` and `displacement()`. That is all; `regressor()`
then comes from differences. An effect that is linear in its parameters should give `regressor()` instead, and gets
`displacement()` for nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..scene import Scene
from ..typing import Array


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: unique within the effect, e.g. `c_3`.
        unit: e.g. `rad/(N m)`.
        scale: a typical magnitude where the effect is strong; sets numerical scaling and the width of weak priors.
        lower, upper: physical bounds; a fit never leaves them.
        plausible: range beyond which a fitted value is called implausible (not a bound of the fit); defaults to the bounds.
        start: value where a fit starts and where the effect is absent (nonlinear ones: a mid value).
        group: parameters that may be present on their own, e.g. `axis 3`; empty: only together with the others.
        grid: for a parameter that enters nonlinearly: values over which it is profiled. Empty: linear.
        flat: only the session says anything about it (no prior, and a fit starts from its present value).
    """

    name: str
    unit: str
    scale: float
    lower: float = -np.inf
    upper: float = np.inf
    plausible: tuple[float, float] | None = None
    start: float = 0.0
    group: str = ""
    grid: tuple[float, ...] = ()
    flat: bool = False

    @property
    def plausible_range(self) -> tuple[float, float]:
        return self.plausible if self.plausible is not None else (self.lower, self.upper)


class Effect(ABC):
    """One physical cause of disagreement between the controller's TCP and the measured one.

    Class attributes:
        id: stable name used in files.
        label: for plots, a few words.
        physics: one paragraph: what it is, how it looks when it is missing.
        acts_on: `arm` (moves the physical TCP: part of predictions), `wrench` (changes the force that the model is evaluated
            at) or `instrument` (only the measurement sees it: left out of predictions).
        in_prediction: whether predictions of the TCP include it. Sensor errors do not move the tool.
        elastic: a spring of the structure: part of the elastic response that other effects refer to.
        needs_elastic: reads `scene.elastic`.
        needs: what the scene must have: any of `time`, `order`, `temperature`, `ext`, `step`, `load`.
        registers: places instruments of an absolute session; belongs to the session, not to the robot.
    """

    id: ClassVar[str]
    label: ClassVar[str]
    physics: ClassVar[str]
    acts_on: ClassVar[str] = "arm"
    in_prediction: ClassVar[bool] = True
    elastic: ClassVar[bool] = False
    needs_elastic: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ()
    registers: ClassVar[bool] = False

    @abstractmethod
    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        """Parameters of this effect for the robot and columns of a scene."""

    def displacement(self, scene: Scene, theta: Array) -> Array:
        """Displacement of the observed point in base_link, (n, 3), m, for parameter values theta (p,)."""
        return self.regressor(scene, theta) @ theta

    def regressor(self, scene: Scene, theta: Array) -> Array:
        """Derivative of the displacement by each parameter at theta, (n, 3, p)."""
        parameters = self.parameters(scene)
        out = np.empty((len(scene), 3, len(parameters)))
        for i, parameter in enumerate(parameters):
            h = 1e-4 * parameter.scale
            ahead, behind = theta.copy(), theta.copy()
            ahead[i] = min(theta[i] + h, parameter.upper)
            behind[i] = max(theta[i] - h, parameter.lower)
            out[:, :, i] = (self.displacement(scene, ahead) - self.displacement(scene, behind)) / (ahead[i] - behind[i])
        return out

    def wrench(self, scene: Scene, theta: Array) -> tuple[Array, Array]:
        """For `acts_on = wrench`: the force and torque in tool0 that really act, (n, 3) each, N and N m."""
        raise NotImplementedError(f"{self.id} does not act on the wrench")


def absent(scene: Scene, needs: tuple[str, ...]) -> str:
    """Why a scene can't show an effect that needs something, or an empty string.

    Args:
        needs: names as in `Effect.needs`.
    """
    for need in needs:
        if need == "time" and scene.clock != "time":
            return "the session has no usable time stamps"
        if need in ("order", "step") and scene.clock == "none":
            return "the order of the rows is not known"
        if need == "temperature" and not scene.temperature:
            return "no temperature was logged"
        if need == "ext" and not scene.ext:
            return "no external axis was logged"
        if need == "load" and not np.any(scene.force_in_tool) and not np.any(scene.torque_in_tool):
            if scene.kind == "loaded":
                return "no process force acts in this session"
            if not np.any(scene.tau_gravity):
                return "no process force acts in this session and the robot description gives no masses"
    return ""
