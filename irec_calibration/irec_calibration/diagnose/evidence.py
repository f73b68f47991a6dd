# SPDX-License-Identifier: Apache-2.0
"""How well a list of effects explains a session: posterior mode, evidence, and prediction of held-out poses.

Everything is one linear-Gaussian problem in whitened equations and scaled parameters: b = A x + noise, x normal about 0 with
given widths, cut at its bounds. The evidence (marginal likelihood) weighs fit against flexibility without a tuning constant, so
that effects with few and many parameters, and a wrong cause that 18 compliances could nearly absorb, compete on one scale. The
level of the noise is unknown: its prior is the stated one within a factor of two, and the evidence integrates over it (a
Student-t in place of the normal).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import erfcx, log_ndtr

from ..identification.bounded import solve_bounded_gram
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
        self._of_pose = [np.flatnonzero(pose == p) for p in self.poses]
        self.bb = float(b @ b)

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
        return x, chi2, fit + _log_volume(H, one * h, x, precision, one * block.lower, one * block.upper)

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


class Ground:
    """A block fitted and held as the ground that many further blocks are tried on: each costs only a problem of its own size.

    Which columns of the ground stand at a bound is decided once, without the further blocks.

    Attributes:
        log_evidence, chi2: of the ground alone, as `Bench.posterior`.
        residual: whitened, of every equation, (n,).
        fitted: how many equations' worth the ground takes up (effective number of parameters).
    """

    def __init__(self, bench: Bench, block: Block, products: Products | None = None) -> None:
        """products: A'A and A'b of the block, where they are known already."""
        G, h = products or (block.A.T @ block.A, block.A.T @ bench.b)
        self.bench, self._block, self._products = bench, block, (G, h)
        alone = bench.posterior(block, products=(G, h))
        self.log_evidence, self.chi2 = alone.log_evidence, alone.chi2
        x = alone.x
        self._free = (x > block.lower) & (x < block.upper)
        self._x_held = x[~self._free]
        precision = floored(1.0 / block.width**2, G, bench.rounding)
        self._b = bench.b - block.A[:, ~self._free] @ self._x_held
        self._held = float((precision[~self._free] * self._x_held**2).sum())
        self._precision = precision[self._free]
        self._L = np.linalg.cholesky(G[np.ix_(self._free, self._free)] + np.diag(self._precision))
        rest = h[self._free] - G[np.ix_(self._free, ~self._free)] @ self._x_held
        self._c = solve_triangular(self._L, rest, lower=True)
        self.loss = max(float(self._b @ self._b - self._c @ self._c), 1e-12) + self._held
        self._fit = float(bench.log_fit(np.array(self.loss)))

    @cached_property
    def _B(self) -> Array:
        return self._block.A[:, self._free]

    @cached_property
    def residual(self) -> Array:
        return np.asarray(self._b - self._B @ solve_triangular(self._L, self._c, lower=True, trans="T"))

    @cached_property
    def fitted(self) -> float:
        inverse = np.linalg.inv(self._L)
        return len(inverse) - float(((inverse**2).sum(axis=0) * self._precision).sum())

    @property
    def taken_up(self) -> Array:
        """What the ground takes up of noise of one in each equation: columns whose products are its covariance, (n, free)."""
        out: Array = solve_triangular(self._L, self._B.T, lower=True).T
        return out

    def reduce(self, X: Array) -> tuple[Array, Array]:
        """What is left of columns beside the ground: V (free, m) with S = X'X - V'V, and u = X'b - V'c, (m,)."""
        V = solve_triangular(self._L, self._B.T @ X, lower=True)
        return V, X.T @ self._b - V.T @ self._c

    def reduced(self, crossed: Array, by_b: Array) -> tuple[Array, Array]:
        """As `reduce`, where the products of the columns with the ground's block, A'X (p, m), and with b, X'b (m,), are known."""
        V = solve_triangular(self._L, crossed[self._free], lower=True)
        return V, by_b - self._x_held @ crossed[~self._free] - V.T @ self._c

    def beside(self, column: Array) -> Array:
        """What is left of a column, (n,), beside the ground."""
        V, _ = self.reduce(column[:, None])
        out: Array = column - self._B @ solve_triangular(self._L, V[:, 0], lower=True, trans="T")
        return out

    def lost_to_bounds(self, before: Ground) -> float:
        """By how much the log evidence of the fit would be higher if no column had come to a bound that was free in the ground
        before, to which columns were added."""
        n = len(before._free)
        if not (before._free & ~self._free[:n]).any():
            return 0.0
        free = np.concatenate([before._free, np.ones(len(self._free) - n, dtype=bool)])
        lower, upper = np.where(free, -np.inf, self._block.lower), np.where(free, np.inf, self._block.upper)
        loose = Ground(self.bench, replace(self._block, lower=lower, upper=upper), self._products)
        return max(loose._fit - self._fit, 0.0)

    def fit_gain(self, loss: Array) -> Array:
        """Log evidence gained by the fit alone where the loss falls to these values."""
        return self.bench.log_fit(np.maximum(loss, 1e-12)) - self._fit

    def posterior(self, block: Block, factors: Array) -> Posterior:
        """Posterior of a further block, its evidence averaged over its prior width times each factor.

        x holds the further block's columns only; log_evidence is that of ground and block together.
        """
        return self.posteriors(self.reduced_tables([block]), [(0, range(block.A.shape[1]))], factors)[0]

    def reduced_tables(self, blocks: Sequence[Block], grams: Sequence[Array] | None = None) -> ReducedTables:
        """Further blocks of the same columns, at other shapes; grams: the products A'A of each, where they are known already."""
        grams = [block.A.T @ block.A for block in blocks] if grams is None else grams
        V, u = zip(*(self.reduce(block.A) for block in blocks), strict=True)
        S = [gram - v.T @ v for gram, v in zip(grams, V, strict=True)]
        bounds = (np.array([getattr(block, name) for block in blocks]) for name in ("lower", "upper", "width"))
        return ReducedTables(np.array(S), np.array(u), np.array(V), *bounds)

    def posteriors(self, tables: ReducedTables, sets: Sequence[tuple[int, Sequence[int]]], factors: Array) -> list[Posterior]:
        """As `posterior` of each of many sets of columns: the number of a table, and some of its columns."""
        out: dict[int, Posterior] = {}
        alike: dict[tuple[int, bool], list[int]] = {}
        for i, (of, chosen) in enumerate(sets):
            alike.setdefault((len(chosen), any(tables.bounded[of][c] for c in chosen)), []).append(i)
        for (_, bounded), places in alike.items():
            table = np.array([sets[i][0] for i in places])
            columns = np.array([sets[i][1] for i in places], dtype=np.intp)
            out |= dict(zip(places, self._posteriors(tables, table, columns, bounded, factors), strict=True))
        return [out[i] for i in range(len(sets))]

    def _posteriors(
        self, tables: ReducedTables, table: IntArray, columns: IntArray, bounded: bool, factors: Array
    ) -> list[Posterior]:
        """Of m sets of p columns each, under k factors; table: (m,); columns: (m, p)."""
        of = table[:, None], columns
        S, u = tables.S[table[:, None, None], columns[:, :, None], columns[:, None, :]], tables.u[of]
        precision = floored((tables.width[of][:, None] * factors[:, None]) ** -2.0, S[:, None], self.bench.rounding)
        m, k, p = precision.shape
        flat = precision.reshape(-1, p)
        H = np.repeat(S, k, axis=0) + flat[:, :, None] * np.eye(p)
        h = np.repeat(u, k, axis=0)
        if bounded:
            lower, upper = np.repeat(tables.lower[of], k, axis=0), np.repeat(tables.upper[of], k, axis=0)
            x = solve_bounded_gram(H, h, lower, upper)
            volume = _log_volume(H, h, x, flat, lower, upper)
        else:
            x = np.asarray(np.linalg.solve(H, h[:, :, None])[:, :, 0], dtype=float)
            volume = 0.5 * (np.log(flat).sum(axis=1) - np.linalg.slogdet(H)[1])
        loss = self.loss - 2.0 * (x * h).sum(axis=1) + np.einsum("ki,kij,kj->k", x, H, x)
        gained = (self.fit_gain(loss) + volume).reshape(m, k)
        best = gained.argmax(axis=1)
        at = np.arange(m) * k + best
        in_table = np.zeros((m, tables.u.shape[1]))
        in_table[np.arange(m)[:, None], columns] = x[at]
        moved = self._c[:, None] - np.einsum("mfp,mp->fm", tables.V[table], in_table)
        beside = solve_triangular(self._L, moved, lower=True, trans="T")
        chi2 = loss[at] - (flat[at] * x[at] ** 2).sum(axis=1) - self._held - self._precision @ beside**2
        top = gained[np.arange(m), best]
        log_evidence = self.log_evidence + top + np.log(np.exp(gained - top[:, None]).mean(axis=1))
        return [
            Posterior(x[i], max(float(c), 0.0), float(e), float(factors[j]))
            for i, j, c, e in zip(at, best, chi2, log_evidence, strict=True)
        ]


