# SPDX-License-Identifier: Apache-2.0
"""The noise of a session as it truly is, and what its header claims about it.

The standard deviation per coordinate of a marker is a + b * distance (the linear sum that data sheets of trackers state) and,
added in quadrature, how still the robot stands. Distributions may have heavy tails and part of it may wander slowly; the
standard deviation stays what it is.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from .kinematics import Array, IntArray

TAILS = ("normal", "student", "contaminated")
WAYS_TO_BE_WRONG = ("factor", "settling_left_out", "root_sum")


@dataclass(frozen=True)
class TrueNoise:
    """One standard deviation each, SI units.

    Attributes:
        tracker_m, tracker_m_per_m: a and b of a + b * distance; settling_m: per axis, in quadrature; force_n: per axis.
        tail: distribution of the marker's noise; dof: of `student`; share, times: of `contaminated`, how many rows have how
            many times the standard deviation of the others.
        slow_share: of the tracker's variance that wanders with a correlation time of slow_time s, one course per station.
    """

    tracker_m: float
    tracker_m_per_m: float
    settling_m: float
    force_n: float
    tail: str = "normal"
    dof: float = 4.0
    share: float = 0.08
    times: float = 4.0
    slow_share: float = 0.0
    slow_time: float = 60.0

    @classmethod
    def as_stated(cls, stated: dict[str, float]) -> TrueNoise:
        """Exactly what a header states."""
        return cls(stated["tracker_m"], stated["tracker_m_per_m"], stated.get("settling_m", 0.0), stated["force_n"])

    def tracker_sigma(self, distance: Array) -> Array:
        """Of the tracker alone, m."""
        return self.tracker_m + self.tracker_m_per_m * distance

    def sigma(self, distance: Array) -> Array:
        """Per coordinate of one marker, m."""
        return np.hypot(self.tracker_sigma(distance), self.settling_m)

    def as_data(self) -> dict[str, Any]:
        return asdict(self)


def stated(noise: TrueNoise) -> dict[str, float]:
    """A header that states the noise as it is."""
    return {k: float(getattr(noise, k)) for k in ("tracker_m", "tracker_m_per_m", "force_n", "settling_m")}


def draw_noise(cell_noise: dict[str, float], rng: np.random.Generator, tail: str, slow: bool) -> TrueNoise:
    """The noise of one session: instruments of about the cell's class, none like the other."""
    base = TrueNoise.as_stated(cell_noise)
    return replace(
        base,
        tracker_m=base.tracker_m * float(np.exp(rng.uniform(np.log(0.6), np.log(2.2)))),
        tracker_m_per_m=base.tracker_m_per_m * float(np.exp(rng.uniform(np.log(0.6), np.log(2.0)))),
        settling_m=float(rng.uniform(1e-6, 8e-6)),
        force_n=base.force_n * float(np.exp(rng.uniform(np.log(0.5), np.log(2.0)))),
        tail=tail,
        dof=float(rng.uniform(3.0, 6.0)),
        share=float(rng.uniform(0.03, 0.12)),
        times=float(rng.uniform(3.0, 6.0)),
        slow_share=float(rng.uniform(0.4, 0.9)) if slow else 0.0,
        slow_time=float(np.exp(rng.uniform(np.log(30.0), np.log(120.0)))),
    )


def draw_claim(noise: TrueNoise, way: str, rng: np.random.Generator) -> dict[str, float]:
    """A header that states the noise wrongly.

    Args:
        way: `factor` (all tracker terms times 0.5 .. 2, log-uniform but not within 15 % of one), `settling_left_out`,
            `root_sum` (the sheet's figures made smaller so that their root sum of squares at 4 m, not their sum, is right:
            copied from a program that adds in quadrature) or `right`.
    """
    claim = stated(noise)
    if way == "factor":
        size = rng.uniform(np.log(1.15), np.log(2.0)) * rng.choice([-1.0, 1.0])
        for key in ("tracker_m", "tracker_m_per_m", "settling_m"):
            claim[key] *= float(np.exp(size))
    elif way == "settling_left_out":
        del claim["settling_m"]
        claim["tracker_m"] *= float(np.exp(rng.uniform(np.log(0.6), np.log(0.95))))
    elif way == "root_sum":
        a, b = noise.tracker_m, noise.tracker_m_per_m * 4.0
        for key in ("tracker_m", "tracker_m_per_m"):
            claim[key] *= float(np.hypot(a, b) / (a + b))
    return claim


def claimed_over_true(claim: dict[str, float], noise: TrueNoise, distance: Array) -> float:
    """Ratio of the claimed to the true standard deviation, root mean square over rows at these distances."""
    said = TrueNoise.as_stated(claim).sigma(distance)
    return float(np.sqrt((said**2).mean() / (noise.sigma(distance) ** 2).mean()))


def marker_noise(noise: TrueNoise, stamp: Array, station: IntArray, distance: Array, rng: np.random.Generator) -> Array:
    """Noise of n markers, (n, 3), m.

    Args:
        stamp: s; station: index; distance: m; each (n,), in any order of time.
    """
    fast = _unit(noise, (len(stamp), 3), rng)
    slow = np.zeros((len(stamp), 3))
    if noise.slow_share > 0.0:
        for s in np.unique(station):
            rows = np.flatnonzero(station == s)
            rows = rows[np.argsort(stamp[rows], kind="stable")]
            keep = np.exp(-np.diff(stamp[rows], prepend=stamp[rows[0]]) / noise.slow_time)
            value = rng.standard_normal(3)
            for row, k in zip(rows, keep, strict=True):
                value = k * value + np.sqrt(1.0 - k * k) * rng.standard_normal(3)
                slow[row] = value
    tracker = np.sqrt(1.0 - noise.slow_share) * fast + np.sqrt(noise.slow_share) * slow
    still = rng.normal(0.0, noise.settling_m, slow.shape) if noise.settling_m > 0.0 else 0.0
    return noise.tracker_sigma(distance)[:, None] * tracker + still


def _unit(noise: TrueNoise, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Independent rows of standard deviation one; a tail is of the whole row, as when a beam is disturbed."""
    z = rng.standard_normal(shape)
    if noise.tail == "student":
        spread = np.sqrt(rng.chisquare(noise.dof, shape[0]) / noise.dof)
        return z / spread[:, None] * np.sqrt((noise.dof - 2.0) / noise.dof)
    if noise.tail == "contaminated":
        times = np.where(rng.random(shape[0]) < noise.share, noise.times, 1.0)
        return z * times[:, None] / np.sqrt(1.0 + noise.share * (noise.times**2 - 1.0))
    return z
