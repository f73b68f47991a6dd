# SPDX-License-Identifier: Apache-2.0
"""Deviation along a loaded course, from the table that the simulated cell writes: where the TCP was against where it belongs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PRESSED = 0.5  # share of the largest force from which a sample counts: standing at either end the force comes and goes


@dataclass(frozen=True)
class Course:
    """One drive along the course.

    Attributes:
        way: along the course, (n,), m.
        lateral: across the course, along the surface, (n,), m.
        total: norm of the whole deviation, (n,), m.
    """

    way: Array
    lateral: Array
    total: Array


def read_course(path: Path) -> Course:
    """Read the table of one drive; samples without process force are left out.

    Raises:
        ValueError: a column is missing or nothing was driven.
    """
    table = np.genfromtxt(path, delimiter=",", names=True)
    needed = {"s", "deviation_along", "deviation_lateral", "deviation_normal", "force_x", "force_y", "force_z"}
    missing = needed - set(table.dtype.names or ())
    if missing or table.size < 2:
        raise ValueError(f"{path}: no course in it (missing: {', '.join(sorted(missing)) or 'samples'})")
    force = np.sqrt(sum(table[f"force_{a}"] ** 2 for a in "xyz"))
    pressed = force >= PRESSED * force.max()
    deviation = np.stack([table[f"deviation_{d}"] for d in ("along", "lateral", "normal")], axis=1)
    return Course(table["s"][pressed], deviation[pressed, 1], np.linalg.norm(deviation[pressed], axis=1))


def figures_mm(deviation: Array) -> dict[str, float]:
    """Mean, maximum and standard deviation of the absolute value, mm."""
    size = 1e3 * np.abs(deviation)
    return {"mean": float(size.mean()), "max": float(size.max()), "std": float(size.std())}


def reduction_percent(without: dict[str, float], corrected: dict[str, float]) -> dict[str, float]:
    """By how much each figure has become smaller, %."""
    return {key: 100.0 * (1.0 - corrected[key] / without[key]) for key in without}
