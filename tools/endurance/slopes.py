# SPDX-License-Identifier: Apache-2.0
"""What a process holds over time, and how that grows: a slope with its confidence interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import t as student

BLOCKS = 12  # neighbouring samples depend on each other; the means of blocks hardly do
SETTLED = 0.5  # of the samples at the end: what a process needs once is there by then


@dataclass(frozen=True)
class Sample:
    """Hours since the beginning; resident memory, kB; open handles; threads."""

    hours: float
    memory_kB: float
    handles: int
    threads: int


def sample(hours: float, pid: int | str = "self") -> Sample:
    """What a process holds now."""
    root = Path(f"/proc/{pid}")
    status = dict(line.split(":", 1) for line in (root / "status").read_text().splitlines() if ":" in line)
    return Sample(
        hours, float(status["VmRSS"].split()[0]), len(list((root / "fd").iterdir())), int(status["Threads"])
    )


@dataclass(frozen=True)
class Slope:
    """Growth per hour with the ends of its 95 % confidence interval."""

    per_hour: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.per_hour:+.3g} per h ({self.low:+.3g} .. {self.high:+.3g})"


def slope_of(hours: Sequence[float], values: Sequence[float]) -> Slope:
    """Straight line through the means of blocks of the second half of the samples."""
    begin = int(len(hours) * SETTLED)
    x, y = np.asarray(hours, dtype=float)[begin:], np.asarray(values, dtype=float)[begin:]
    blocks = min(BLOCKS, len(x) // 2)
    if blocks < 4:
        return Slope(math.nan, -math.inf, math.inf)
    bx = np.array([b.mean() for b in np.array_split(x, blocks)])
    by = np.array([b.mean() for b in np.array_split(y, blocks)])
    centred = bx - bx.mean()
    s = float(centred @ by / (centred @ centred))
    rest = by - by.mean() - s * centred
    error = math.sqrt(float(rest @ rest) / (blocks - 2) / float(centred @ centred))
    half = float(student.ppf(0.975, blocks - 2)) * error
    return Slope(s, s - half, s + half)


def slopes(samples: Sequence[Sample]) -> dict[str, Slope]:
    """Of memory, handles and threads."""
    x = [s.hours for s in samples]
    return {
        "memory_kB": slope_of(x, [s.memory_kB for s in samples]),
        "handles": slope_of(x, [float(s.handles) for s in samples]),
        "threads": slope_of(x, [float(s.threads) for s in samples]),
    }


def grows(found: dict[str, Slope], limits: dict[str, float]) -> list[str]:
    """What certainly grows by more than its limit per hour: the whole interval lies above it."""
    return [f"{name} grows by {found[name]}, limit {limit:g}" for name, limit in limits.items() if found[name].low > limit]
