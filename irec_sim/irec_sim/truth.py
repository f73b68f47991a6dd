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

import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SimError
from .files import check, read_yaml
from .kinematics import Array
from .outside import OUTSIDE
from .parameters import PlantParameters
from .sensing import SensingParameters
from .sensing import per_joint as per_joint_of_sensing
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
_TWIST_AT_RATED = 2.0e-3  # rad, as those of the two classes above
_BACKGROUND_FRICTION = 0.012  # share of the compliance: mild, in no model


@dataclass(frozen=True)
class Hidden:
    """One effect of a truth: id, all its parameters, the scale of its magnitude.

    background: truly there, but too small to show: nobody is asked for it, and nobody can know its name.
    """

    effect: str
    parameters: dict[str, Any]
    scale: float = 1.0
    background: bool = False


@dataclass(frozen=True)
class Truth:
    """Compliances axial (n,), transverse (n, 2) in rad/(N m), share of background friction, hidden effects.

    centre: where the springs of `transverse` sit off the joints' origins, in the joints' frames, (n, 3), m.
    """

    axial: Array
    transverse: Array
    friction: float
    hidden: tuple[Hidden, ...]
    centre: Array

    def physics(self) -> Physics:
        """Parameters of plant and instruments with all effects applied."""
        n = len(self.axial)
        if n == 6:
            plant = PlantParameters(self.axial, self.transverse, friction=np.full(n, self.friction), centre=self.centre)
        else:
            plain = PlantParameters.plain(self.axial, self.transverse)
            plant = replace(plain, friction=np.full(n, self.friction), centre=self.centre)
        physics = Physics(plant, SensingParameters(**per_joint_of_sensing(n)))
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
            "compliance": {
                "axial": self.axial.tolist(), "transverse": self.transverse.tolist(), "centre": self.centre.tolist(),
                "spread": 0.0,
            },
            "background_friction": self.friction,
            "effects": [
                {"effect": h.effect, "scale": float(h.scale), "parameters": plain(h.parameters)}
                | ({"background": True} if h.background else {})
                for h in self.hidden
            ],
        }