@dataclass(frozen=True)
class ReducedTables:
    """Further blocks beside a ground, t of p columns each: S = X'X - V'V, u and V as of `Ground.reduce`, of their columns X.

    Attributes:
        S: (t, p, p); u: (t, p); V: (t, free, p); lower, upper, width: as of `Block`, (t, p).
    """

    S: Array
    u: Array
    V: Array
    lower: Array
    upper: Array
    width: Array

    @cached_property
    def bounded(self) -> list[list[bool]]:
        """Whether a column has a bound, by table and column."""
        out: list[list[bool]] = (np.isfinite(self.lower) | np.isfinite(self.upper)).tolist()
        return out


def _log_volume(H: Array, h: Array, x: Array, precision: Array, lower: Array, upper: Array) -> Array:
    """Log of the prior-weighted posterior volumes about the modes of k problems, (k,): Laplace for free columns, exact half-lines
    at a bound."""
    held = (x <= lower) | (x >= upper)
    out = np.empty(len(x))
    alike: dict[bytes, list[int]] = {}
    for i, row in enumerate(held):
        alike.setdefault(row.tobytes(), []).append(i)
    for places in alike.values():
        at = slice(None) if len(places) == len(x) else places
        out[at] = _log_volume_of_same_held(held[places[0]], H[at], h[at], x[at], precision[at], lower[at], upper[at])
    return out


def _log_volume_of_same_held(
    held: BoolArray, H: Array, h: Array, x: Array, precision: Array, lower: Array, upper: Array
) -> Array:
    free = ~held
    half = np.isfinite(lower) & (lower >= 0.0) & ~np.isfinite(upper)
    total = np.zeros(len(x))
    if free.any():
        L = np.linalg.cholesky(H[:, free][:, :, free])
        total += 0.5 * np.log(precision[:, free]).sum(axis=1) - np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
        inverse = np.linalg.inv(L)
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
