# SPDX-License-Identifier: Apache-2.0
"""Effects that the catalogue does not name: a tool that meets one has to say that it can't explain it."""

from __future__ import annotations

import numpy as np

from .truth_catalogue import TruthEffect, direction, plant_effect, sensing_effect


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
    # a sensor or coupling plate that bulges: deflection with the square of the force
    "membrane": plant_effect(
        lambda rng: {"per_newton_squared": list(rng.uniform(0.5, 1.5, 3) * np.array([1e-9, 1e-9, 3e-11]))},
        lambda plant, p, s: {"membrane": s * np.array(p["per_newton_squared"])},
    ),
    # light bends in air that is warmer above: grows with the square of the distance and with ambient temperature
    "refraction": sensing_effect(
        lambda rng: {"coefficient": float(rng.choice([-1, 1]) * 5e-6)}, lambda sensing, p, s: {"refraction": s * p["coefficient"]}
    ),
    # the disc does not bear at its centre: the process force acts beside the TCP
    "contact_offset": plant_effect(
        lambda rng: {"offset": list(0.01 * np.array([1, 1, 0]) * direction(rng))},
        lambda plant, p, s: {"contact_offset": s * np.array(p["offset"])},
    ),
    # bolts of the tool's flange give way under pressure: rocking compliance grows with the normal force
    "flange_gap": plant_effect(
        lambda rng: {"rocking": list(rng.uniform(0.7, 1.3, 2) * 1e-7), "per_newton": 2e-3},
        lambda plant, p, s: {
            "tool": plant.tool + np.array([0, 0, 0, *(s * np.array(p["rocking"])), 0]),
            "flange_gap": p["per_newton"],
        },
    ),
}
