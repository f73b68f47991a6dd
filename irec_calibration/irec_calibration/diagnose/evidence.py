# SPDX-License-Identifier: Apache-2.0
"""How well a list of effects explains a session: posterior mode, evidence, and prediction of held-out poses.

Everything is one linear-Gaussian problem in whitened equations and scaled parameters: b = A x + noise, x normal about 0 with
given widths, cut at its bounds. The evidence (marginal likelihood) weighs fit against flexibility without a tuning constant, so
that effects with few and many parameters, and a wrong cause that 18 compliances could nearly absorb, compete on one scale. The
noise level is the instruments' within a few per cent; a Student-t in place of the normal carries that uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx, log_ndtr

from ..bounded import solve_bounded_gram
from ..typing import Array, IntArray

NOISE_DOF = 100.0  # how many equations' worth the data sheet's noise level counts: sigma known to about 7 %
RIDGE = 1e-9


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
        b: (n,) whitened; pose: pose number of each equation, (n,).
    """

    def __init__(self, b: Array, pose: IntArray) -> None:
        self.b = b
        self.pose = pose
        self.poses = np.unique(pose)
        self._of_pose = [np.flatnonzero(pose == p) for p in self.poses]
        self.bb = float(b @ b)

    def posterior(self, block: Block, factors: Array | None = None, own: slice | None = None) -> Posterior:
        """Posterior of a block; with `factors`, the evidence is averaged over prior widths of the columns `own` times each
        factor.

        Args:
            block: all columns.
            factors: multiples of the prior width of the columns in `own`, equally likely beforehand.
            own: which columns the factors apply to.
        """
        G, h = block.A.T @ block.A, block.A.T @ self.b
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
        precision = np.maximum(1.0 / width**2, RIDGE * max(float(G.diagonal().max()), 1e-30))
        H = G + precision[:, :, None] * np.eye(len(h))
        x = solve_bounded_gram(H, h, block.lower, block.upper)
        Gx = x @ G
        chi2 = np.maximum(self.bb - 2.0 * x @ h + np.einsum("ki,ki->k", x, Gx), 0.0)
        loss = chi2 + (precision * x**2).sum(axis=1)
        n = len(self.b)
        fit = -0.5 * (n + NOISE_DOF) * np.log1p(loss / NOISE_DOF)
        flexibility = np.array([_log_volume(H[k], h, x[k], precision[k], block) for k in range(len(x))])
        return x, chi2, fit + flexibility

    def held_out(self, block: Block) -> Array:
        """Whitened residual of every equation, each pose predicted from all others, (n,)."""
        G, h = block.A.T @ block.A, block.A.T @ self.b
        parts = [block.A[rows] for rows in self._of_pose]
        G_out = G - np.stack([a.T @ a for a in parts])
        h_out = h - np.stack([a.T @ self.b[rows] for a, rows in zip(parts, self._of_pose, strict=True)])
        precision = np.maximum(1.0 / block.width**2, RIDGE * max(float(G.diagonal().max()), 1e-30))
        x = solve_bounded_gram(G_out + np.diag(precision), h_out, block.lower, block.upper)
        out = np.empty_like(self.b)
        for rows, a, values in zip(self._of_pose, parts, x, strict=True):
            out[rows] = self.b[rows] - a @ values
        return out

    def by_pose(self, squared: Array) -> Array:
        """Sum per pose of a quantity per equation, (n,) -> (poses,)."""
        return np.array([squared[rows].sum() for rows in self._of_pose])


def _log_volume(H: Array, h: Array, x: Array, precision: Array, block: Block) -> float:
    """Log of the prior-weighted posterior volume about the mode: Laplace for free columns, exact half-lines at a bound."""
    held = (x <= block.lower) | (x >= block.upper)
    free = ~held
    half = np.isfinite(block.lower) & (block.lower >= 0.0) & ~np.isfinite(block.upper)
    total = 0.0
    if free.any():
        F = H[np.ix_(free, free)]
        L = np.linalg.cholesky(F)
        total += 0.5 * float(np.log(precision[free]).sum()) - float(np.log(L.diagonal()).sum())
        inverse = np.linalg.inv(L)
        sigma = np.sqrt((inverse**2).sum(axis=0))
        positive = half[free]
        total += float((np.log(2.0) + log_ndtr(x[free][positive] / sigma[positive])).sum())
    if held.any():
        gradient = np.abs(H[held] @ x - h[held])
        stiffness = H.diagonal()[held].copy()
        if free.any():
            stiffness -= ((inverse @ H[np.ix_(free, held)]) ** 2).sum(axis=0)
        stiffness = np.maximum(stiffness, precision[held])
        total += float((0.5 * np.log(precision[held] / stiffness) + np.log(erfcx(gradient / np.sqrt(2.0 * stiffness)))).sum())
    return total


def _log_mean_exp(values: Array) -> float:
    top = values.max()
    return float(top + np.log(np.mean(np.exp(values - top))))
