# SPDX-License-Identifier: Apache-2.0
"""How each effect of the catalogue is put into the simulated physics.

An effect draws its parameters from a random generator and changes the physics by a scale. Joints count from 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .kinematics import Array
from .laws import GearCurve
from .parameters import Balancer, Hose, PlantParameters
from .sensing import SensingParameters

Parameters = dict[str, Any]


@dataclass(frozen=True)
class Physics:
    """Parameters of plant and instruments."""

    plant: PlantParameters
    sensing: SensingParameters


@dataclass(frozen=True)
class TruthEffect:
    """draw: parameters from a generator; apply: physics changed by the effect at a scale of its magnitude.

    fixed: parameters that say where or what, not how much.
    variables: what an effect depends on, as columns of a session, `tau_k` or `load_case`, for those outside the catalogue.
    """

    draw: Callable[[np.random.Generator], Parameters]
    apply: Callable[[Physics, Parameters, float], Physics]
    fixed: tuple[str, ...] = ()
    variables: Callable[[Parameters], list[str]] = lambda p: []


def direction(rng: np.random.Generator) -> list[float]:
    """A random unit vector."""
    v = rng.standard_normal(3)
    return list(v / np.linalg.norm(v))


def plant_effect(
    draw: Callable[[np.random.Generator], Parameters],
    change: Callable[[PlantParameters, Parameters, float], Parameters],
    variables: Callable[[Parameters], list[str]] = lambda p: [],
) -> TruthEffect:
    """An effect that changes fields of the plant."""
    return TruthEffect(
        draw,
        lambda physics, p, s: replace(physics, plant=replace(physics.plant, **change(physics.plant, p, s))),
        variables=variables,
    )


def sensing_effect(
    draw: Callable[[np.random.Generator], Parameters],
    change: Callable[[SensingParameters, Parameters, float], Parameters],
    variables: Callable[[Parameters], list[str]] = lambda p: [],
) -> TruthEffect:
    """An effect that changes fields of the instruments."""
    return TruthEffect(
        draw,
        lambda physics, p, s: replace(physics, sensing=replace(physics.sensing, **change(physics.sensing, p, s))),
        variables=variables,
    )


def at_joint(values: Array, joint: int, value: float) -> Array:
    """values (n,) with `value` added at a joint that counts from 1."""
    out = values.copy()
    out[joint - 1] += value
    return out


def _some_joint(rng: np.random.Generator, joints: tuple[int, ...] = (1, 2, 3, 4, 5)) -> int:
    return int(rng.choice(joints))


def _spring(rng: np.random.Generator) -> Parameters:
    return {"per_translation": list(rng.uniform(0.5, 1.5, 3) * 2e-8), "per_rotation": list(rng.uniform(0.5, 1.5, 3) * 1e-7)}


def _base(rng: np.random.Generator) -> Parameters:
    return {"per_translation": list(rng.uniform(0.5, 1.5, 3) * 3e-9), "per_rotation": list(rng.uniform(0.5, 1.5, 3) * 2.5e-8)}


def _six(p: Parameters, s: float) -> Array:
    return s * np.array([*p["per_translation"], *p["per_rotation"]])


def _weighted(rng: np.random.Generator, size: float) -> Parameters:
    """Magnitudes on one or two joints."""
    values = np.zeros(6)
    joints = rng.choice(5, size=int(rng.integers(1, 3)), replace=False)
    values[joints] = size * rng.uniform(0.7, 1.3, len(joints)) * np.array([1, 1, 1, 2, 2])[joints]
    return {"per_joint": list(values)}


def _coupling(rng: np.random.Generator) -> Parameters:
    return {
        "c_45": float(rng.choice([-1, 1]) * rng.uniform(0.5, 1) * 4e-7),
        "c_56": float(rng.choice([-1, 1]) * rng.uniform(0.5, 1) * 4e-7),
    }


def _couple(plant: PlantParameters, p: Parameters, s: float) -> Parameters:
    C = plant.coupling.copy()
    C[3, 4] = C[4, 3] = C[3, 4] + s * p["c_45"]
    C[4, 5] = C[5, 4] = C[4, 5] + s * p["c_56"]
    return {"coupling": C}


def _draw_hysteresis(rng: np.random.Generator) -> Parameters:
    return {
        "per_joint": list(rng.uniform(0.1, 0.3, 6)), "form": str(rng.choice(["sliders", "presliding"])),
        "presliding": float(rng.uniform(2.0, 8.0)), "unrelaxed": float(rng.uniform(0.0, 0.6)),
        "release": float(np.exp(rng.uniform(np.log(1e-3), np.log(2e-2)))),
    }  # fmt: skip


def _hysteresis(plant: PlantParameters, p: Parameters, s: float) -> Parameters:
    """Part of each gear's compliance comes to lie behind friction, so that the arm is not much softer but remembers."""
    share = np.minimum(s * np.array(p["per_joint"]), 2.0)
    return {
        "friction": plant.friction + share / np.maximum(1.0 - 0.4 * share, 0.2),
        "axial": plant.axial * np.maximum(1.0 - 0.4 * share, 0.2),
        "friction_form": p["form"], "presliding": p["presliding"], "unrelaxed": p["unrelaxed"], "release": p["release"],
    }  # fmt: skip


