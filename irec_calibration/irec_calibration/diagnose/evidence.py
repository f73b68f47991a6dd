# SPDX-License-Identifier: Apache-2.0
"""How well a list of effects explains a session: posterior mode, evidence, and prediction of held-out poses.

Everything is one linear-Gaussian problem in whitened equations and scaled parameters: b = A x + noise, x normal about 0 with
given widths, cut at its bounds. The evidence (marginal likelihood) weighs fit against flexibility without a tuning constant, so
that effects with few and many parameters, and a wrong cause that 18 compliances could nearly absorb, compete on one scale. The
level of the noise is unknown: its prior is the stated one within a factor of two, and the evidence integrates over it (a
Student-t in place of the normal).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import erfcx, log_ndtr

from ..identification.bounded import solve_bounded_gram
from ..identification.triangles import inverse_of_triangles
from ..identification.validation import RIDGE, floored, predicted_from_others
from ..typing import Array, BoolArray, IntArray

Products = tuple[Array, Array]  # A'A and A'b of a block


@dataclass(frozen=True)
class NoisePrior:
    """What is believed of the level of the noise before the equations are seen (scaled inverse chi squared).

    Attributes:
        dof: how many equations' worth the belief counts; 4 is a factor of two either way at two standard deviations.
        scale: believed level, in units of the one that the equations are whitened by.
    """

    dof: float = 4.0
    scale: float = 1.0


@dataclass(frozen=True)
class Block:
    """Columns of one effect, or of several, in whitened equations and scaled parameters.

    Attributes:
        A: (n, p); lower, upper: (p,); width: standard deviation of the prior about 0, (p,), inf where there is none.
    """

    A: Array
    lower: Array
    upper: Array
    width: Array

    def __add__(self, other: Block) -> Block:
        return Block(
            np.concatenate([self.A, other.A], axis=1),
            np.concatenate([self.lower, other.lower]),
            np.concatenate([self.upper, other.upper]),
            np.concatenate([self.width, other.width]),
        )

    def take(self, columns: IntArray | list[int]) -> Block:
        """Some columns only."""
        return Block(self.A[:, columns], self.lower[columns], self.upper[columns], self.width[columns])

    def widened(self, factor: float) -> Block:
        """The same with a wider prior."""
        return Block(self.A, self.lower, self.upper, self.width * factor)


@dataclass(frozen=True)
class Posterior:
    """Result for one block list.

    Attributes:
        x: posterior mode, (p,), scaled; chi2: squared whitened residual there; log_evidence: up to a constant of the session.
        factor: the multiple of the prior width under which the evidence was best.
    """

    x: Array
    chi2: float
    log_evidence: float
    factor: float = 1.0


class Bench:
    """The right side of a session, cut into poses; solves blocks against it.

    Attributes:
        b: (n,) whitened; pose: pose number of each equation, (n,); rounding: see `floored`.
    """

    def __init__(self, b: Array, pose: IntArray, noise: NoisePrior | None = None, rounding: float = RIDGE) -> None:
        self.rounding = rounding
        self.noise = noise or NoisePrior()
        self.b = b
        self.pose = pose
        self.poses = np.unique(pose)
        self.bb = float(b @ b)

    @cached_property
    def _of_pose(self) -> list[IntArray]:
        return [np.flatnonzero(self.pose == p) for p in self.poses]

    def posterior(
        self, block: Block, factors: Array | None = None, own: slice | None = None, products: Products | None = None
    ) -> Posterior:
        """Posterior of a block; with `factors`, the evidence is averaged over prior widths of the columns `own` times each
        factor.

        Args:
            block: all columns.
            factors: multiples of the prior width of the columns in `own`, equally likely beforehand.
            own: which columns the factors apply to.
            products: A'A and A'b of the block, where they are known already.
        """
        G, h = products or (block.A.T @ block.A, block.A.T @ self.b)
        width = np.tile(block.width, (1 if factors is None else len(factors), 1))
        if factors is not None and own is not None:
            width[:, own] *= factors[:, None]
        x, chi2, log_ev = self._solve(G, h, block, width)
        best = int(np.argmax(log_ev))
        factor = 1.0 if factors is None else float(factors[best])
        return Posterior(x[best], float(chi2[best]), float(_log_mean_exp(log_ev)), factor)

    def evidence_over_widths(self, block: Block, width: Array) -> Array:
        """Log evidence for each row of prior widths, (k, p) -> (k,)."""
        return self._solve(block.A.T @ block.A, block.A.T @ self.b, block, width)[2]

    def _solve(self, G: Array, h: Array, block: Block, width: Array) -> tuple[Array, Array, Array]:
        precision = floored(1.0 / width**2, G, self.rounding)
        H = G + precision[:, :, None] * np.eye(len(h))
        x = solve_bounded_gram(H, h, block.lower, block.upper)
        Gx = x @ G
        chi2 = np.maximum(self.bb - 2.0 * x @ h + np.einsum("ki,ki->k", x, Gx), 0.0)
        loss = chi2 + (precision * x**2).sum(axis=1)
        fit = self.log_fit(loss)
        one = np.ones((len(x), 1))
        return x, chi2, fit + log_volume(H, one * h, x, precision, one * block.lower, one * block.upper)

    def log_fit(self, loss: Array) -> Array:
        """Log probability of the equations with a loss (squared residual and penalty), integrated over the noise level."""
        dof = self.noise.dof
        return -0.5 * (len(self.b) + dof) * np.log1p(loss / (dof * self.noise.scale**2))

    def saved(self, chi2_before: float, chi2_after: float) -> float:
        """What a fall of the squared residual is worth at the noise level that it shows itself: about the fall in variances."""
        return float(self.saved_each(chi2_before, np.array([chi2_after]))[0])

    def saved_each(self, chi2_before: float, chi2_after: Array) -> Array:
        """As `saved`, of each of many fits, (k,)."""
        return 2.0 * (self.log_fit(chi2_after) - self.log_fit(np.array(chi2_before)))

    def held_out(self, block: Block) -> Array:
        """Whitened residual of every equation, each pose predicted from all others, (n,)."""
        precision = 1.0 / block.width**2
        return predicted_from_others(block.A, self.b, self._of_pose, block.lower, block.upper, precision, self.rounding)

    def by_pose(self, squared: Array) -> Array:
        """Sum per pose of a quantity per equation, (n,) -> (poses,)."""
        return np.array([squared[rows].sum() for rows in self._of_pose])


def log_volume(H: Array, h: Array, x: Array, precision: Array, lower: Array, upper: Array) -> Array:
    """Log of the prior-weighted posterior volumes about the modes of k problems, (k,): Laplace for free columns, exact half-lines
    at a bound."""
    held = (x <= lower) | (x >= upper)
    out = np.empty(len(x))
    alike: dict[bytes, list[int]] = {}
    for i, row in enumerate(held):
        alike.setdefault(row.tobytes(), []).append(i)
    for places in alike.values():
        at = slice(None) if len(places) == len(x) else places
        out[at] = _of_same_held(held[places[0]], H[at], h[at], x[at], precision[at], lower[at], upper[at])
    return out


def _of_same_held(
    held: BoolArray, H: Array, h: Array, x: Array, precision: Array, lower: Array, upper: Array
) -> Array:
    free = ~held
    half = np.isfinite(lower) & (lower >= 0.0) & ~np.isfinite(upper)
    total = np.zeros(len(x))
    if free.any():
        L = np.linalg.cholesky(H[:, free][:, :, free])
        total += 0.5 * np.log(precision[:, free]).sum(axis=1) - np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
        inverse = inverse_of_triangles(L)
        sigma = np.sqrt((inverse**2).sum(axis=1))
        positive = half[:, free]
        if positive.any():
            total += np.where(positive, np.log(2.0) + log_ndtr(x[:, free] / sigma), 0.0).sum(axis=1)
    if held.any():
        gradient = np.abs(np.einsum("kij,kj->ki", H[:, held], x) - h[:, held])
        stiffness = np.diagonal(H, axis1=1, axis2=2)[:, held].copy()
        if free.any():
            stiffness -= ((inverse @ H[:, free][:, :, held]) ** 2).sum(axis=1)
        stiffness = np.maximum(stiffness, precision[:, held])
        logs = 0.5 * np.log(precision[:, held] / stiffness) + np.log(erfcx(gradient / np.sqrt(2.0 * stiffness)))
        total += logs.sum(axis=1)
    return total


def _log_mean_exp(values: Array) -> float:
    top = values.max()
    return float(top + np.log(np.mean(np.exp(values - top))))
