# SPDX-License-Identifier: Apache-2.0
"""Robots of absolute sessions and what is hidden in them: small arms and large ones, at the sizes that they really have.

The base model of an absolute session is geometric (stations, markers, links, joint zeros); everything elastic is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .cellfile import find_cell
from .kinematics import Array, Chain, read_urdf
from .parameters import PlantParameters
from .sensing import SensingParameters
from .truth_catalogue import CATALOGUE, Parameters, Physics, TruthEffect, direction, plant_effect

# file, share of the sessions, and about how soft a joint of the arm and of the wrist is, rad/(N m)
ROBOTS: dict[str, tuple[float, float, float]] = {
    "ur5": (0.2, 8e-6, 3e-5), "ur10": (0.35, 5e-6, 2e-5), "wam7": (0.15, 2e-5, 1e-4),
    "kr120_r2700_extra_ha": (0.15, 2.2e-7, 1.3e-6), "kr300_r2500_ultra": (0.15, 2.2e-7, 1.2e-6),
}  # fmt: skip
OFTEN: dict[str, float] = {
    "joint_torsion": 3.0, "link_bending": 1.0, "base_compliance": 1.2, "encoder_harmonics": 1.5, "joint_backlash": 1.0,
    "joint_hysteresis": 1.2, "joint_settling": 0.7, "thermal_drift": 0.8, "joint_stiffening": 0.4, "station_shift": 0.3,
    "tool_compliance": 0.6, "external_force": 0.6,
}  # fmt: skip


@dataclass(frozen=True)
class Arm:
    """One robot: chain with its payload, its description, how soft its joints are (n,), and how large its torques are (n,)."""

    name: str
    urdf: Path
    chain: Chain
    payload: tuple[float, Array]
    soft: Array
    torque: Array


@dataclass(frozen=True)
class Geometry:
    """True minus nominal: joint zeros (n,) rad, positions (n, 3) m and turns (n, 3) rad of the joints' frames."""

    zero: Array
    p: Array
    turn: Array


@dataclass(frozen=True)
class AbsoluteTruth:
    """Geometry and hidden effects (id, parameters) of one arm."""

    arm: Arm
    geometry: Geometry
    hidden: tuple[tuple[str, Parameters], ...]

    def without(self, *effects: str) -> AbsoluteTruth:
        """The same without some hidden effects."""
        return replace(self, hidden=tuple(h for h in self.hidden if h[0] not in effects))

    def physics(self) -> Physics:
        """Parameters of plant and instruments."""
        n = self.arm.chain.n
        plant = PlantParameters.plain(np.zeros(n), np.zeros((n, 2)), 0.15 * self.arm.torque)
        g = self.geometry
        plant = replace(plant, joint_zero=g.zero, p_error=g.p, turn_error=g.turn, unrelaxed=1.0)
        physics = Physics(plant, SensingParameters.plain(n))
        for effect, p in sorted(self.hidden, key=lambda h: h[0] not in ELASTIC):  # springs before what refers to them
            physics = EFFECTS[effect].apply(physics, p, 1.0)
        return physics


def _log(rng: np.random.Generator, low: float, high: float, size: Any = None) -> Any:
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def _springs(name: str) -> TruthEffect:
    key = {"joint_torsion": "axial", "link_bending": "transverse"}[name]
    return plant_effect(lambda rng: {}, lambda plant, p, s: {key: getattr(plant, key) + s * np.array(p["compliance"])})


ELASTIC = ("joint_torsion", "link_bending", "base_compliance", "tool_compliance")
EFFECTS: dict[str, TruthEffect] = {**CATALOGUE, **{e: _springs(e) for e in ("joint_torsion", "link_bending")}}


def read_arm(name: str, rng: np.random.Generator) -> Arm:
    """A robot of config/robots with a payload drawn for it."""
    urdf = find_cell("afp").parent.parent / "robots" / f"{name}.urdf"
    chain = read_urdf(urdf)
    arm, wrist = ROBOTS[name][1:]
    large = name.startswith("kr")
    mass = float(rng.uniform(20, 120) if large else rng.uniform(0.5, 4.0))
    com = np.array([0.0, 0.0, 0.1 if large else 0.05]) + rng.normal(0.0, 0.03, 3)
    R, p = chain.R_tcp, chain.p_tcp
    together = chain.tool_mass + mass
    tool_com = (chain.tool_mass * chain.tool_com + mass * (p + R @ com)) / together
    first = chain.n - 3
    base = np.r_[np.full(first, arm), np.full(chain.n - first, wrist)]
    torque = np.array([800.0] * first + [200.0] * (chain.n - first)) if large else np.array([60.0] * first + [10.0] * 3)
    chain = replace(chain, tool_mass=together, tool_com=tool_com)
    return Arm(name, urdf, chain, (mass, com), base * _log(rng, 0.5, 2.0, chain.n), torque)


