# SPDX-License-Identifier: Apache-2.0
"""Effects of users in the correction: their own `displacement`, evaluated for two rows, without and with the process force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from irec_calibration.model import Term
from irec_calibration.robot import Robot
from irec_calibration.scene import Scene
from irec_calibration.typing import Array

from .errors import ActivationError

NOT_IN_PRODUCTION = frozenset({"time", "order", "step", "temperature", "ext"})


class UserTerms:
    """Terms that are not part of the catalogue. Slower than the compiled form: some 0.2 ms a call."""

    def __init__(self, terms: Sequence[Term], robot: Robot) -> None:
        """Prepare a scene of two rows.

        Raises:
            ActivationError: an effect needs history, time or temperatures, or the model's elastic answer.
        """
        for term in terms:
            missing = sorted(NOT_IN_PRODUCTION & set(term.effect.needs))
            if missing or term.effect.needs_elastic or term.effect.acts_on == "wrench":
                why = f"needs {', '.join(missing)}" if missing else "builds on other effects of the model"
                raise ActivationError(
                    f"effect '{term.effect.id}' {why}, which the correction can't give it; use a model without it"
                )
        self._robot = robot
        self._scene = _two_rows(robot)
        self._terms = [(t.effect, t.theta(t.effect.parameters(self._scene))) for t in terms]

    def displacement(self, q: Array, force_in_tool: Array, torque_in_tool: Array) -> Array:
        """Translation of the TCP by these terms against the unloaded robot, (3,), m, in base_link; q (k,), rad; N and N m at
        the TCP."""
        both = np.stack([q, q])
        kin = self._robot.kinematics(both)
        zero = np.zeros(3)
        scene = replace(
            self._scene,
            q=both,
            kin=kin,
            p_tcp=kin.p_tcp,
            p_observed=kin.p_tcp,
            force_in_tool=np.stack([zero, force_in_tool]),
            torque_in_tool=np.stack([zero, torque_in_tool]),
            tau_gravity=self._robot.gravity_torque(both, self._scene.gravity_in_base),
            _cache={},
        )
        u = sum((effect.displacement(scene, theta) for effect, theta in self._terms), np.zeros((2, 3)))
        return u[1] - u[0]


def _two_rows(robot: Robot) -> Scene:
    """The same pose without and with process force."""
    q = np.zeros((2, robot.n_joints))
    kin = robot.kinematics(q)
    one, count = np.zeros(2), np.zeros(2, dtype=np.int64)
    return Scene(
        kind="loaded", robot=robot, kin=kin, q=q, step=q, p_observed=kin.p_tcp, p_tcp=kin.p_tcp,
        moves_with_arm=np.ones(2, dtype=bool), force_in_tool=np.zeros((2, 3)), torque_in_tool=np.zeros((2, 3)), tau_gravity=q,
        stamp=one, load_since=one, pose=count, repeat=count, load_case=np.array([0, 1]), reference=count,
        previous=np.array([-1, 0]), driven=np.ones(robot.n_joints, dtype=bool), station=count, stations=("",), marker=count,
        markers=("tcp",), ext={}, temperature={}, gravity_in_base=np.array([0.0, 0.0, -9.81]), clock="none",
    )  # fmt: skip
