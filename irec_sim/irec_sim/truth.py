# SPDX-License-Identifier: Apache-2.0
"""Truth files (irec-truth/1): which physics a simulated cell has. Only the simulator reads them.

    format: irec-truth/1
    compliance: {axial: [6 values], transverse: [[a, b], ...], spread: 0.15}    # optional
    effects:
      - {effect: joint_backlash, scale: 1.0, parameters: {joint: 3, width: 1.0e-4}}

An effect that leaves parameters out has them drawn from the seed. `scale` multiplies the effect's magnitude; the
generator finds the scale at which the effect causes a wanted share of the deflection.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .errors import SimError
from .kinematics import Array
from .outside import OUTSIDE
from .parameters import PlantParameters
from .sensing import SensingParameters
from .truth_catalogue import CATALOGUE, Physics, TruthEffect

FORMAT = "irec-truth/1"
EFFECTS: dict[str, TruthEffect] = {**CATALOGUE, **OUTSIDE}

# rad/(N m): what published identifications of robots of these classes give, gears axially, links and bearings across
_COMPLIANCE: dict[str, tuple[list[float], list[list[float]]]] = {
    "afp": (
        [2.2e-7, 2.0e-7, 2.5e-7, 1.2e-6, 1.3e-6, 2.1e-6],
        [[1.2e-8, 1.8e-8], [1.6e-8, 2.4e-8], [2.4e-8, 3.2e-8], [2.4e-7, 3.6e-7], [3.2e-7, 4.8e-7], [4.8e-7, 7.2e-7]],
    ),
    "milling": (
        [2.2e-7, 2.0e-7, 2.6e-7, 1.1e-6, 1.2e-6, 1.9e-6],
        [[1.2e-8, 2.0e-8], [1.8e-8, 2.6e-8], [2.6e-8, 3.4e-8], [2.4e-7, 3.6e-7], [3.2e-7, 4.6e-7], [5.0e-7, 7.0e-7]],
    ),
}
_BACKGROUND_FRICTION = 0.012  # share of the compliance: mild, in no model


@dataclass(frozen=True)
class Hidden:
    """One effect of a truth: id, all its parameters, and the scale of its magnitude."""

    effect: str
    parameters: dict[str, Any]
    scale: float = 1.0


@dataclass(frozen=True)
class Truth:
    """Compliances axial (n,), transverse (n, 2) in rad/(N m), share of background friction, hidden effects."""

    axial: Array
    transverse: Array
    friction: float
    hidden: tuple[Hidden, ...]

    def physics(self) -> Physics:
        """Parameters of plant and instruments with all effects applied."""
        n = len(self.axial)
        plant = PlantParameters(self.axial, self.transverse, friction=np.full(n, self.friction))
        physics = Physics(plant, SensingParameters())
        for h in self.hidden:
            physics = EFFECTS[h.effect].apply(physics, h.parameters, h.scale)
        return physics

    def scaled(self, effect: str, scale: float) -> Truth:
        """The same with the scale of one effect replaced."""
        return replace(self, hidden=tuple(replace(h, scale=scale) if h.effect == effect else h for h in self.hidden))

    def without(self, *effects: str) -> Truth:
        """The same without some hidden effects."""
        return replace(self, hidden=tuple(h for h in self.hidden if h.effect not in effects))

    def as_data(self) -> dict[str, Any]:
        """Content of a truth file."""
        return {
            "format": FORMAT,
            "compliance": {"axial": self.axial.tolist(), "transverse": self.transverse.tolist(), "spread": 0.0},
            "background_friction": self.friction,
            "effects": [{"effect": h.effect, "scale": float(h.scale), "parameters": _plain(h.parameters)} for h in self.hidden],
        }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def make_truth(
    cell_name: str, effects: list[str], seed: int, spread: float = 0.15, friction: float = _BACKGROUND_FRICTION
) -> Truth:
    """A truth with the named effects, all parameters drawn from the seed."""
    return _resolve(
        {"compliance": {"spread": spread}, "background_friction": friction, "effects": [{"effect": e} for e in effects]},
        cell_name,
        seed,
        "truth",
    )


def read_truth(path: str | Path, cell_name: str, seed: int = 0) -> Truth:
    """Read a truth file; what it leaves open is drawn from the seed.

    Raises:
        SimError: not readable, wrong format, or an effect or parameter that doesn't exist.
    """
    try:
        data = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise SimError(f"{path}: can't be read as a truth file: {error}") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise SimError(f"{path}: format must be '{FORMAT}'")
    return _resolve(data, cell_name, seed, str(path))


def _resolve(data: dict[str, Any], cell_name: str, seed: int, where: str) -> Truth:
    rng = np.random.default_rng([seed, 71])
    stated = data.get("compliance") or {}
    default = _COMPLIANCE["milling" if cell_name == "milling" else "afp"]
    spread = float(stated.get("spread", 0.0))
    axial = np.array(stated.get("axial", default[0]), dtype=float)
    transverse = np.array(stated.get("transverse", default[1]), dtype=float)
    if axial.shape != (6,) or transverse.shape != (6, 2) or min(axial.min(), transverse.min()) <= 0.0:
        raise SimError(f"{where}: compliance: axial needs 6 positive values and transverse 6 pairs of them, rad/(N m)")
    axial, transverse = axial * np.exp(spread * rng.standard_normal(6)), transverse * np.exp(spread * rng.standard_normal((6, 2)))
    hidden = []
    for i, item in enumerate(data.get("effects") or []):
        name = item.get("effect") if isinstance(item, dict) else item
        if name not in EFFECTS:
            raise SimError(f"{where}: effects[{i}]: '{name}' is not known; there are {', '.join(EFFECTS)}")
        effect = EFFECTS[name]
        drawn = effect.draw(np.random.default_rng([seed, 72, sorted(EFFECTS).index(name)]))
        stated_parameters = (item.get("parameters") or {}) if isinstance(item, dict) else {}
        unknown = set(stated_parameters) - set(drawn)
        if unknown:
            raise SimError(
                f"{where}: effects[{i}] {name}: no parameter {', '.join(sorted(unknown))}; there are {', '.join(drawn)}"
            )
        scale = float(item.get("scale", 1.0)) if isinstance(item, dict) else 1.0
        hidden.append(Hidden(name, {**drawn, **stated_parameters}, scale))
    return Truth(axial, transverse, float(data.get("background_friction", _BACKGROUND_FRICTION)), tuple(hidden))
