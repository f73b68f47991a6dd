# SPDX-License-Identifier: Apache-2.0
"""Table 1 of the paper and the bands that a simulated case has to stay in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from irec_sim.production.runner import Drive


@dataclass(frozen=True)
class Figures:
    """Mean, maximum and standard deviation of the absolute error, mm; `signed`: standard deviation with its sign;
    inside: share of the
    length within the tolerance."""

    mean: float
    max: float
    std: float
    signed: float
    inside: float


@dataclass(frozen=True)
class Paper:
    """Table 1 for one case, mm and %, and the bands for its simulated counterpart."""

    title: str
    without: tuple[float, float, float]
    corrected: tuple[float, float, float]
    reduction: tuple[float, float, float]
    before_mean: tuple[float, float]
    before_max: tuple[float, float]
    mean_reduction: tuple[float, float]
    max_reduction: tuple[float, float]
    targets: tuple[float, float]
    what: str


PAPER = {
    "afp": Paper(
        "Robotized AFP processing of a 3D thermoplastic aerostructure",
        (0.570, 0.956, 0.100),
        (0.061, 0.285, 0.046),
        (89.30, 70.19, 54.00),
        (0.50, 0.65),
        (0.85, 1.05),
        (86.0, 92.0),
        (64.0, 76.0),
        (96.0, 85.0),
        "absolute value of the lateral deviation",
    ),
    "machining": Paper(
        "Robotized roughing of an Al-7075 aerospace part",
        (0.597, 2.050, 0.725),
        (0.101, 0.520, 0.342),
        (83.08, 74.63, 52.83),
        (0.50, 0.70),
        (1.80, 2.20),
        (80.0, 87.0),
        (70.0, 80.0),
        (93.0, 85.0),
        "absolute value of the on-part error",
    ),
}


def figures(drive: Drive, tolerance_m: float) -> Figures:
    """Figures of a drive over all samples that make the part and that the tracker has measured."""
    error = 1e3 * drive.error[drive.judged]
    size = np.abs(error)
    return Figures(
        float(size.mean()), float(size.max()), float(size.std()), float(error.std()), float((size <= 1e3 * tolerance_m).mean())
    )


def reduction(before: Figures, after: Figures) -> tuple[float, float, float]:
    """Of mean, maximum and standard deviation, %."""
    return tuple(100.0 * (1.0 - getattr(after, k) / getattr(before, k)) for k in ("mean", "max", "std"))  # type: ignore[return-value]


@dataclass(frozen=True)
class Drawn:
    """A figure in several draws of what is unsteady (force, noise, drift), and the real cell's band of it."""

    name: str
    unit: str
    values: tuple[float, ...]
    band: tuple[float, float]

    @property
    def mean(self) -> float:
        return float(np.mean(self.values))

    @property
    def uncertain(self) -> float:
        """Two standard errors of the mean; 0 where there is one draw."""
        n = len(self.values)
        return 2.0 * float(np.std(self.values, ddof=1)) / math.sqrt(n) if n > 1 else 0.0

    @property
    def outside(self) -> bool:
        """The mean is outside of the band by more than it is uncertain."""
        return not self.band[0] - self.uncertain <= self.mean <= self.band[1] + self.uncertain

    @property
    def short(self) -> str:
        """Mean and how uncertain it is, as far as there is more than one draw."""
        return f"{self.digits(self.mean)}{self._uncertain} {self.unit}"

    @property
    def range(self) -> str:
        """Smallest to largest."""
        return f"{self.digits(min(self.values))} to {self.digits(max(self.values))} {self.unit}"

    @property
    def told(self) -> str:
        low, high = self.band
        drawn = f" (mean of {len(self.values)} draws, {self.range})" if len(self.values) > 1 else ""
        return f"{self.name} is {self.short}{drawn}, the real cell's band is {low:g} to {high:g} {self.unit}"

    def digits(self, value: float) -> str:
        """A value as all of its kind are written."""
        return f"{value:.{3 if self.unit == 'mm' else 1}f}"

    @property
    def _uncertain(self) -> str:
        if len(self.values) < 2:
            return ""
        said = self.digits(self.uncertain)
        return f" +- {said}" if float(said) > 0.0 else f" +- less than {'0.001' if self.unit == 'mm' else '0.1'}"


def line(name: str, cells: Sequence[str]) -> str:
    """A row of a table, as Markdown."""
    return f"| {name} | {' | '.join(cells)} |"


def markdown(title: str, columns: str, rows: Sequence[str]) -> None:
    """Print a table; columns: names with ", " between, or one name where there is one column only."""
    cells = rows[0].count("|") - 2
    heads = columns.split(", ") if cells > 1 else [columns]
    print(f"\n{title}\n\n| | {' | '.join(heads)} |\n|---|{'---|' * cells}")
    print("\n".join(rows))


def in_draws(case: str, before: Sequence[Figures], after: Sequence[Figures]) -> list[Drawn]:
    """What the bands are about, of a plant without and with the paper's own 18-DOF correction; one of each per draw."""
    paper, cuts = PAPER[case], [reduction(b, a) for b, a in zip(before, after, strict=True)]
    return [
        Drawn("mean before correction", "mm", tuple(b.mean for b in before), paper.before_mean),
        Drawn("maximum before correction", "mm", tuple(b.max for b in before), paper.before_max),
        Drawn("reduction of the mean", "%", tuple(c[0] for c in cuts), paper.mean_reduction),
        Drawn("reduction of the maximum", "%", tuple(c[1] for c in cuts), paper.max_reduction),
    ]


def average(draws: Sequence[Figures]) -> Figures:
    """Mean of each figure over the draws."""
    return Figures(*(float(np.mean([getattr(f, k.name) for f in draws])) for k in fields(Figures)))


def cuts_in_draws(case: str, before: Sequence[Figures], after: Sequence[Figures]) -> tuple[Drawn, Drawn]:
    """Reduction of the mean and of the maximum in several draws, the first ones of `before`; the band is that of the target."""
    cuts = [reduction(b, a) for b, a in zip(before, after, strict=False)]
    names, targets = ("mean less by", "maximum less by"), PAPER[case].targets
    mean, largest = (Drawn(names[k], "%", tuple(c[k] for c in cuts), (targets[k], 100.0)) for k in (0, 1))
    return mean, largest


def outside_bands(case: str, before: Sequence[Figures], after: Sequence[Figures]) -> list[str]:
    """What of these draws of a plant lies outside the bands; empty where nothing does."""
    return [drawn.told for drawn in in_draws(case, before, after) if drawn.outside]