def draw_arm(rng: np.random.Generator) -> Arm:
    """One of the robots."""
    names = list(ROBOTS)
    return read_arm(str(rng.choice(names, p=[ROBOTS[n][0] for n in names])), rng)


def draw_absolute(arm: Arm, count: int, rng: np.random.Generator) -> AbsoluteTruth:
    """A truth with wrong geometry and `count` hidden effects."""
    n, size = arm.chain.n, float(_log(rng, 0.3, 1.5))
    geometry = Geometry(
        size * rng.normal(0.0, 1.5e-3, n), size * rng.normal(0.0, 4e-4, (n, 3)), size * rng.normal(0.0, 7e-4, (n, 3))
    )  # fmt: skip
    names = list(OFTEN)
    weight = np.array([OFTEN[e] for e in names])
    chosen = [str(e) for e in rng.choice(names, size=count, replace=False, p=weight / weight.sum())]
    if any(e in ("joint_hysteresis", "joint_stiffening") for e in chosen) and "joint_torsion" not in chosen:
        chosen[chosen.index(next(e for e in chosen if e in ("joint_hysteresis", "joint_stiffening")))] = "joint_torsion"
    return AbsoluteTruth(arm, geometry, tuple((e, draw_effect(e, arm, rng)) for e in chosen))


def draw_effect(effect: str, arm: Arm, rng: np.random.Generator) -> Parameters:
    """Parameters at the sizes of this arm."""
    n, large = arm.chain.n, arm.name.startswith("kr")
    p = EFFECTS[effect].draw(rng)
    if effect == "joint_torsion":
        return {"compliance": arm.soft.tolist()}
    if effect == "link_bending":
        return {"compliance": (arm.soft[:, None] * _log(rng, 0.05, 0.5, (n, 2))).tolist()}
    if effect == "base_compliance":  # a column, a trolley, a table: a thousandth of a radian under its own arm
        turn = (1e-8, 8e-8) if large else (1e-6, 2e-5)
        return {"per_translation": list(_log(rng, *((3e-9, 2e-8) if large else (1e-8, 2e-7)), 3)),
                "per_rotation": list(_log(rng, *turn, 3))}  # fmt: skip
    if effect == "tool_compliance":  # a tool changer or a sensor under its payload
        turn = (3e-7, 3e-6) if large else (1e-5, 3e-4)
        return {"per_translation": list(_log(rng, *((1e-8, 1e-7) if large else (1e-7, 1e-6)), 3)),
                "per_rotation": list(_log(rng, *turn, 3))}  # fmt: skip
    if effect == "external_force":  # a dress pack hangs on the arm all the time
        scale = 1.0 if large else 0.4
        return p | {"tension": float(_log(rng, 100.0, 600.0) if large else _log(rng, 10.0, 60.0)), "reach": scale * p["reach"],
                    "anchor": [scale * x for x in p["anchor"]], "attach": [scale * x for x in p["attach"]]}  # fmt: skip
    if effect == "encoder_harmonics":
        size = float(_log(rng, 2e-5, 3e-4)) * (0.3 if large else 1.0)
        waves = rng.normal(0.0, 1.0, (2, 2, n)) * np.array([1.0, 0.5])[None, :, None] * size
        return {"sin": waves[0].tolist(), "cos": waves[1].tolist()}
    if effect == "joint_backlash":
        joint = int(rng.integers(2, n))
        return p | {"joint": joint, "width": float(_log(rng, 1e-4, 6e-4)) * (0.4 if large else 1.0),
                    "torque": float(0.05 * arm.torque[joint - 1])}  # fmt: skip
    if effect == "joint_hysteresis":
        return p | {"per_joint": list(_log(rng, 0.2, 1.5, n)), "release": np.inf, "unrelaxed": float(rng.uniform(0.5, 1.0)),
                    "form": "sliders"}  # fmt: skip
    if effect == "joint_settling":
        values = np.zeros(n)
        values[rng.choice(n - 1, size=int(rng.integers(1, 3)), replace=False)] = _log(rng, 2e-5, 4e-4)
        return {"per_joint": values.tolist()}
    if effect == "thermal_drift":
        size = _log(rng, 3e-5, 3e-4)
        return {"velocity": [size / 900.0 * v for v in direction(rng)], "kind": "warm_up"}
    if effect == "joint_stiffening":
        joint = int(rng.integers(2, 4))
        return p | {"joint": joint, "share": float(_log(rng, 0.3, 2.0))}
    if effect == "station_shift":
        return p | {"size": float(_log(rng, 5e-5, 3e-4))}
    return p
