# SPDX-License-Identifier: Apache-2.0
"""A force that no sensor sees: dress pack, hoses, cable drag."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .live import LiveForm, Pull, Tick
from .scales import typical_reach
from .scene import Scene
from .state import ElasticResponse, Load
from .traits import Family

AXES = ("x", "y", "z")
FOREARM = ("along", "a", "b")  # along the axis of the joint that moves the forearm, and along its two virtual axes
AT_FLANGE = 0.15  # m from the TCP; about where a head carries its hoses
# standard errors, and share of it, up to which a force has no component across gravity
ACROSS, ACROSS_SHARE = 3.0, 0.1
USUAL_MASS = 0.1  # of arm and payload: masses of robot descriptions are known so well


class ExternalForce(Effect):
    id = "external_force"
    label = "unmeasured external force"
    physics = (
        "Dress pack, hoses and cables pull at the tool with a force that the sensor does not see and that is not the same "
        "at the reference and under load: J C J^T f_0. Parts of the family: constant in base_link or in tool0; drawn towards a "
        "fixed point (a hose of stiffness k: f_0 = k (p - p_tcp), k p being the constant part); both of these at the wrist, "
        "where it is fixed to the forearm and wrist gears carry none of it; constant in the frame of the forearm; turning with a "
        "wrist axis, or with the first where it comes from the cell; along axes of tool0, turning with a wrist axis, where it is "
        "fixed to a link of the wrist; between forearm and flange, where a dress pack that is fixed to both pulls them together "
        "and bends the wrist alone; and a torque, since it does not pull at the TCP. "
        "Missing, the residual is there whatever the process force and depends on the pose only. In a loaded session a force "
        "that stays the same cancels; in an absolute one all of it shows, but a constant one along gravity is a payload, or "
        "at the wrist a forearm, of another mass."
    )
    family = Family.SENSOR
    needs_elastic = True
    loads_arm = True
    needs = ("relaxed", "weight")
    usual_in = ("absolute",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        kept: dict[str, tuple[Parameter, ...]] = scene.view.kept  # the same whatever the load: asked by every scene of a fit
        return kept.get("pull parameters") or kept.setdefault("pull parameters", self._parameters(scene))

    def _parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        def pull(name: str, group: str) -> Parameter:
            return Parameter(name, "N", 20.0, plausible=(-1000.0, 1000.0), group=group)

        def stiffness(name: str, group: str) -> Parameter:
            return Parameter(name, "N/m", 20.0 / typical_reach(scene), 0.0, plausible=(0.0, 2000.0), group=group)

        largest = 1000.0 * AT_FLANGE
        return (
            *(pull(f"f_{a}", "constant") for a in AXES),
            *(pull(f"f_{a}_tool", "with the tool") for a in AXES),
            stiffness("k", "towards a point"),
            *(pull(f"f_{a}_{t}{k + 1}", f"with axis {k + 1}") for k in _turning(scene) for t in ("sin", "cos") for a in AXES),
            *(pull(f"f_{d}_forearm", "with the forearm") for d in FOREARM),
            *(
                Parameter(f"m_{a}_tool", "N m", 20.0 * AT_FLANGE, plausible=(-largest, largest), group="beside the TCP")
                for a in AXES
            ),
            *(pull(f"f_{a}_wrist", "at the wrist") for a in AXES),
            stiffness("k_wrist", "at the wrist towards a point"),
            *(
                pull(f"f_{a}_tool_{t}{k + 1}", f"with the tool and axis {k + 1}")
                for k in _turning_in_tool(scene)
                for t in ("sin", "cos")
                for a in AXES
            ),
            *(pull(f"f_{d}_pack", "between forearm and flange") for d in FOREARM if _has_pack(scene)),
        )

    def displacement(self, scene: Scene, theta: Array) -> Array:
        if scene.elastic is None:
            return np.zeros((len(scene), 3))
        return self.by_elastic(scene, theta, scene.elastic)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.elastic is None:
            return np.zeros((len(scene), 3, len(self.parameters(scene))))
        on_arm, pack = _wrenches(scene)
        out = scene.elastic.compliance @ on_arm
        return out if scene.elastic.of_wrist is None else np.concatenate([out, scene.elastic.of_wrist @ pack], axis=2)

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        found = _weight_of_another_mass(values, scene)
        if found is None:
            return ""
        along, mass, at_wrist = found
        if at_wrist:
            return (
                f"a constant force along gravity at the wrist, {along:.3g} N, is no hose but a forearm that is {mass:+.3g} kg"
                " from what the robot description states; check its masses, and what is mounted there"
            )
        return (
            f"a constant force along gravity, {along:.3g} N, is no hose but a payload that is {mass:+.3g} kg from what the"
            " session states; check payload.mass"
        )

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        found = _weight_of_another_mass({name: (value, 0.0) for name, value in values.items()}, scene)
        carried = float(scene.arm.robot.moved_masses.sum()) + (scene.gravity.payload.mass if scene.gravity.payload else 0.0)
        return found is not None and abs(found[1]) <= USUAL_MASS * carried

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array:
        on_arm, pack = _by_values(scene, theta)
        out: Array = np.einsum("nij...,nj->ni...", change.compliance, on_arm)
        if change.of_wrist is not None:
            out += np.einsum("nij...,nj->ni...", change.of_wrist, pack)
        return out

    def torque_of_pull(self, scene: Scene, theta: Array) -> Array:
        on_arm, pack = (Load(scene.arm, w[:, :3], w[:, 3:]).tau for w in _by_values(scene, theta))
        return np.asarray(on_arm + pack * (np.arange(scene.n_joints) >= scene.wrist[0]))

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        return _Pull(theta, scene)


def _weight_of_another_mass(values: Mapping[str, tuple[float, float]], scene: Scene) -> tuple[float, float, bool] | None:
    """A constant force along gravity in an absolute session, N, the mass that it is, kg, and whether it is at the wrist; or None.

    Args:
        values: parameter -> value and standard error.
    """
    at_tcp, at_wrist = [f"f_{a}" for a in AXES], [f"f_{a}_wrist" for a in AXES]
    constant = at_wrist if at_wrist[0] in values else at_tcp
    if scene.kind != "absolute" or set(values) != set(constant):
        return None
    force, errors = np.array([values[n] for n in constant]).T
    g = float(np.linalg.norm(scene.gravity_in_base))
    down = scene.gravity_in_base / max(g, 1e-9)
    along = float(force @ down)
    if np.any(np.abs(force - along * down) > np.maximum(ACROSS * errors, ACROSS_SHARE * abs(along))) or not along:
        return None
    return along, along / max(g, 1e-9), constant is at_wrist


def _wrenches(scene: Scene) -> tuple[Array, Array]:
    """Wrench in tool0 by one of each parameter, N and N m: of those that pull at the arm, (n, 6, p), and of those that pull
    between forearm and flange, which are the last, (n, 6, q); kept with the view, since fits ask thousands of times."""
    rows, known = scene.view.kept.get("pulls", (None, None))
    if rows is not scene.rows:
        known = _wrenches_anew(scene)
        scene.view.kept["pulls"] = scene.rows, known
    on_arm, pack = known
    return on_arm, pack


def _by_values(scene: Scene, theta: Array) -> tuple[Array, Array]:
    """Wrench in tool0 by values of all parameters, (n, 6), on the arm, and between forearm and flange."""
    on_arm, pack = _wrenches(scene)
    return on_arm @ theta[: on_arm.shape[2]], pack @ theta[on_arm.shape[2] :]


def _wrenches_anew(scene: Scene) -> tuple[Array, Array]:
    in_tool = np.swapaxes(scene.kin.R_tool, 1, 2)  # of each unit force in base_link
    none, unit = np.zeros_like(in_tool), np.tile(np.eye(3), (len(scene), 1, 1))
    by_wrist = [in_tool * t(scene.q[:, k])[:, None, None] for k in _turning(scene) for t in (np.sin, np.cos)]
    k = _forearm(scene)
    frame = np.concatenate([scene.kin.axis[:, k, :, None], np.swapaxes(scene.kin.virtual_axis[:, k], 1, 2)], axis=2)
    p_wrist = scene.kin.origin[:, _wrist_centre(scene)]

    def at(point: Array) -> Array:
        """Of each unit force in base_link at a point, (n, 6, 3)."""
        moments = in_tool @ np.stack([np.cross(point - scene.p_tcp, e) for e in np.eye(3)], axis=2)
        return np.concatenate([in_tool, moments], axis=1)

    force = [in_tool, unit, -in_tool @ scene.p_tcp[:, :, None], *by_wrist, in_tool @ frame]
    wrist = at(p_wrist)
    by_wrist_in_tool = [unit * t(scene.q[:, k])[:, None, None] for k in _turning_in_tool(scene) for t in (np.sin, np.cos)]
    on_arm = [
        *(np.concatenate([columns, np.zeros_like(columns)], axis=1) for columns in force),
        np.concatenate([none, unit], axis=1),
        wrist,
        -wrist @ p_wrist[:, :, None],
        *(np.concatenate([columns, none], axis=1) for columns in by_wrist_in_tool),
    ]
    pack = at(scene.kin.origin[:, -1]) @ frame if _has_pack(scene) else np.zeros((len(scene), 6, 0))
    under_load = scene.rows.under_load[:, None, None]
    return np.concatenate(on_arm, axis=2) * under_load, pack * under_load


def _turning(scene: Scene) -> list[int]:
    """Joints with whose angle a pull may change: those of the wrist and, in a loaded session, the first, where a hose comes from
    the cell (in an absolute one an arm that swings about has too much else that goes with it)."""
    wrist = scene.wrist
    return wrist if scene.kind == "absolute" or wrist[0] == 0 or scene.kin.is_prismatic[0] else [0, *wrist]


def _turning_in_tool(scene: Scene) -> list[int]:
    """Joints of the wrist with whose angle a pull along axes of tool0 may change: what is fixed to a link of the wrist turns so.
    A session without process shows too little beside the weight to tell it."""
    return scene.wrist if scene.kind == "loaded" else []


def _has_pack(scene: Scene) -> bool:
    """Whether a pull between forearm and flange is looked for: a session without process shows too little beside the weight."""
    return scene.kind == "loaded" and scene.wrist[0] > 0


def _forearm(scene: Scene) -> int:
    """The joint that moves the forearm, the last one before the wrist."""
    return max(scene.wrist[0] - 1, 0)


def _wrist_centre(scene: Scene) -> int:
    """The joint whose origin is where the axes of a wrist meet."""
    wrist = scene.wrist
    return wrist[len(wrist) // 2]


class _Pull(Pull):
    def __init__(self, theta: Array, scene: Scene) -> None:
        turning, self._turning_in_tool = _turning(scene), _turning_in_tool(scene)
        self._constant, self._in_tool, self._k = theta[:3], theta[3:6], float(theta[6])
        end = 7 + 6 * len(turning)
        self._by_angle, self._turning = theta[7:end].reshape(-1, 3), turning
        self._by_forearm, self._torque_in_tool = theta[end : end + 3], theta[end + 3 : end + 6]
        self._at_wrist, self._k_wrist = theta[end + 6 : end + 9], float(theta[end + 9])
        last = end + 10 + 6 * len(self._turning_in_tool)
        self._by_angle_in_tool, self._pack = theta[end + 10 : last].reshape(-1, 3), theta[last:]
        self._has_forearm, self._has_wrist = bool(self._by_forearm.any()), bool(self._at_wrist.any() or self._k_wrist)
        self._has_pack = bool(self._pack.any())
        joints = [_forearm(scene)] * (self._has_forearm or self._has_pack)
        joints += [_wrist_centre(scene)] * self._has_wrist + [scene.n_joints - 1] * self._has_pack
        self.columns = tuple(f"joint_{k + 1}{side}" for k in joints for side in ("", "a", "b"))
        self._wrist = 3 * (self._has_forearm or self._has_pack)  # where its columns begin
        if self._has_pack:
            self.beyond = tuple(f"joint_{k + 1}" for k in range(scene.wrist[0], scene.n_joints))

    def force(self, tick: Tick, p_tcp: Array, R_tool: Array) -> Array:
        in_tool = self._in_tool + _waves(tick.q, self._turning_in_tool) @ self._by_angle_in_tool
        out: Array = self._constant + R_tool @ in_tool - self._k * p_tcp + _waves(tick.q, self._turning) @ self._by_angle
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
        return out

    def between(self, tick: Tick, p_tcp: Array) -> tuple[Array, Array]:
        force = tick.directions[:, :3] @ self._pack
        return force, np.cross(_where(tick, tick.directions.shape[1] - 3) - p_tcp, force)

    def _pull_of_wrist(self, p_wrist: Array) -> Array:
        out: Array = self._at_wrist - self._k_wrist * p_wrist
        return out


def _where(tick: Tick, first: int) -> Array:
    """A point p from three columns a_i at right angles that turn about it: sum of a_i x (p x a_i) = 2 p."""
    columns = slice(first, first + 3)
    out: Array = 0.5 * np.cross(tick.directions[:, columns], tick.moments[:, columns], axis=0).sum(axis=1)
    return out


def _waves(q: Array, joints: list[int]) -> Array:
    """Sine and cosine of the angle of each joint, (2 joints,)."""
    return np.array([w for k in joints for w in (math.sin(q[k]), math.cos(q[k]))])