def plain(value: Any) -> Any:
    """Arrays and numpy numbers as a YAML file can hold them."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def make_truth(
    cell_name: str, effects: list[str], seed: int, spread: float = 0.15, friction: float = _BACKGROUND_FRICTION,
    unequal: float = 0.0, off_centre: float = 0.0, effort: Array | None = None,
) -> Truth:  # fmt: skip
    """A truth with the named effects, all parameters drawn from the seed.

    Args:
        spread: of all compliances about the usual ones, of their logarithm; unequal: further, of the two compliances across a
            joint against each other; off_centre: m, of the springs across a joint from its origin, one standard deviation.
        effort: as in read_truth.
    """
    stated = {"spread": spread, "unequal": unequal, "off_centre": off_centre}
    data = {"compliance": stated, "background_friction": friction, "effects": [{"effect": e} for e in effects]}
    return _resolve(data, cell_name, seed, "truth", effort)


def read_truth(path: str | Path, cell_name: str, seed: int = 0, effort: Array | None = None) -> Truth:
    """Read a truth file; what it leaves open is drawn from the seed.

    Args:
        effort: rated torques of the robot, (n,), N m: compliances of a cell of no known class follow from them.

    Raises:
        SimError: not readable, wrong format, or an effect or parameter that doesn't exist.
    """
    data = read_yaml(path, "truth file")
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise SimError(f"{path}: format must be '{FORMAT}'")
    wrong = check(FORMAT, data, str(path))
    if wrong:
        raise SimError(wrong[0] + (f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""))
    return _resolve(data, cell_name, seed, str(path), effort)


def _by_effort(effort: Array) -> tuple[list[float], list[list[float]]]:
    """Compliances of a robot of no known class: a gear of given rated torque twists by some milliradians under it."""
    axial = _TWIST_AT_RATED / np.maximum(effort, 1.0)
    return axial.tolist(), [[0.12 * c, 0.2 * c] for c in axial]


def truth_problems(path: str | Path) -> list[str]:
    """Everything that is wrong in a truth file, one line each."""
    try:
        data = read_yaml(path, "truth file")
        wrong = check(FORMAT, data, str(path))
        if not wrong:
            stated = (data.get("compliance") or {}).get("axial")
            _resolve(data, "any", 0, str(path), np.full(len(stated), 1e3) if stated else None)
    except SimError as error:
        return [str(error)]
    return wrong


def _same_shape(value: Any, drawn: Any) -> bool:
    """Whether a stated parameter can stand for the one that would be drawn."""
    if isinstance(drawn, (list, tuple, np.ndarray)):
        return isinstance(value, (list, tuple)) and len(value) == len(drawn) and all(map(_same_shape, value, drawn))
    if isinstance(drawn, str):
        return isinstance(value, str)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _resolve(data: dict[str, Any], cell_name: str, seed: int, where: str, effort: Array | None = None) -> Truth:
    rng = np.random.default_rng([seed, 71])
    stated = data.get("compliance") or {}
    default = _COMPLIANCE["milling" if cell_name == "milling" else "afp"]
    if effort is not None and cell_name not in _COMPLIANCE:
        default = _by_effort(effort)
    n = len(default[0])
    spread = float(stated.get("spread", 0.0))
    axial = np.array(stated.get("axial", default[0]), dtype=float)
    transverse = np.array(stated.get("transverse", default[1]), dtype=float)
    if axial.shape != (n,) or transverse.shape != (n, 2) or min(axial.min(), transverse.min()) <= 0.0:
        raise SimError(f"{where}: compliance: axial needs {n} positive values and transverse {n} pairs of them, rad/(N m)")
    axial, transverse = axial * np.exp(spread * rng.standard_normal(n)), transverse * np.exp(spread * rng.standard_normal((n, 2)))
    apart = float(stated.get("unequal", 0.0)) * rng.standard_normal(n)
    transverse = transverse * np.exp(np.column_stack([apart, -apart]))
    centre = np.array(stated.get("centre", float(stated.get("off_centre", 0.0)) * rng.standard_normal((n, 3))), dtype=float)
    if centre.shape != (n, 3):
        raise SimError(f"{where}: compliance: centre needs {n} points, m")
    hidden = []
    for i, item in enumerate(data.get("effects") or []):
        name = item.get("effect") if isinstance(item, dict) else item
        if name not in EFFECTS:
            raise SimError(f"{where}: effects[{i}]: '{name}' is not known; there are {', '.join(EFFECTS)}")
        effect = EFFECTS[name]
        drawn = effect.draw(np.random.default_rng([seed, 72, zlib.crc32(name.encode())]))
        stated_parameters = (item.get("parameters") or {}) if isinstance(item, dict) else {}
        unknown = {str(key) for key in stated_parameters} - set(drawn)
        if unknown:
            raise SimError(
                f"{where}: effects[{i}] {name}: no parameter {', '.join(sorted(unknown))}; there are {', '.join(drawn)}"
            )
        for key, value in stated_parameters.items():
            if not _same_shape(value, drawn[key]):
                raise SimError(f"{where}: effects[{i}] {name}: {key} is {value!r}, a value like {plain(drawn[key])!r} is needed")
        scale = float(item.get("scale", 1.0)) if isinstance(item, dict) else 1.0
        background = isinstance(item, dict) and bool(item.get("background", False))
        hidden.append(Hidden(name, {**drawn, **stated_parameters}, scale, background))
    friction = float(data.get("background_friction", _BACKGROUND_FRICTION))
    truth = Truth(axial, transverse, friction, tuple(hidden), centre)
    try:
        truth.physics()
    except (IndexError, TypeError, ValueError, KeyError, OverflowError) as error:  # no such joint, half a station, 10**400
        raise SimError(f"{where}: effects: a parameter has no meaning: {error}") from error
    return truth
