# SPDX-License-Identifier: Apache-2.0
"""Effects that the catalogue does not name: a tool that meets one has to say that it can't explain it."""

from __future__ import annotations

import numpy as np

from .truth_catalogue import TruthEffect, direction, plant_effect


def _pair(rng: np.random.Generator) -> tuple[int, int]:
    affected = int(rng.choice([1, 2, 3]))
    return affected, int(rng.choice([j for j in (3, 4, 5) if j != affected]))


def _neighbour(n: int, joint: int, angle_of: int, value: float) -> np.ndarray:
    out = np.zeros((n, n))
    out[joint - 1, angle_of - 1] = value
    return out


OUTSIDE: dict[str, TruthEffect] = {
    # oil and grease soften a gear as it warms up
    "gear_heat": plant_effect(
        lambda rng: {"joint": int(rng.choice([1, 2, 3])), "per_kelvin": float(rng.choice([-1, 1]) * 0.02)},
        lambda plant, p, s: {"gear_heat": plant.gear_heat + s * p["per_kelvin"] * np.eye(6)[p["joint"] - 1]},
    ),
    # a gear whose stiffness varies with the angle of another axis (dress pack that twists, bearing seat that warps)
    "neighbour_angle": plant_effect(
        lambda rng: dict(zip(("joint", "angle_of"), _pair(rng), strict=True)) | {"share": 0.3},
        lambda plant, p, s: {"neighbour": plant.neighbour + _neighbour(6, p["joint"], p["angle_of"], s * p["share"])},
    ),
    # the tool slides up its taper under a side load, whichever side it comes from
    "taper": plant_effect(
        lambda rng: {"per_newton_squared": float(rng.choice([-1, 1]) * 5e-10)},
        lambda plant, p, s: {"taper": s * p["per_newton_squared"]},
    ),
    # two gears in one housing that deform each other: the angle goes with the product of their torques
    "torque_product": plant_effect(
        lambda rng: (
            dict(zip(("joint", "torque_of"), _pair(rng), strict=True)) | {"per_square": float(rng.choice([-1, 1]) * 2e-10)}
        ),
        lambda plant, p, s: {
            "torque_product": plant.torque_product + _neighbour(6, p["joint"], p["torque_of"], s * p["per_square"])
        },
    ),
    # the disc does not bear at its centre: the process force acts beside the TCP
    "contact_offset": plant_effect(
        lambda rng: {"offset": list(0.02 * np.array([1, 1, 0]) * direction(rng))},
        lambda plant, p, s: {"contact_offset": s * np.array(p["offset"])},
    ),
    # bolts of the tool's flange that have lost their preload: it rocks to one side more easily than to the other
    "flange_gap": plant_effect(
        lambda rng: {"opening": list(rng.uniform(0.7, 1.3, 2) * 2e-6)},
        lambda plant, p, s: {"flange_gap": s * np.array(p["opening"])},
    ),
}
