# SPDX-License-Identifier: Apache-2.0
"""Effects that give no real-time form of their own: their `displacement`, evaluated without and with the process force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from irec_calibration.effects import Effect
from irec_calibration.effects.production import LOADED, POINTS, ROWS, at
from irec_calibration.effects.scene import Scene
from irec_calibration.effects.state import ElasticResponse
from irec_calibration.model import Model
from irec_calibration.typing import Array


class UserTerms:
    """Terms without a real-time form. Slower than those with one: some 0.3 ms a call."""

    def __init__(self, terms: Sequence[tuple[Effect, Array]], scene: Scene, model: Model) -> None:
        """Keep terms (effect, values of its parameters in that scene), a scene by `production_scene`, and their model."""
        self._terms, self._model = list(terms), model
        self._scene = scene
        self.needs_elastic = any(effect.needs_elastic for effect, _ in self._terms)

    def displacement(
        self, q: Array, force_in_tool: Array, torque_in_tool: Array, rail_position: float, elastic: ElasticResponse | None,
        tau_unseen: Array,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Translation (3,), m, and rotation (3,), rad, of the tool by these terms against the unloaded robot, in base_link.

        Args:
            q: (k,), rad. force_in_tool, torque_in_tool: that act at the TCP, (3,), N and N m.
            elastic: how the springs of the model answer in each of the rows, where a term asks for it.
            tau_unseen: torque about the actuated axes of what pulls and no sensor reads, (k,), N m.
        """
        stands = self._model.standing(at(self._scene, q, rail_position))
        points = stands.seen_at(stands.p_tcp + np.tile(POINTS, (2, 1)))
        here = points.with_wrench(np.outer(LOADED, force_in_tool), np.outer(LOADED, torque_in_tool))
        scene = replace(here, elastic=elastic, tau_unseen=np.outer(LOADED, tau_unseen))
        u = sum((effect.displacement(scene, theta) for effect, theta in self._terms), np.zeros((ROWS, 3)))
        caused = u[LOADED == 1] - u[LOADED == 0]
        x, y, z = caused[1:] - caused[0]  # u(p + e) - u(p) = rotation x e
        return caused[0], np.array([y[2], z[0], x[1]])
