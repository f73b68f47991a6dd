# SPDX-License-Identifier: Apache-2.0
"""What the instruments' noise does to the rows of a session: standard deviations and the covariance that rows share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ..session.data import Session
from ..typing import Array, BoolArray, IntArray
from .triangles import inverse_of_triangles

FARTHEST_CLAIM = 3.0  # times what is seen: a claimed noise counts as no larger than that
ENOUGH_TO_DOUBT = 30  # equations to spare from which it does not
SMALLEST_SIGMA_M = 1e-7  # a session that states no noise at all is weighted uniformly


def position_sigma(session: Session) -> Array:
    """Standard deviation per coordinate of one measured marker position against the controller's, (n,), m.

    The tracker's is a + b d, the linear sum of its data sheet (not the root of the sum of squares); settling and robot are causes
    of their own and add in squares.
    """
    noise = session.noise
    variance = _instrument_variance(session)
    if session.kind == "absolute":
        reach = np.linalg.norm(session.p_tcp_in_base, axis=1)
        variance = variance + noise.robot_m**2 + (noise.robot_rad * reach) ** 2
    return np.sqrt(np.maximum(variance, SMALLEST_SIGMA_M**2))


def instrument_sigma(session: Session) -> Array:
    """Standard deviation per coordinate of tracker and settling alone, which a marker on the base has too, (n,), m."""
    return np.asarray(np.sqrt(np.maximum(_instrument_variance(session), SMALLEST_SIGMA_M**2)))


def _instrument_variance(session: Session) -> Array:
    noise = session.noise
    distance = np.linalg.norm(np.nan_to_num(session.p_marker_in_station), axis=1)
    return np.asarray((noise.tracker_m + noise.tracker_m_per_m * distance) ** 2 + noise.settling_m**2)


@dataclass(frozen=True)
class Wander:
    """The part of the noise that wanders (an Ornstein-Uhlenbeck process: air, tripod, warm-up of the instrument).

    Attributes:
        share: of the variance, 0 .. 1; time: correlation time, s.
        stamp: of each row, (m,), s.
        stretch: rows with the same number may be correlated, (m,); between stretches correlation is neglected.
        sigma: standard deviation per coordinate of which the share is, (m,), m.
        common: rows with the same number share that noise, (m,): it is what the markers of a pose have in common; None: each has
            its own.
        stamp_reference, sigma_reference: of the reference that a row is the difference from; None: rows are no differences.
    """

    share: float
    time: float
    stamp: Array
    stretch: IntArray
    sigma: Array
    stamp_reference: Array | None = None
    sigma_reference: Array | None = None
    common: IntArray | None = None

    def only(self, keep: BoolArray | IntArray) -> Wander:
        common = None if self.common is None else self.common[keep]
        one = replace(self, stamp=self.stamp[keep], stretch=self.stretch[keep], sigma=self.sigma[keep], common=common)
        if self.stamp_reference is None or self.sigma_reference is None:
            return one
        return replace(one, stamp_reference=self.stamp_reference[keep], sigma_reference=self.sigma_reference[keep])

    def scaled(self, factor: float) -> Wander:
        reference = None if self.sigma_reference is None else self.sigma_reference * factor
        return replace(self, sigma=self.sigma * factor, sigma_reference=reference)

    @property
    def spared(self) -> Array:
        """What a row's variance per coordinate is smaller by since it and its reference have like noise, (m,), m^2."""
        if self.stamp_reference is None or self.sigma_reference is None:
            return np.zeros(len(self.stamp))
        return 2.0 * self.share * self.sigma * self.sigma_reference * self._alike(self.stamp - self.stamp_reference)

    def excess(self, index: IntArray) -> Array:
        """Covariance of stretches of s rows each, (k, s), less that of noise that doesn't wander, (k, s, s), m^2."""
        own, t = self.sigma[index], self.stamp[index]
        both = own[:, :, None] * own[:, None, :]
        alike = np.arange(index.shape[1]) if self.common is None else self.common[index]
        slow = both * (self._alike(t[:, :, None] - t[:, None, :]) - (alike[..., :, None] == alike[..., None, :]))
        if self.stamp_reference is not None and self.sigma_reference is not None:
            to_reference = own * self.sigma_reference[index] * self._alike(t - self.stamp_reference[index])
            slow = slow - to_reference[:, :, None] - to_reference[:, None, :]
        return np.asarray(self.share * slow)

    def _alike(self, between: Array) -> Array:
        return np.exp(-np.abs(between) / self.time)


