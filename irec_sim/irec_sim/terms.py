# SPDX-License-Identifier: Apache-2.0
"""Further deformation outside the catalogue: smooth functions of one or two variables of a row, at any spring of the arm.

A term is put at one elastic coordinate. Either it adds an angle (or way) of its own, or it changes the compliance there. Its
size is a sum of a few waves over its variables, with frequencies so low that it is smooth over the range of a session.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .kinematics import Array

# what a variable changes by in a session, about; a wave of frequency 1 turns by a radian over it
WIDTHS = {
    "joint": 0.5, "tau": 800.0, "wrist_tau": 200.0, "force_x": 250.0, "force_y": 250.0, "force_z": 1000.0, "side": 250.0,
    "moment": 1500.0, "stamp": 500.0, "temp": 5.0, "lag": 3.0, "ext": 0.7,
}  # fmt: skip
_SOFTEST, _STIFFEST = 4.0, 0.15  # factors of a compliance that no term goes beyond


def width_of(variable: str) -> float:
    """Scale of a variable by its name: joint_k, tau_k, force_x .. z, side (lateral force), stamp, temp_*, ext_rail."""
    if variable.startswith("tau_"):
        return WIDTHS["wrist_tau" if int(variable[4:]) > 3 else "tau"]
    return WIDTHS.get(variable) or WIDTHS[variable.split("_")[0]]


@dataclass(frozen=True)
class Term:
    """One smooth cause.

    Attributes:
        place: `axial`, `across` (of `joint`, `index` 0 or 1), `tool` or `base` (`index` 0 .. 5: translations, rotations).
        softens: changes the compliance of that spring instead of adding an angle.
        variables: one or two names; a variable that the cell does not know counts as 0.
        size: of each wave, rad, m or share; frequency: (waves, variables); phase: (waves,).
        product: waves of the two variables are multiplied, not added up inside.
        even: minus its value where the first variable is zero, so that nothing happens without load.
    """

    place: str
    joint: int
    index: int
    softens: bool
    variables: tuple[str, ...]
    size: Array
    frequency: Array
    phase: Array
    product: bool = False

    def value(self, read: Callable[[str], Array]) -> Array:
        """Its size in each row, (n,); `read` gives a variable by name."""
        u = [read(v) / width_of(v) for v in self.variables]
        total = np.zeros_like(u[0])
        for size, frequency, phase in zip(self.size, self.frequency, self.phase, strict=True):
            if self.product:
                total = total + size * np.prod([np.sin(f * x + phase) for f, x in zip(frequency, u, strict=True)], axis=0)
            else:
                total = total + size * np.sin(sum(f * x for f, x in zip(frequency, u, strict=True)) + phase)
        return total


def factor_of(change: Array) -> Array:
    """Factor of a compliance for a relative change, kept physical: about 1 + change where that is small."""
    return np.clip(1.0 + change, _STIFFEST, _SOFTEST)


def draw_waves(rng: np.random.Generator, variables: int, waves: int = 3) -> dict[str, Any]:
    """Sizes of sum of squares one, frequencies and phases."""
    size = rng.standard_normal(waves)
    return {
        "size": (size / np.linalg.norm(size)).tolist(),
        "frequency": (rng.choice([-1, 1], (waves, variables)) * rng.uniform(0.5, 1.8, (waves, variables))).tolist(),
        "phase": rng.uniform(-np.pi, np.pi, waves).tolist(),
    }
