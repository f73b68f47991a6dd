# SPDX-License-Identifier: Apache-2.0
"""What the instruments' noise does to the rows of a session: standard deviations and the covariance that rows share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .session.data import Session
from .typing import Array, IntArray

SMALLEST_SIGMA_M = 1e-7  # a session that states no noise at all is weighted uniformly


def position_sigma(session: Session) -> Array:
    """Standard deviation per coordinate of one measured marker position against the controller's, (n,), m."""
    noise = session.noise
    distance = np.linalg.norm(np.nan_to_num(session.p_marker_in_station), axis=1)
    variance = noise.tracker_m**2 + (noise.tracker_m_per_m * distance) ** 2 + noise.settling_m**2
    if session.kind == "absolute":
        reach = np.linalg.norm(session.p_tcp_in_base, axis=1)
        variance = variance + noise.robot_m**2 + (noise.robot_rad * reach) ** 2
    return np.sqrt(np.maximum(variance, SMALLEST_SIGMA_M**2))


@dataclass(frozen=True)
class Whitening:
    """Turns rows with correlated noise into rows of unit, independent noise.

    Rows of one pose and repeat share the noise of their reference row: cov = diag(sigma^2) + sigma_0^2 1 1', alike in x, y and z.

    Attributes:
        sigma: standard deviation per coordinate of each observed row by itself, (m,), m.
        sigma_reference: of the reference that it shares with others, (m,), m; 0 where there is none.
        group: which rows share a reference, (m,).
    """

    sigma: Array
    sigma_reference: Array
    group: IntArray

    def __post_init__(self) -> None:
        by_size: dict[int, list[IntArray]] = {}
        if np.any(self.sigma_reference > 0.0):
            for g in np.unique(self.group):
                rows = np.flatnonzero(self.group == g)
                by_size.setdefault(len(rows), []).append(rows)
        blocks = []
        for groups in by_size.values():
            index = np.stack(groups)
            covariance = (
                self.sigma[index][:, :, None] ** 2 * np.eye(index.shape[1])
                + self.sigma_reference[index[:, 0]][:, None, None] ** 2
            )
            L = np.linalg.cholesky(covariance)
            blocks.append((index, np.linalg.inv(L), L))
        object.__setattr__(self, "_blocks", blocks)

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

    @property
    def floor(self) -> float:
        """Root mean square over samples of the norm of the noise of a row, m: sqrt(mean |r|^2) of a perfect model."""
        return float(np.sqrt(3.0 * np.mean(self.sigma**2 + self.sigma_reference**2)))
