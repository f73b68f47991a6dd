# SPDX-License-Identifier: Apache-2.0
"""Readings under columns and scatter of unknown size, whatever the noise of a session is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..typing import Array
from .settings import SETTINGS

LEVELS = SETTINGS.lasting.level_m * 2.0 ** np.arange(13)  # of the scatter, equally likely beforehand


@dataclass(frozen=True)
class Scattered:
    """Columns that readings may have, in standard deviations of what each is about, with scatter beside them.

    They are decomposed once (A = U S V'), and so answer for many readings and all sizes of the scatter: under each the readings
    are normal with the covariance A A' + level^2 I. What columns may have does not grow with the scatter.

    Attributes:
        columns: (rows, 3, p), m.
    """

    columns: Array

    def log_evidence(self, values: Array) -> float:
        """Log evidence of readings, (rows, 3), m, averaged over the sizes of the scatter."""
        return float(np.logaddexp.reduce(self._by_level(values)[0]) - np.log(len(LEVELS)))

    def fitted(self, values: Array) -> tuple[float, Array]:
        """The same, and the values of the columns at the likeliest size of the scatter, (p,)."""
        _, size, Vt = self._decomposed
        each, onto = self._by_level(values)
        level = LEVELS[int(np.argmax(each))]
        return self.log_evidence(values), Vt.T @ (size / (size**2 + level**2) * onto)

    @cached_property
    def _decomposed(self) -> tuple[Array, Array, Array]:
        U, size, Vt = np.linalg.svd(self.columns.reshape(-1, self.columns.shape[2]), full_matrices=False)
        return U, size, Vt

    def _by_level(self, values: Array) -> tuple[Array, Array]:
        """Log evidence at each size of the scatter, up to a constant of how many readings there are, and U' b."""
        U, size, _ = self._decomposed
        b = values.ravel()
        onto = U.T @ b
        left = float(((b - U @ onto) ** 2).sum())
        level2 = LEVELS[:, None] ** 2
        loss = (onto**2 / (size**2 + level2)).sum(axis=1) + left / LEVELS**2
        return -0.5 * loss - 0.5 * np.log1p(size**2 / level2).sum(axis=1) - len(b) * np.log(LEVELS), onto
