# SPDX-License-Identifier: Apache-2.0
"""Causes that the catalogue does not name: a tool that meets one has to say that it can't explain it.

Most are sentences of a small grammar: a place (about an axis, across it, at the tool, under the base), a way to act (an angle
of its own, or a change of the compliance there), and a smooth random function of one or two variables. The others are single
pieces of physics: sensors with memory, play in bearings, tapers, flanges.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .kinematics import Array
from .terms import Term, draw_waves
from .truth_catalogue import Parameters, TruthEffect, direction, plant_effect, sensing_effect

_SIZE = {"axial": 1e-4, "across": 4e-5, "tool": 1e-4, "base": 3e-5}  # rad or m, of an angle (way) of its own
_TRANSLATION = 0.3  # m per rad


def _pair(rng: np.random.Generator) -> tuple[int, int]:
    affected = int(rng.choice([1, 2, 3]))
    return affected, int(rng.choice([j for j in (3, 4, 5) if j != affected]))


def _neighbour(n: int, joint: int, angle_of: int, value: float) -> np.ndarray:
    out = np.zeros((n, n))
    out[joint - 1, angle_of - 1] = value
    return out


# -- grammar ------------------------------------------------------------------------------------------------------------


def _place(rng: np.random.Generator, places: tuple[str, ...]) -> Parameters:
    place = str(rng.choice(places))
    joint = int(rng.integers(1, 6)) if place in ("axial", "across") else 0
    index = int(rng.integers(2)) if place == "across" else int(rng.integers(6)) if place in ("tool", "base") else 0
    return {"place": place, "joint": joint, "index": index}


def _angles(rng: np.random.Generator, p: Parameters) -> list[str]:
    return [f"joint_{k}" for k in (2, 3, 4, 5) if k != p["joint"]]


def _forces(rng: np.random.Generator, p: Parameters) -> list[str]:
    return ["force_x", "force_y", "side"]


def _torques(rng: np.random.Generator, p: Parameters) -> list[str]:
    return [f"tau_{k}" for k in (1, 3, 4, 5) if k != p["joint"]]


Source = Callable[[np.random.Generator, Parameters], list[str]]


def _sentence(places: tuple[str, ...], softens: bool, *sources: Source, product: bool = False, but: int = 0) -> TruthEffect:
    """A kind of sentence: possible places, whether a compliance changes, one source of variables for each of the function's.

    Args:
        but: a joint of which the catalogue has such an effect; the next one has it instead.
    """

    def draw(rng: np.random.Generator) -> Parameters:
        p = _place(rng, places)
        if but and p["joint"] == but:
            p["joint"] += 1
        chosen: list[str] = []
        for source in sources:
            chosen.append(str(rng.choice([v for v in source(rng, p) if v not in chosen])))
        p |= {"variables": chosen, **draw_waves(rng, len(chosen))}
        slides = p["place"] in ("tool", "base") and p["index"] < 3
        size = 0.5 if softens else _SIZE[p["place"]] * (_TRANSLATION if slides else 1.0)
        p["size"] = (size * np.array(p["size"])).tolist()
        return p

    def change(plant: Any, p: Parameters, s: float) -> Parameters:
        term = Term(
            p["place"], p["joint"], p["index"], softens, tuple(p["variables"]), s * np.array(p["size"]), np.array(p["frequency"]),
            np.array(p["phase"]), product,
        )  # fmt: skip
        return {"terms": (*plant.terms, term)}

    effect = plant_effect(draw, change, _variables)
    return TruthEffect(effect.draw, effect.apply, ("frequency", "phase"), _variables)


def _variables(p: Parameters) -> list[str]:
    """Columns that show the variables of a sentence; forces show in the load case too, lagged temperatures in their own."""
    out: list[str] = []
    for v in p["variables"]:
        if v.startswith("lag_"):
            out += ["temp_" + v[4:], "stamp"]
        elif v == "side":
            out += ["force_x", "force_y", "load_case"]
        else:
            out += [v, *(["load_case"] if v.startswith("force_") else [])]
    return out


def _own_angle(rng: np.random.Generator, p: Parameters) -> list[str]:
    return [f"joint_{p['joint']}"]


def _gears_late(rng: np.random.Generator, p: Parameters) -> list[str]:
    return [f"lag_gear_{p['joint']}"] if p["joint"] else ["lag_ambient"]


def _time_or_heat(rng: np.random.Generator, p: Parameters) -> list[str]:
    return ["stamp", "temp_ambient", *([f"temp_gear_{p['joint']}"] if p["joint"] else [])]


_JOINTS, _ANY = ("axial", "across"), ("axial", "across", "tool", "base")

GRAMMAR: dict[str, TruthEffect] = {
    # a deformation that is no spring: bolted seams, cables that stiffen, seats that slip back
    "smooth_of_a_force": _sentence(_ANY, False, _forces),
    "smooth_of_two_forces": _sentence(("axial", "across", "tool"), False, _forces, _forces),
    "smooth_of_another_torque": _sentence(_JOINTS, False, _torques),
    "force_times_angle": _sentence(_JOINTS, False, _forces, _angles, product=True),
    "torque_times_angle": _sentence(_JOINTS, False, _torques, _angles, product=True),
    # stiffness that is no constant: cast links of varying section, gears with eccentric stages, preloads that come and go
    "stiffness_of_another_angle": _sentence(_JOINTS, True, _angles),
    "stiffness_of_own_angle": _sentence(("axial",), True, _own_angle, but=2),  # that of axis 2 is `counterbalance`
    "stiffness_of_two_angles": _sentence(_JOINTS, True, _angles, _angles),
    "stiffness_of_time_or_heat": _sentence(_JOINTS, True, _time_or_heat),
    "stiffness_late_after_heat": _sentence(_JOINTS, True, _gears_late),
    "stiffness_of_a_force": _sentence(_JOINTS, True, _forces),
    "stiffness_of_force_times_angle": _sentence(_JOINTS, True, _forces, _angles, product=True),
}

# -- single pieces of physics -------------------------------------------------------------------------------------------


def _gap(plant: Any, p: Parameters, s: float) -> Parameters:
    gap: Array = plant.bearing_gap.copy()
    gap[p["joint"] - 1, p["side"]] += s * p["width"]
    return {"bearing_gap": gap}


PIECES: dict[str, TruthEffect] = {
    # oil and grease soften a gear as it warms up
    "gear_heat": plant_effect(
        lambda rng: {"joint": int(rng.choice([1, 2, 3])), "per_kelvin": float(rng.choice([-1, 1]) * 0.02)},
        lambda plant, p, s: {"gear_heat": plant.gear_heat + s * p["per_kelvin"] * np.eye(6)[p["joint"] - 1]},
        lambda p: [f"temp_gear_{p['joint']}", f"tau_{p['joint']}", "stamp"],
    ),
    # a gear whose stiffness varies with the angle of another axis (dress pack that twists, bearing seat that warps)
    "neighbour_angle": plant_effect(
        lambda rng: dict(zip(("joint", "angle_of"), _pair(rng), strict=True)) | {"share": 0.3},
        lambda plant, p, s: {"neighbour": plant.neighbour + _neighbour(6, p["joint"], p["angle_of"], s * p["share"])},
        lambda p: [f"joint_{p['angle_of']}", f"tau_{p['joint']}"],
    ),
    # the tool slides up its taper under a side load, whichever side it comes from
    "taper": plant_effect(
        lambda rng: {"per_newton_squared": float(rng.choice([-1, 1]) * 5e-10)},
        lambda plant, p, s: {"taper": s * p["per_newton_squared"]},
        lambda p: ["force_x", "force_y", "load_case"],
    ),
    # two gears in one housing that deform each other: the angle goes with the product of their torques
    "torque_product": plant_effect(
        lambda rng: (
            dict(zip(("joint", "torque_of"), _pair(rng), strict=True)) | {"per_square": float(rng.choice([-1, 1]) * 2e-10)}
        ),
        lambda plant, p, s: {
            "torque_product": plant.torque_product + _neighbour(6, p["joint"], p["torque_of"], s * p["per_square"])
        },
        lambda p: [f"tau_{p['joint']}", f"tau_{p['torque_of']}"],
    ),
    # the disc does not bear at its centre: the process force acts beside the TCP
    "contact_offset": plant_effect(
        lambda rng: {"offset": list(0.02 * np.array([1, 1, 0]) * direction(rng))},
        lambda plant, p, s: {"contact_offset": s * np.array(p["offset"])},
        lambda p: ["force_z", "load_case", *(f"tau_{k}" for k in (4, 5, 6)), *(f"joint_{k}" for k in (4, 5, 6))],
    ),
    # bolts of the tool's flange that have lost their preload: it rocks to one side more easily than to the other
    "flange_gap": plant_effect(
        lambda rng: {"opening": list(rng.uniform(0.7, 1.3, 2) * 2e-6)},
        lambda plant, p, s: {"flange_gap": s * np.array(p["opening"])},
        lambda p: ["force_x", "force_y", "load_case"],
    ),
    # a worn bearing: the link tilts across its axis until the play is taken up
    "bearing_play": plant_effect(
        lambda rng: {"joint": int(rng.integers(1, 6)), "side": int(rng.integers(2)), "width": 3e-5},
        _gap,
        lambda p: [f"tau_{p['joint']}", "force_x", "force_y", "load_case"],
    ),
    # a force sensor that still reads part of the load before
    "sensor_lag": sensing_effect(
        lambda rng: {"share": 0.05}, lambda sensing, p, s: {"sensor_lag": s * p["share"]},
        lambda p: ["load_case", "force_x", "force_y", "force_z", "stamp"],
    ),
    # a force sensor with hysteresis: it reads too little after a rise and too much after a fall
    "sensor_hysteresis": sensing_effect(
        lambda rng: {"newton": 10.0}, lambda sensing, p, s: {"sensor_hysteresis": s * p["newton"]},
        lambda p: ["load_case", "force_x", "force_y", "force_z", "stamp"],
    ),
    # a force sensor whose gain falls with the load
    "sensor_bend": sensing_effect(
        lambda rng: {"per_kilonewton": float(rng.choice([-1, 1]) * 0.1)},
        lambda sensing, p, s: {"sensor_bend": s * p["per_kilonewton"]},
        lambda p: ["force_x", "force_y", "force_z", "load_case"],
    ),
    # a force sensor whose gain follows the temperature of the shop
    "sensor_heat": sensing_effect(
        lambda rng: {"per_kelvin": float(rng.choice([-1, 1]) * 0.02)},
        lambda sensing, p, s: {"sensor_heat": s * p["per_kelvin"]},
        lambda p: ["temp_ambient", "stamp", "force_z", "load_case"],
    ),
}  # fmt: skip

OUTSIDE: dict[str, TruthEffect] = {**GRAMMAR, **PIECES}
READ_BY_SENSOR = ("sensor_lag", "sensor_hysteresis", "sensor_bend", "sensor_heat")