@dataclass(frozen=True)
class Whitening:
    """Turns rows with correlated noise into rows of unit, independent noise.

    Rows of one pose and repeat share the noise of their reference row: cov = diag(sigma^2) + sigma_0^2 1 1', alike in x, y and z.
    Where a share w of the variance wanders (`Wander`), the noise e of two rows or references of a stretch is correlated by
    w exp(-|t - t'| / T). In a loaded session a stretch is a group and cov that of the differences e_j - e_0; between groups it is
    neglected, since differences within a pose hardly know of each other.

    Attributes:
        sigma: standard deviation per coordinate of each observed row by itself, (m,), m.
        sigma_reference: of the reference that it shares with others, (m,), m; 0 where there is none.
        group: which rows share a reference, (m,).
        level: the sigmas are the stated ones times this.
        wander: part of the noise that is correlated in time; None: nothing is.
    """

    sigma: Array
    sigma_reference: Array
    group: IntArray
    level: float = 1.0
    wander: Wander | None = None

    def __post_init__(self) -> None:
        by_size: dict[int, list[IntArray]] = {}
        together = self.group if self.wander is None else self.wander.stretch
        if self.wander is not None or np.any(self.sigma_reference > 0.0):
            order = np.argsort(together, kind="stable")
            for rows in np.split(order, np.flatnonzero(np.diff(together[order])) + 1):
                by_size.setdefault(len(rows), []).append(rows)
        blocks = []
        for groups in by_size.values():
            index = np.stack(groups)
            L = np.asarray(np.linalg.cholesky(self._covariance(index)), dtype=float)
            blocks.append((index, inverse_of_triangles(L), L))
        object.__setattr__(self, "_blocks", blocks)

    def _covariance(self, index: IntArray) -> Array:
        """Of groups or stretches of s rows each, (k, s) -> (k, s, s), m^2."""
        own, reference, group = self.sigma[index], self.sigma_reference[index], self.group[index]
        shared = reference[:, :, None] * reference[:, None, :] * (group[:, :, None] == group[:, None, :])
        alone = own[:, :, None] ** 2 * np.eye(index.shape[1]) + shared
        return np.asarray(alone if self.wander is None else alone + self.wander.excess(index))

    @property
    def log_size(self) -> float:
        """Logarithm of the determinant of the covariance's root, over rows and one coordinate (m)."""
        blocks: list[tuple[IntArray, Array, Array]] = self._blocks  # type: ignore[attr-defined]
        if not blocks:
            return float(np.log(self.sigma).sum())
        return float(sum(np.log(np.diagonal(L, axis1=1, axis2=2)).sum() for _, _, L in blocks))

    def __call__(self, x: Array) -> Array:
        """Whiten an array whose first axis runs over the rows, in m; the result is in standard deviations."""
        blocks: list[tuple[IntArray, Array, Array]] = self._blocks  # type: ignore[attr-defined]
        if not blocks:
            return x / self.sigma.reshape(-1, *[1] * (x.ndim - 1))
        return self._times(x, [(index, inverse) for index, inverse, _ in blocks])

    def undo(self, z: Array) -> Array:
        """Back from standard deviations to m: the inverse of whitening."""
        blocks: list[tuple[IntArray, Array, Array]] = self._blocks  # type: ignore[attr-defined]
        if not blocks:
            return z * self.sigma.reshape(-1, *[1] * (z.ndim - 1))
        return self._times(z, [(index, L) for index, _, L in blocks])

    @staticmethod
    def _times(x: Array, blocks: list[tuple[IntArray, Array]]) -> Array:
        """Rows of each group of one size (k, s) multiplied by their matrix (k, s, s)."""
        flat = x.reshape(len(x), -1)
        out = np.empty_like(flat)
        for index, matrix in blocks:
            out[index] = matrix @ flat[index]
        return out.reshape(x.shape)

    def only(self, keep: BoolArray | IntArray) -> Whitening:
        """Some rows only."""
        wander = None if self.wander is None else self.wander.only(keep)
        return Whitening(self.sigma[keep], self.sigma_reference[keep], self.group[keep], self.level, wander)

    def scaled(self, factor: float) -> Whitening:
        """The same with all noise larger by a factor."""
        sigma, reference = self.sigma * factor, self.sigma_reference * factor
        wander = None if self.wander is None else self.wander.scaled(factor)
        return replace(self, sigma=sigma, sigma_reference=reference, level=self.level * factor, wander=wander)

    @property
    def claimed_floor(self) -> float:
        """`floor` at the stated level, m."""
        return self.floor / self.level

    @property
    def floor(self) -> float:
        """Root mean square over samples of the norm of the noise of a row, m: sqrt(mean |r|^2) of a perfect model."""
        spared = 0.0 if self.wander is None else self.wander.spared
        return float(np.sqrt(3.0 * np.mean(self.sigma**2 + self.sigma_reference**2 - spared)))


