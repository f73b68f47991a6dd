# SPDX-License-Identifier: Apache-2.0
"""A force that no sensor sees: dress pack, hoses, cable drag."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..typing import Array
from .base import Effect, Parameter
from .external_force_live import LivePull
from .hose_parameters import SHAPED, parameters_of_pulls, values_of
from .hoses import AT_FLANGE, AXES, CELL, PLACE, PRESSED, TAUT, moored, taut, to_place, wrenches
from .live import LeftOut, LiveForm
from .scene import Scene
from .state import ElasticResponse, Load
from .traits import Family

# standard errors, and share of it, up to which a force has no component across gravity
ACROSS, ACROSS_SHARE = 3.0, 0.1
USUAL_MASS = 0.1  # of arm and payload: masses of robot descriptions are known so well


class ExternalForce(Effect):
    id = "external_force"
    label = "unmeasured external force"
    physics = (
        "Dress pack, hoses and cables pull at the tool with a force that the sensor does not see and that is not the same "
        "at the reference and under load: J C J^T f_0. Parts of the family: constant in base_link or in tool0; drawn towards a "
        "fixed point (a hose of stiffness k: f_0 = k (p - p_tcp), k p being the constant part); drawn towards a place h with one "
        "tension t, as by a spring balancer, at a point of the tool (to_x from the TCP) or (t_wrist) at the wrist, or with one "
        "that grows with the way (t + k_place |h - p|), as of a hose; the first two of these at the wrist, where it is fixed to "
        "the forearm and wrist gears carry none of it; constant in the frame of the forearm; turning with a wrist axis, or with "
        "the first where it comes from the cell; along axes of tool0, turning with a wrist axis, where it is fixed to a link of "
        "the wrist; between forearm and flange, where a dress pack that is fixed to both pulls them together "
        "and bends the wrist alone, with a constant force, as a hose that is slack up to its length and under pressure while the "
        "process runs, or always, as such a hose, or between the cell and a point of the tool, always and as a spring: then the "
        "joint angles of reference and load case make the difference; and a torque, since it does not pull at the TCP. "
        "Missing, the residual is there whatever the process force and depends on the pose only. In a loaded session a force "
        "that stays the same cancels; in an absolute one all of it shows, and of a dress pack the hose that is slack up to "
        "its length, but a constant one along gravity is a payload, or at the wrist a forearm, of another mass."
    )
    family = Family.SENSOR
    needs_elastic = True
    loads_arm = True
    needs = ("relaxed", "weight")
    usual_in = ("absolute",)

    def parameters(self, scene: Scene) -> tuple[Parameter, ...]:
        return parameters_of_pulls(scene)

    def displacement(self, scene: Scene, theta: Array) -> Array:
        if scene.elastic is None:
            return np.zeros((len(scene), 3))
        return self.by_elastic(scene, theta, scene.elastic)

    def regressor(self, scene: Scene, theta: Array) -> Array:
        if scene.elastic is None:
            return np.zeros((len(scene), 3, len(self.parameters(scene))))
        on_arm, pack = wrenches(scene)
        place, cell, hose, press = (values_of(scene, theta, group) for group in SHAPED)
        by_place = scene.elastic.compliance @ np.concatenate([to_place(scene, place), moored(scene, cell)], axis=2)
        between = np.concatenate([pack, taut(scene, hose), taut(scene, press, pressed=True)], axis=2)
        of_wrist = np.zeros((len(scene), 3, 6)) if scene.elastic.of_wrist is None else scene.elastic.of_wrist
        of_pack, by_hose = np.split(of_wrist @ between, [pack.shape[2]], axis=2)
        return np.concatenate([scene.elastic.compliance @ on_arm, of_pack, by_place, by_hose], axis=2)

    def why_impossible(self, values: Mapping[str, tuple[float, float]], compliance: Mapping[str, float], scene: Scene) -> str:
        found = _weights_of_other_masses(values, scene)
        if not found:
            return _pushes(values, scene)
        said = [
            f"a constant force along gravity{' at the wrist' if at_wrist else ''}, {along:.3g} N, is no hose but "
            f"{'a forearm' if at_wrist else 'a payload'} that is {mass:+.3g} kg from what "
            + ("the robot description states; check its masses, and what is mounted there" if at_wrist else
               "the session states; check payload.mass")
            for along, mass, at_wrist in found
        ]  # fmt: skip
        return " and ".join(said)

    def is_usual(self, values: Mapping[str, float], share: float, scene: Scene) -> bool:
        found = _weights_of_other_masses({name: (value, 0.0) for name, value in values.items()}, scene)
        carried = float(scene.arm.robot.moved_masses.sum()) + (scene.gravity.payload.mass if scene.gravity.payload else 0.0)
        return bool(found) and sum(abs(mass) for _, mass, _ in found) <= USUAL_MASS * carried

    def where_to_look(self, values: Mapping[str, float], proven: Sequence[str]) -> str:
        look = "in base_link; look what hangs or is fixed there"
        if TAUT in proven or PRESSED in proven:  # how long it is can't be told from where it is tied
            when = "in some poses" if TAUT in proven else "while the process runs, as one under pressure does"
            return f"a hose between forearm and flange comes tight {when}; look how it is laid"
        if CELL in proven:
            place = _point(values.get(f"from_{a}", 0.0) for a in AXES)
            return f"a hose pulls with and without the process towards about ({place}) m {look}"
        constant, k = np.array([values.get(f"f_{a}", 0.0) for a in AXES]), values.get("k", 0.0)
        at = [values[f"h_{a}"] for a in AXES if f"h_{a}" in values]
        if PLACE in proven and len(at) < len(AXES):
            return ""  # so far away that no place is known
        if PLACE in proven:
            tension, k = values.get("t", 0.0) + values.get("t_wrist", 0.0), values.get("k_place", 0.0)
            if k > 0.0 and tension < 0.0:
                pull = f"some {_about(k)} N/m of what its way is longer than {-tension / k:.1f} m"
            else:
                pull = f"some {_about(tension)} N" + (f" and {_about(k)} N more for each metre of its way" if k > 0.0 else "")
            return f"it pulls with {pull} towards about ({_point(at)}) m {look}"
        if {*proven} == {"constant", "towards a point"} and k > 0.0:
            return f"it pulls as a spring of some {_about(k)} N/m towards about ({_point(constant / k)}) m {look}"
        size = float(np.linalg.norm(constant))
        if {*proven} == {"constant"} and size > 0.0:
            return f"it pulls with some {_about(size)} N along ({_point(constant / size)}) in base_link"
        return ""

    def by_elastic(self, scene: Scene, theta: Array, change: ElasticResponse) -> Array:
        on_arm, pack = _by_values(scene, theta)
        cell, hose = values_of(scene, theta, CELL), values_of(scene, theta, TAUT)
        if cell[:3].any():
            on_arm = on_arm + moored(scene, cell)[:, :, :3] @ cell[:3]
        if hose[:1].any():
            pack = pack + taut(scene, hose)[:, :, 0] * hose[0]
        out: Array = np.einsum("nij...,nj->ni...", change.compliance, on_arm)
        if change.of_wrist is not None:
            out += np.einsum("nij...,nj->ni...", change.of_wrist, pack)
        return out

    def torque_of_pull(self, scene: Scene, theta: Array) -> Array:
        on_arm, pack = (Load(scene.arm, w[:, :3], w[:, 3:]).tau for w in _by_values(scene, theta))
        return np.asarray(on_arm + pack * (np.arange(scene.n_joints) >= scene.wrist[0]))

    def live(self, scene: Scene, theta: Array) -> LiveForm:
        forces = [v for p, v in zip(self.parameters(scene), theta, strict=True) if not p.grid and p.group not in (TAUT, CELL)]
        if not any(forces):
            return LeftOut("is a hose that pulls without the process too, and goes with the joint angles alone")
        return LivePull(theta, scene)


def _about(value: float) -> str:
    """Two digits of a value."""
    return f"{float(f'{value:.2g}'):g}"


def _point(p: Iterable[float]) -> str:
    return ", ".join(f"{v:.1f}" for v in p)


def _weights_of_other_masses(values: Mapping[str, tuple[float, float]], scene: Scene) -> list[tuple[float, float, bool]]:
    """Of a pull in an absolute session that is nothing but constant forces along gravity, at the TCP, at the wrist or at both:
    each, N, the mass that it is, kg, and whether it is at the wrist; else nothing. A small torque about the TCP goes with it:
    that mass sits beside it.

    Args:
        values: parameter -> value and standard error.
    """
    at_tcp, at_wrist = [f"f_{a}" for a in AXES], [f"f_{a}_wrist" for a in AXES]
    there = [names for names in (at_tcp, at_wrist) if names[0] in values]
    beside = {f"m_{a}_tool" for a in AXES} & set(values)
    if scene.kind != "absolute" or set(values) - beside != {n for names in there for n in names}:
        return []
    g = float(np.linalg.norm(scene.gravity_in_base))
    down = scene.gravity_in_base / max(g, 1e-9)
    out = []
    for names in there:
        force, errors = np.array([values[n] for n in names]).T
        along = float(force @ down)
        if np.any(np.abs(force - along * down) > np.maximum(ACROSS * errors, ACROSS_SHARE * abs(along))) or not along:
            return []
        out.append((along, along / max(g, 1e-9), names is at_wrist))
    torque = float(np.linalg.norm([values[n][0] for n in beside]))
    return out if torque <= AT_FLANGE * sum(abs(along) for along, _, _ in out) else []


def _pushes(values: Mapping[str, tuple[float, float]], scene: Scene) -> str:
    """Why a pull towards a place is none: over the session its mean, with that at the wrist, is a push; or an empty string."""
    for tension, stiffness, more, place, to in (("t", "k_place", "", "h", "to"), ("t_cell", "k_cell", "s_cell", "from", "at")):
        t, k, s, *towards = (values.get(n, (0.0, 0.0))[0] for n in (tension, stiffness, more, *(f"{place}_{a}" for a in AXES)))
        tied = np.array([values.get(f"{to}_{a}", (0.0, 0.0))[0] for a in AXES])
        if t >= 0.0:
            continue
        way = np.array(towards) - scene.p_tcp - scene.kin.R_tool @ tied
        far = np.linalg.norm(way, axis=1)
        # the two together are one pull, on a point between
        wrist = values.get("t_wrist", (0.0, 0.0))[0] if tension == "t" else 0.0
        mean = float((t + k * far + s * far**3).mean()) + wrist
        if mean < 0.0:
            return f"it would push with {-mean:.3g} N from ({_point(towards)}) m in base_link, and no hose does"
    return ""


def _by_values(scene: Scene, theta: Array) -> tuple[Array, Array]:
    """Wrench in tool0 by values of all parameters but those of a hose that always pulls, (n, 6), on the arm, and between forearm
    and flange."""
    on_arm, pack = wrenches(scene)
    of_arm = on_arm.shape[2]
    out, on_flange = on_arm @ theta[:of_arm], pack @ theta[of_arm : of_arm + pack.shape[2]]
    place, press = values_of(scene, theta, PLACE), values_of(scene, theta, PRESSED)
    if place[:3].any():
        out += to_place(scene, place)[:, :, :3] @ place[:3]
    if press[:1].any():
        on_flange += taut(scene, press, pressed=True)[:, :, 0] * press[0]
    return out, on_flange
