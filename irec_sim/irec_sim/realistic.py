# SPDX-License-Identifier: Apache-2.0
"""Effects at the sizes that real cells have, for sessions with many causes at once.

Ranges after published identifications and data sheets (stiffness of heavy robots and their pedestals, lost motion of RV and
wrist gears, thermal drift over a warm-up, crosstalk of force sensors, runs of trackers); sizes are drawn log-uniformly.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .truth_catalogue import CATALOGUE, direction

_WRIST = (4, 5, 6)
# how often a real cell has it; what never shows in a loaded session at its real size is left out
COMMON: dict[str, float] = {
    "tool_compliance": 1.0, "base_compliance": 0.7, "rail_compliance": 0.7, "joint_stiffening": 1.0, "joint_backlash": 1.0,
    "joint_hysteresis": 1.0, "counterbalance": 0.6, "joint_coupling": 0.7, "sensor_gain": 0.8, "sensor_alignment": 0.7,
    "tool_weight": 0.7, "station_shift": 0.3, "thermal_drift": 0.8, "creep": 0.8, "external_force": 0.7, "joint_settling": 0.4,
    "marker_offset": 0.3,
}  # fmt: skip


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def realistic(effect: str, rng: np.random.Generator) -> dict[str, Any]:
    """Parameters of an effect as a real cell may have them; what is not listed here is drawn as the catalogue draws it."""
    p = CATALOGUE[effect].draw(rng)
    if effect == "tool_compliance":  # tool changer and spindle 20-100 N/um, 0.3-3 Nm/urad
        p |= {"per_translation": [_log(rng, 1e-8, 5e-8) for _ in "xyz"], "per_rotation": [_log(rng, 3e-7, 3e-6) for _ in "xyz"]}
    elif effect in ("base_compliance", "rail_compliance"):  # 50-300 N/um, 10-60 urad per kN m
        p |= {"per_translation": [_log(rng, 3e-9, 2e-8) for _ in "xyz"], "per_rotation": [_log(rng, 1e-8, 6e-8) for _ in "xyz"]}
    elif effect == "joint_stiffening":  # the first torsional zone is 1.3 to 2.2 times softer
        p |= {"share": _log(rng, 0.3, 1.5)}
    elif effect == "joint_backlash":  # 0.1 to 0.5 arc minutes, wrist gears up to 1.5
        wrist = p["joint"] in _WRIST
        p |= {"width": _log(rng, 1e-4, 4.5e-4) if wrist else _log(rng, 3e-5, 1.5e-4)}
    elif effect == "joint_hysteresis":  # lost motion below an arc minute
        p |= {"per_joint": [_log(rng, 0.05, 0.4) for _ in range(6)]}
    elif effect == "counterbalance":  # changes the stiffness of axis 2 by 10-25 %
        p |= {"stiffness": _log(rng, 1e7, 6e7)}
    elif effect == "joint_coupling":  # a few to thirty per cent of the wrist's own compliance
        p |= {k: _sign(rng) * _log(rng, 0.4e-7, 4e-7) for k in ("c_45", "c_56")}
    elif effect == "sensor_gain":  # crosstalk 0.5-3 %
        E = rng.standard_normal((3, 3))
        E -= np.eye(3) * np.trace(E) / 3
        p |= {"matrix": (_log(rng, 0.01, 0.05) * E / np.linalg.norm(E)).tolist()}
    elif effect == "sensor_alignment":  # 0.2 to 2 degrees
        p |= {"angle": _sign(rng) * _log(rng, 0.004, 0.035)}
    elif effect == "tool_weight":
        p |= {"mass": _sign(rng) * _log(rng, 0.5, 8.0)}
    elif effect == "station_shift":
        p |= {"size": _log(rng, 2e-5, 2e-4)}
    elif effect == "thermal_drift":  # 0.1-0.5 mm over 1-3 hours, faster in the first minutes
        size = _log(rng, 0.03, 0.3)
        p |= {"velocity": [v * size for v in p["velocity"]]}
    elif effect == "creep":
        p |= {"per_joint": [_log(rng, 0.03, 0.2) for _ in range(6)]}
    elif effect == "external_force":  # hoses of a head pull with 10-60 N
        p |= {"tension": _log(rng, 10, 60)}
    elif effect == "joint_settling":
        p |= {"per_joint": [v * _log(rng, 0.2, 2.0) for v in p["per_joint"]]}
    elif effect == "marker_offset":
        size = _log(rng, 2e-4, 3e-3)
        p |= {"offset": [size * v for v in direction(rng)]}
    elif effect == "geometry_error":  # of a robot that was calibrated once: 0.1 mm, 0.1 mrad
        s = _log(rng, 0.2, 1.5)
        p |= {k: (s * np.array(p[k])).tolist() for k in ("joint_zero", "translation", "turn")}
    return p


def draw_causes(rng: np.random.Generator, count: int, rail: bool) -> list[str]:
    """Different causes that a cell may have together."""
    names = [e for e in COMMON if rail or e != "rail_compliance"]
    weight = np.array([COMMON[e] for e in names])
    return [str(e) for e in rng.choice(names, size=count, replace=False, p=weight / weight.sum())]
