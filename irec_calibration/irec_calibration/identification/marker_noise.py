# SPDX-License-Identifier: Apache-2.0
"""How the noise of an absolute session is shared out among its markers, by the residual of a fit.

Each marker has noise of its own; what the markers on the tool of one pose have in common is the robot's, or that of the air.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..typing import Array, BoolArray, IntArray
from .absolute import noted
from .noise import instrument_sigma
from .observe import Observation
from .settings import ABSOLUTE

NOTE = "residual by marker, um per coordinate: "


def by_marker(observation: Observation, residual: Array, taken_up: Array | None = None) -> Observation:
    """The observation with the rows of each marker weighted by how well it fits, and with what the markers of a pose share.

    Markers on the base see the tracker's noise, those on the tool also whatever the model of the robot lacks, which all markers
    of a pose have in common. Only the pattern is taken from the residual; the overall level stays what the session states.

    Args:
        residual: of a fit, (m, 3), m.
        taken_up: what that fit takes up of the noise, (m, 3, p), m: columns whose products summed over p are its covariance.
    """
    session, w = observation.session, observation.whiten
    marker, moving = session.marker[observation.rows], observation.scene.moves_with_arm[observation.rows]
    if len(np.unique(marker)) < 2:
        return observation
    apart = _Apart.of(observation.pose, moving)
    mean, inner = apart.mean(residual), apart.inner(residual)
    own = np.empty(len(residual))
    sizes = {}
    for m in np.unique(marker):
        mine = marker == m
        if mine.sum() < ABSOLUTE.fewest_of_marker:
            return observation
        left = 1.0 if taken_up is None else _left(apart.inner(taken_up)[mine], apart.variance_of_inner(w.sigma)[mine])
        sizes[session.markers[m].name] = size = _spread(inner[mine]) / left
        own[mine] = size * w.sigma[mine] / np.median(w.sigma[mine])
    shared, several = 0.0, apart.several
    if several.any():
        by_chance = apart.variance_of_mean(own)[several]
        left = 1.0
        if taken_up is not None:
            reference = apart.mean((w.sigma_reference**2)[:, None])[several, 0]
            left = _left(apart.mean(taken_up)[several], apart.variance_of_mean(w.sigma)[several] + reference)
        shared = float(np.sqrt(max((_spread(mean[several]) / left) ** 2 - float(np.median(by_chance)), 0.0)))
    reference = np.where(apart.together, shared, 0.0)
    level = w.floor / np.sqrt(3.0 * np.mean(own**2 + reference**2))
    group = np.where(apart.together, apart.pose, len(several) + np.arange(len(apart.pose)))
    changed = replace(w, sigma=level * own, sigma_reference=level * reference, group=group, wander=None)
    words = ", ".join(f"{n} {1e6 * v:.0f}" for n, v in sizes.items())
    common = f"; what the markers of a pose share: {1e6 * shared:.0f} um" if several.any() else ""
    kept = tuple(n for n in session.notes if not n.startswith(NOTE))
    plain = replace(observation, whiten=changed, session=replace(session, notes=kept))
    return noted(plain, f"{NOTE}{words}{common}; rows are weighted by these")


def at_level(observation: Observation, factor: float) -> Observation:
    """The observation with all noise larger by a factor; in an absolute session of several markers no smaller than the
    instrument's.

    Where the arm sags by a hundred times the noise, how well markers on the base fit beside it tells nothing, and what was
    told then is too little by far when springs have taken the sag: a few structures that fit them would outweigh all else.

    Args:
        factor: of all standard deviations, as of `Whitening.scaled`.
    """
    whiten = observation.whiten.scaled(factor)
    session = observation.session
    if session.kind == "loaded" or len(np.unique(session.marker[observation.rows])) < 2:
        return replace(observation, whiten=whiten)
    least = ABSOLUTE.least_of_instrument * instrument_sigma(session)[observation.rows]
    return replace(observation, whiten=replace(whiten, sigma=np.maximum(whiten.sigma, least)))


@dataclass(frozen=True)
class _Apart:
    """What the markers on the tool have in common in each pose, and what each has by itself.

    Attributes:
        pose: number of the pose of each row, (m,); moving: markers on the tool, (m,); count: of those in each pose, (k,).
    """

    pose: IntArray
    moving: BoolArray
    count: Array

    @classmethod
    def of(cls, pose: IntArray, moving: BoolArray) -> _Apart:
        _, number = np.unique(pose, return_inverse=True)
        return cls(number, moving, np.asarray(np.bincount(number, moving), dtype=float))

    @property
    def several(self) -> BoolArray:
        """Poses in which several were seen, (k,)."""
        return np.asarray(self.count > 1.5)

    @property
    def together(self) -> BoolArray:
        """Rows of markers that have something in common with others, (m,)."""
        return np.asarray(self.moving & self.several[self.pose])

    def mean(self, values: Array) -> Array:
        """Mean over the markers on the tool of each pose, (m, ...) -> (k, ...)."""
        out = np.zeros((len(self.count), *values.shape[1:]))
        np.add.at(out, self.pose[self.moving], values[self.moving])
        return np.asarray(out / np.maximum(self.count, 1.0).reshape(-1, *[1] * (values.ndim - 1)))

    def inner(self, values: Array) -> Array:
        """What each row has beside that mean, as large as without the mean taken off, (m, ...)."""
        more = np.sqrt(self.count / np.maximum(self.count - 1.0, 1.0))[self.pose].reshape(-1, *[1] * (values.ndim - 1))
        together = self.together.reshape(more.shape)
        return np.asarray(np.where(together, more * (values - self.mean(values)[self.pose]), values))

    def variance_of_mean(self, sigma: Array) -> Array:
        """Of independent noise, (m,) -> (k,)."""
        return np.asarray(self.mean((sigma**2)[:, None])[:, 0] / np.maximum(self.count, 1.0))

    def variance_of_inner(self, sigma: Array) -> Array:
        """Of independent noise, (m,) -> (m,)."""
        count = np.maximum(self.count, 1.0)[self.pose]
        beside = sigma**2 * (1.0 - 2.0 / count) + self.variance_of_mean(sigma)[self.pose]
        return np.asarray(np.where(self.together, beside * count / np.maximum(count - 1.0, 1.0), sigma**2))


def _left(taken_up: Array, variance: Array) -> float:
    """Ratio of a residual to the noise that it is of, where a fit takes up (n, 3, p) of noise with a variance (n,), m and m^2."""
    share = float((taken_up**2).sum()) / (3.0 * float(variance.sum()))
    return float(np.sqrt(max(1.0 - share, ABSOLUTE.least_left)))


def _spread(values: Array) -> float:
    """Robust standard deviation per coordinate."""
    return max(float(np.median(np.abs(values))) / 0.6745, 1e-9)