_FULL_TORQUE = np.array([250.0, 300.0, 220.0, 80.0, 80.0, 50.0])  # N m, about 3-5 % of what the gears are rated for


def _draw_curve(rng: np.random.Generator) -> Parameters:
    """A soft zone in four steps, as tables of gears show it."""
    return {
        "joint": _some_joint(rng), "share": 1.0, "torque": list(np.cumsum(rng.uniform(0.3, 1.4, 4))),
        "fall": list(np.sort(rng.uniform(0.05, 1.0, 3))[::-1]),
    }  # fmt: skip


def _curve(plant: PlantParameters, p: Parameters, s: float) -> Parameters:
    """Table of one gear with the same further angle at large torque, share * compliance * soft zone, whatever its course."""
    k = p["joint"] - 1
    torque = np.r_[0.0, p["torque"]] * _FULL_TORQUE[k]
    course = np.r_[1.0, p["fall"], 0.0]
    area = float((0.5 * (course[1:] + course[:-1]) * np.diff(torque)).sum())
    top = s * p["share"] * plant.axial[k] * _FULL_TORQUE[k] / area
    return {"curves": (*plant.curves, GearCurve(p["joint"], torque, top * course))}


def _draw_play(rng: np.random.Generator) -> Parameters:
    joint = _some_joint(rng, (1, 3, 4, 5))
    full = {1: 150.0, 3: 120.0, 4: 40.0, 5: 40.0}[joint]
    return {
        "joint": joint, "width": 1e-4, "torque": float(full * np.exp(rng.uniform(np.log(0.15), np.log(1.5)))),
        "sharpness": float(rng.uniform(1.5, 6.0)),
    }  # fmt: skip


def _play(plant: PlantParameters, p: Parameters, s: float) -> Parameters:
    torque = plant.backlash_torque.copy()
    torque[p["joint"] - 1] = p["torque"]
    return {
        "backlash": at_joint(plant.backlash, p["joint"], s * p["width"] / 2), "backlash_torque": torque,
        "backlash_sharpness": p["sharpness"],
    }  # fmt: skip


def _draw_creep(rng: np.random.Generator) -> Parameters:
    weight = rng.uniform(0.2, 1.0, 3)
    return {
        "per_joint": list(rng.uniform(0.5, 1.5, 6) * 0.2), "time": float(rng.uniform(5.0, 25.0)),
        "spread": float(rng.uniform(1.5, 6.0)), "weights": list(weight / weight.sum()),
    }  # fmt: skip


def _creep(plant: PlantParameters, p: Parameters, s: float) -> Parameters:
    """Three Maxwell branches per gear, one faster and one slower than the middle one."""
    times = p["time"] * np.array([1.0 / p["spread"], 1.0, p["spread"]])
    return {"creep": plant.creep + s * np.array(p["per_joint"]), "creep_times": times, "creep_weights": np.array(p["weights"])}


def _draw_rail(rng: np.random.Generator) -> Parameters:
    return {
        **_base(rng), "floor": float(rng.uniform(0.05, 0.3)), "place": float(rng.uniform(-1.2, 1.2)),
        "width": float(rng.uniform(0.3, 0.9)),
    }  # fmt: skip


def _draw_hose(rng: np.random.Generator) -> Parameters:
    """Fixed on the floor or a frame beside the cell, or on the forearm."""
    on_arm = bool(rng.random() < 0.5)
    attach = 0.15 * np.array(direction(rng))
    if on_arm:
        anchor, reach, link = rng.uniform([-0.4, -0.3, -0.3], [0.6, 0.3, 0.3]), 1.2, 3
    else:
        anchor, reach, link = rng.uniform([-0.5, -2.0, 0.0], [2.5, 2.0, 3.5]), 2.0, 0
    return {
        "attach": list(attach), "anchor": list(anchor), "link": link, "tension": 50.0, "reach": reach,
        "stretch": float(rng.uniform(0.4, 2.0)), "wrist": list(rng.uniform(-0.4, 0.4, 2)),
    }  # fmt: skip


def _hose(plant: PlantParameters, p: Parameters, s: float) -> Parameters:
    return {
        "hose": Hose(np.array(p["attach"]), np.array(p["anchor"]), p["link"], s * p["tension"], p["reach"], p["stretch"],
                     np.array(p["wrist"]))
    }  # fmt: skip


def _traceless(rng: np.random.Generator) -> Parameters:
    E = rng.standard_normal((3, 3))
    E -= np.eye(3) * np.trace(E) / 3
    return {"matrix": (0.05 * E / np.linalg.norm(E)).tolist()}


