# SPDX-License-Identifier: Apache-2.0
"""A force that no sensor sees in real time: what of it is there under the process only."""

from __future__ import annotations

import math

import numpy as np

from ..typing import Array
from .hose_parameters import values_of
from .hoses import OF_PLACE, PLACE, PRESSED, drawn, forearm, has_pack, pull_when_tight, turning, turning_in_tool, wrist_centre
from .live import Pull, Tick
from .scene import Scene


class LivePull(Pull):
    """All forms of a pull but those of hoses that pull without the process too; values in the order of `parameters_of_pulls`."""

    def __init__(self, theta: Array, scene: Scene) -> None:
        self._turning, self._turning_in_tool = turning(scene), turning_in_tool(scene)
        self._constant, self._in_tool, self._k = theta[:3], theta[3:6], float(theta[6])
        end = 7 + 6 * len(self._turning)
        self._by_angle = theta[7:end].reshape(-1, 3)
        self._by_forearm, self._torque_in_tool = theta[end : end + 3], theta[end + 3 : end + 6]
        self._at_wrist, self._k_wrist = theta[end + 6 : end + 9], float(theta[end + 9])
        last = end + 10 + 6 * len(self._turning_in_tool)
        pack = last + 3 * has_pack(scene)
        self._by_angle_in_tool, self._pack = theta[end + 10 : last].reshape(-1, 3), theta[last:pack]
        towards, press = values_of(scene, theta, PLACE), values_of(scene, theta, PRESSED)
        towards = towards if len(towards) else np.zeros(OF_PLACE)
        self._tension, self._tension_wrist, self._k_place = (float(v) for v in towards[:3])
        self._place, self._tied = towards[3:6], towards[6:]
        self._has_forearm = bool(self._by_forearm.any())
        self._has_wrist = bool(self._at_wrist.any() or self._k_wrist or self._tension_wrist)
        self._press = press if press[:1].any() else np.zeros(0)
        self._has_pack = bool(self._pack.any() or len(self._press))
        joints = [forearm(scene)] * (self._has_forearm or self._has_pack)
        joints += [wrist_centre(scene)] * self._has_wrist + [scene.n_joints - 1] * self._has_pack
        self.columns = tuple(f"joint_{k + 1}{side}" for k in joints for side in ("", "a", "b"))
        self._wrist = 3 * (self._has_forearm or self._has_pack)  # where its columns begin
        if self._has_pack:
            self.beyond = tuple(f"joint_{k + 1}" for k in range(scene.wrist[0], scene.n_joints))

    def force(self, tick: Tick, p_tcp: Array, R_tool: Array) -> Array:
        in_tool = self._in_tool + _waves(tick.q, self._turning_in_tool) @ self._by_angle_in_tool
        out: Array = self._constant + R_tool @ in_tool - self._k * p_tcp + _waves(tick.q, self._turning) @ self._by_angle
        if self._tension or self._k_place:
            out += drawn(self._tension, self._place, p_tcp + R_tool @ self._tied, self._k_place)
        if self._has_forearm:
            out += tick.directions[:, :3] @ self._by_forearm
        if self._has_wrist:
            out += self._pull_of_wrist(_where(tick, self._wrist))
        return out

    def torque(self, tick: Tick, p_tcp: Array, R_tool: Array) -> Array:
        out: Array = R_tool @ self._torque_in_tool
        if self._has_wrist:
            p_wrist = _where(tick, self._wrist)
            out += np.cross(p_wrist - p_tcp, self._pull_of_wrist(p_wrist))
        if self._tension or self._k_place:
            tied: Array = R_tool @ self._tied
            out += np.cross(tied, drawn(self._tension, self._place, p_tcp + tied, self._k_place))
        return out

    def between(self, tick: Tick, p_tcp: Array, R_tool: Array) -> tuple[Array, Array]:
        force = tick.directions[:, :3] @ self._pack
        torque = np.cross(_where(tick, tick.directions.shape[1] - 3) - p_tcp, force)
        if len(self._press):
            tied = R_tool @ self._press[5:]
            of_hose = pull_when_tight(self._press, _where(tick, 0) + tick.directions[:, :3] @ self._press[2:5] - p_tcp - tied)
            force, torque = force + of_hose, torque + np.cross(tied, of_hose)
        return force, torque

    def _pull_of_wrist(self, p_wrist: Array) -> Array:
        out: Array = self._at_wrist - self._k_wrist * p_wrist
        return out + drawn(self._tension_wrist, self._place, p_wrist) if self._tension_wrist else out


def _where(tick: Tick, first: int) -> Array:
    """A point p from three columns a_i at right angles that turn about it: sum of a_i x (p x a_i) = 2 p."""
    columns = slice(first, first + 3)
    out: Array = 0.5 * np.cross(tick.directions[:, columns], tick.moments[:, columns], axis=0).sum(axis=1)
    return out


def _waves(q: Array, joints: list[int]) -> Array:
    """Sine and cosine of the angle of each joint, (2 joints,)."""
    return np.array([w for k in joints for w in (math.sin(q[k]), math.cos(q[k]))])
