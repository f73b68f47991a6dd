# SPDX-License-Identifier: Apache-2.0
"""A model that is fitted and held, and what many further blocks of columns would add to it: each costs only a problem of its own
size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from ..identification.bounded import solve_bounded_gram
from ..identification.triangles import inverse_of_triangles
from ..identification.validation import floored
from ..typing import Array, IntArray
from .evidence import Bench, Block, Posterior, Products, log_volume

AT_ONCE = 1_000_000  # numbers of columns that are reduced together


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
        inverse = inverse_of_triangles(self._L[None])[0]
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
        (n, p), found = blocks[0].A.shape, list[tuple[Array, Array]]()
        at_once = max(AT_ONCE // (n * p), 1)
        for first in range(0, len(blocks), at_once):
            V, u = self.reduce(np.concatenate([block.A for block in blocks[first : first + at_once]], axis=1))
            found += zip(np.split(V, V.shape[1] // p, axis=1), np.split(u, len(u) // p), strict=True)
        S = [gram - V.T @ V for gram, (V, _) in zip(grams, found, strict=True)]
        bounds = (np.array([getattr(block, name) for block in blocks]) for name in ("lower", "upper", "width"))
        return ReducedTables(np.array(S), np.array([u for _, u in found]), np.array([V for V, _ in found]), *bounds)

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
            volume = log_volume(H, h, x, flat, lower, upper)
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