@dataclass(frozen=True)
class InferredNoise:
    """The level of the noise that a session shows.

    Attributes:
        claimed_m, inferred_m, low_m, high_m: RMS over samples of the norm, as `Whitening.floor`, m; low and high bound 95 % of
            what is likely.
        source: what it rests on: `repeats`, `repeats and residual`, `residual` or `claim`.
        dof: degrees of freedom of that source, the claim's own included.
        wander_share, wander_time_s: of the variance that is correlated in time, and its correlation time.
    """

    claimed_m: float
    inferred_m: float
    low_m: float
    high_m: float
    source: str
    dof: float
    wander_share: float = 0.0
    wander_time_s: float = 0.0

    @property
    def ratio(self) -> float:
        """Inferred over claimed level."""
        return self.inferred_m / max(self.claimed_m, 1e-300)

    @property
    def differs(self) -> bool:
        """The claim lies outside of what is likely."""
        return not self.low_m <= self.claimed_m <= self.high_m


def counted_claim(squared: float, chi2: float, dof: float) -> float:
    """A claimed variance as it counts beside what is seen: no farther above that than FARTHEST_CLAIM squared.

    A claim counts as few equations, yet one that is thirty times too large would outweigh hundreds that show so.

    Args:
        squared: the claimed variance; chi2: squared residual in the same unit, of dof degrees of freedom.
    """
    return min(squared, FARTHEST_CLAIM**2 * max(chi2, 0.0) / dof) if dof >= ENOUGH_TO_DOUBT else squared


def level_of(claimed_m: float, chi2: float, dof: float, source: str, prior_dof: float) -> InferredNoise:
    """The level of the noise after a sum of squares was seen (scaled inverse chi squared).

    Args:
        chi2: squared residual in units of the claimed noise, of dof degrees of freedom.
        prior_dof: how many degrees of freedom the claim counts.
    """
    total = prior_dof + max(dof, 0.0)
    squares = prior_dof * counted_claim(1.0, chi2, dof) + max(chi2, 0.0)
    low, high = (np.sqrt(squares / chdtri(total, p)) for p in (0.025, 0.975))
    inferred = np.sqrt(squares / total)
    return InferredNoise(
        claimed_m, float(claimed_m * inferred), float(claimed_m * low), float(claimed_m * high), source, float(total)
    )


def pure_error(whitened: Array, keys: IntArray) -> tuple[float, int]:
    """Squared deviations of repeats from their mean and their degrees of freedom, whatever the model.

    Args:
        whitened: residual in standard deviations, (m, 3).
        keys: rows with the same number are repeats of each other, (m,).
    """
    _, place, count = np.unique(keys, return_inverse=True, return_counts=True)
    mean = np.zeros((len(count), whitened.shape[1]))
    np.add.at(mean, place, whitened)
    deviation = whitened - (mean / count[:, None])[place]
    return float((deviation**2).sum()), int(whitened.shape[1] * (len(whitened) - len(count)))