def _station_shift(sensing: SensingParameters, p: Parameters, s: float) -> Parameters:
    return {
        "station_shift": s * p["size"] * np.array(p["direction"]),
        "shift_time": p["time"],
        "shift_share": p["share"],
        "shift_station": p["station"],
    }


def _geometry(rng: np.random.Generator) -> Parameters:
    return {
        "joint_zero": list(rng.standard_normal(6) * 2e-4), "translation": (rng.standard_normal((6, 3)) * 3e-4).tolist(),
        "turn": (rng.standard_normal((6, 3)) * 1e-4).tolist(),
    }  # fmt: skip


def _harmonics(rng: np.random.Generator) -> Parameters:
    return {
        "sin": (rng.standard_normal((2, 6)) * [[3e-5], [1.5e-5]]).tolist(),
        "cos": (rng.standard_normal((2, 6)) * [[3e-5], [1.5e-5]]).tolist(),
    }


CATALOGUE: dict[str, TruthEffect] = {
    "tool_compliance": plant_effect(_spring, lambda plant, p, s: {"tool": plant.tool + _six(p, s)}),
    "base_compliance": plant_effect(_base, lambda plant, p, s: {"base": plant.base + _six(p, s)}),
    "rail_compliance": plant_effect(
        _draw_rail,
        lambda plant, p, s: {
            "rail": plant.rail + _six(p, s),
            "rail_floor": p["floor"],
            "rail_place": p["place"],
            "rail_width": p["width"],
        },
    ),
    "joint_stiffening": plant_effect(_draw_curve, _curve),
    "joint_backlash": plant_effect(_draw_play, _play),
    "joint_hysteresis": plant_effect(_draw_hysteresis, _hysteresis),
    "counterbalance": plant_effect(
        lambda rng: {"stiffness": float(rng.uniform(0.6, 1.4) * 2.5e7), "angle": float(rng.uniform(-2.9, -2.2))},
        lambda plant, p, s: {"balancer": Balancer(stiffness=s * p["stiffness"], angle=p["angle"])},
    ),
    "joint_coupling": plant_effect(_coupling, _couple),
    "creep": plant_effect(_draw_creep, _creep),
    "external_force": plant_effect(_draw_hose, _hose),
    "geometry_error": plant_effect(
        _geometry,
        lambda plant, p, s: {
            "joint_zero": s * np.array(p["joint_zero"]),
            "p_error": s * np.array(p["translation"]),
            "turn_error": s * np.array(p["turn"]),
        },
    ),
    "sensor_gain": sensing_effect(_traceless, lambda sensing, p, s: {"sensor_matrix": s * np.array(p["matrix"])}),
    "sensor_alignment": sensing_effect(
        lambda rng: {"angle": float(rng.choice([-1, 1]) * 0.03)}, lambda sensing, p, s: {"sensor_turn": s * p["angle"]}
    ),
    "tool_weight": sensing_effect(
        lambda rng: {"mass": float(rng.choice([-1, 1]) * rng.uniform(3, 6))},
        lambda sensing, p, s: {"weight_error": s * p["mass"]},
    ),
    "station_registration": sensing_effect(
        lambda rng: {"turn": list(5e-3 * np.array(direction(rng)))},
        lambda sensing, p, s: {"station_turn": s * np.array([p["turn"]])},
    ),
    "tracker_scale": sensing_effect(
        lambda rng: {"scale": float(rng.choice([-1, 1]) * 5e-3)}, lambda sensing, p, s: {"tracker_scale": s * p["scale"]}
    ),
    "station_shift": sensing_effect(
        lambda rng: {
            "direction": direction(rng),
            "size": 1e-4,
            "share": float(rng.uniform(0.25, 0.75)),
            "time": 120.0,
            "station": 0,
        },
        _station_shift,
    ),
    "thermal_drift": sensing_effect(
        lambda rng: {
            "velocity": list(1e-6 * np.array(direction(rng))),
            "kind": str(rng.choice(["linear", "warm_up", "ambient"])),
        },
        lambda sensing, p, s: {
            "drift": s * np.array(p["velocity"]) * {"linear": 1.0, "warm_up": 900.0, "ambient": 100.0}[p["kind"]],
            "drift_kind": p["kind"],
        },
    ),
    "marker_offset": sensing_effect(
        lambda rng: {"offset": list(0.02 * np.array(direction(rng)))},
        lambda sensing, p, s: {"marker_error": s * np.array(p["offset"])},
    ),
    "joint_settling": sensing_effect(
        lambda rng: _weighted(rng, 1e-3), lambda sensing, p, s: {"settle": sensing.settle + s * np.array(p["per_joint"])}
    ),
    "encoder_harmonics": sensing_effect(
        _harmonics, lambda sensing, p, s: {"encoder_sin": s * np.array(p["sin"]), "encoder_cos": s * np.array(p["cos"])}
    ),
}
