# SPDX-License-Identifier: Apache-2.0
"""What all other poses say of the rows of one pose: a flexible model, fitted robustly, predicts every pose without its own rows.

Rows that are plainly wrong have to stand out from it; a missing effect, which bends many poses, must not. So beside the columns
of the model there are generic ones (every axis, its torque and angle, forces in base and tool); the session sets their size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects.scene import Scene
from ..model import Term
from ..typing import Array, BoolArray, IntArray
from .noise import Whitening
from .observe import Observation
from .system import linearise
from .triangles import inverse_of_triangles

ROUNDS = 8  # of reweighting
TAIL_DOF = 4.0  # of the Student-t by which rows are weighted
MIDDLE = 2.366  # median of chi squared with three degrees of freedom
LEVELS = (0.0, 0.3, 1.0, 3.0)  # widths of the generic columns, in multiples of what the plain model leaves
CHOOSE_BY = 1500  # rows at most for which several widths are tried
RIDGE = 1e-9
MOST_INFLATED = 1e3  # of a row's standard deviation: more is lost to rounding
CLIPPED = 16.0  # squared: beyond, a row does not count when widths are compared
CHUNK = 400  # blocks at a time


@dataclass(frozen=True)
class Block:
    """Rows that share noise (a pose and repeat), against what the other poses predict. All in m.

    Attributes:
        rows: index of the observed rows, (s,).
        residual: measured minus predicted from the other poses, (s, 3).
        precision: inverse of the predictive covariance, (3s, 3s), row-major in (row, coordinate).
    """

    rows: IntArray
    residual: Array
    precision: Array

    def gain(self, weights: Array) -> tuple[float, Array]:
        """How much of the squared residual (in standard deviations) one displacement explains that enters row i with weights[i].

        Returns:
            what it explains, and the displacement, (3,), m.
        """
        D = np.kron(weights[:, None], np.eye(3))
        h = D.T @ (self.precision @ self.residual.ravel())
        x: Array = np.asarray(np.linalg.solve(D.T @ self.precision @ D, h))
        return float(h @ x), x

    @property
    def squared(self) -> float:
        r = self.residual.ravel()
        return float(r @ self.precision @ r)


@dataclass(frozen=True)
class Neighbours:
    """Result of the robust flexible fit.

    Attributes:
        blocks: one per pose and repeat.
        z: of each observed row: by how many robust standard deviations (norm of three) it alone stands out, (m,).
        weight: of each row by the Student-t, (m,), 1 at most.
        scale: robust standard deviation in units of the stated noise.
        predicted: what the flexible model expects, (m, 3), m.
    """

    blocks: tuple[Block, ...]
    z: Array
    weight: Array
    scale: float
    predicted: Array


def neighbours(observation: Observation, terms: Sequence[Term]) -> Neighbours:
    """Predict every pose from all others, robustly.

    Args:
        observation: m rows.
        terms: with values; linearised there.
    """
    m = len(observation.rows)
    columns, flexible = _columns(observation, terms)
    b = observation.y
    levels = LEVELS if m <= CHOOSE_BY else (0.0, 1.0)
    found: list[tuple[float, Neighbours]] = []
    plain = 1.0
    for level in levels:
        use = ~flexible if level == 0.0 else np.ones(len(flexible), dtype=bool)
        precision = np.where(flexible[use], 1.0 / (max(level, 1e-3) * plain) ** 2, 0.0)
        one = _robust(columns[:, :, use], b, observation.whiten, precision)
        if level == 0.0:
            plain = one.scale
        found.append((float(np.minimum(one.z**2, CLIPPED).mean()) * one.scale**2, one))
    return min(found, key=lambda scored: scored[0])[1]


def _columns(observation: Observation, terms: Sequence[Term]) -> tuple[Array, BoolArray]:
    """Columns of the model and generic ones, (m, 3, q), each with a root mean square of one standard deviation, and which
    are generic."""
    system = linearise(terms, observation)
    own = observation.whiten.undo(system.A.reshape(len(observation.rows), 3, -1))
    more = observation.of(_generic(observation.scene, observation.session.kind == "absolute"))
    A = np.concatenate([own, more], axis=2)
    size = np.sqrt((observation.whiten(A) ** 2).mean(axis=(0, 1)))
    keep = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-30)
    return A[:, :, keep] / size[keep], (np.arange(A.shape[2]) >= own.shape[2])[keep]


def _generic(scene: Scene, absolute: bool) -> Array:
    """Displacements that no effect in particular makes, (n, 3, g)."""
    J, q = scene.J, scene.q
    tau = scene.load_torque()
    total = scene.tau + scene.tau_gravity
    tau = tau / np.maximum(np.abs(tau).max(axis=0), 1e-9)
    total = total / np.maximum(np.abs(total).max(axis=0), 1e-9)
    sine, cosine = np.sin(q), np.cos(q)
    about_axes = [tau, tau * sine, tau * cosine, tau * np.abs(tau), np.tanh(8.0 * total)]
    if absolute:
        about_axes += [sine, cosine, np.sin(2 * q), np.cos(2 * q)]
    out = [J * a[:, None, :] for a in about_axes]
    moves = scene.moves_with_arm[:, None, None]
    V = scene.V
    load = scene.total(scene.tau_virtual, lambda: scene.gravity.tau_virtual)
    out.append(V * (load / np.maximum(np.abs(load).max(axis=0), 1e-9))[:, None, :])
    if not absolute:
        R = scene.kin.R_tool
        for frame, force in ((R, scene.force_in_tool), (np.broadcast_to(np.eye(3), R.shape), scene.force)):
            f = force / max(float(np.abs(force).max()), 1e-9)
            out += [frame * f[:, a, None, None] * moves for a in range(3)]
        d = scene.p_observed - scene.p_observed[np.maximum(scene.reference, 0)]
        out.append(np.concatenate([d[:, :, None], np.stack([np.cross(e, d) for e in np.eye(3)], axis=2)], axis=2))
        span = max(float(np.ptp(scene.stamp)), 1e-9)
        out.append(np.tile(np.eye(3), (len(scene), 1, 1)) * (scene.stamp / span)[:, None, None])
    return np.concatenate(out, axis=2)


def _robust(A: Array, y: Array, whiten: Whitening, precision: Array) -> Neighbours:
    """Iteratively reweighted fit; the prediction of every block without its own rows."""
    inflate = np.ones(len(y))
    scale = 1.0
    blocks = _block_rows(whiten)
    z = np.zeros(len(y))
    made: list[tuple[IntArray, Array, Array]] = []
    for _ in range(ROUNDS):
        now = _inflated(whiten, inflate)
        made, z_new, predicted = _predict(A, y, whiten, now, precision / scale**2, blocks)
        scale_new = max(float(np.sqrt(np.median(z_new**2) / MIDDLE)), 1e-6)
        z = z_new / scale_new
        weight = np.minimum(1.0, (TAIL_DOF + 3.0) / (TAIL_DOF + z**2))
        new = np.minimum(1.0 / np.sqrt(weight), MOST_INFLATED)
        settled = abs(scale_new - scale) < 1e-3 * scale and np.abs(np.log(new / inflate)).max() < 0.02
        scale, inflate = scale_new, new
        if settled:
            break
    found = tuple(Block(rows, r, Q / scale**2) for rows, r, Q in made)
    return Neighbours(found, z, 1.0 / inflate**2, scale, predicted)


def _inflated(whiten: Whitening, inflate: Array) -> Whitening:
    return replace(whiten, sigma=whiten.sigma * inflate)


def _block_rows(whiten: Whitening) -> list[IntArray]:
    """Rows of each group, groups of one size stacked, (groups, s)."""
    order = np.argsort(whiten.group, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(whiten.group[order])) + 1)
    by_size: dict[int, list[IntArray]] = {}
    for rows in parts:
        by_size.setdefault(len(rows), []).append(rows)
    return [np.stack(p) for p in by_size.values()]


def _predict(
    A: Array, y: Array, whiten: Whitening, weighted: Whitening, precision: Array, blocks: list[IntArray]
) -> tuple[list[tuple[IntArray, Array, Array]], Array, Array]:
    """Leave-one-block-out residuals (m), precision of each block and how far each row alone stands out (standard deviations)."""
    q = A.shape[2]
    Aw, bw = weighted(A), weighted(y)
    flat = Aw.reshape(-1, q)
    H = flat.T @ flat
    H += np.diag(precision + RIDGE * max(float(H.diagonal().max(initial=0.0)), 1e-30))
    L = np.linalg.cholesky(H)
    x = np.linalg.solve(L.T, np.linalg.solve(L, flat.T @ bw.ravel()))
    rw = bw - Aw @ x
    inverse = inverse_of_triangles(L[None])[0]
    made, z = [], np.empty(len(y))
    for stacked in blocks:
        s = stacked.shape[1]
        eye = np.eye(3 * s)
        for start in range(0, len(stacked), CHUNK):
            index = stacked[start : start + CHUNK]
            V = Aw[index].reshape(len(index), 3 * s, q) @ inverse.T
            T = np.linalg.inv(eye - V @ np.swapaxes(V, 1, 2) + 1e-9 * eye)
            r = T @ rw[index].reshape(len(index), 3 * s, 1)
            Lw, N = _factor(weighted, index), _covariance(whiten, index)
            S = Lw @ T @ np.swapaxes(Lw, 1, 2) - Lw @ np.swapaxes(Lw, 1, 2) + N
            raw = Lw @ r
            Q = np.linalg.inv(S)
            u = (Q @ raw).reshape(len(index), s, 3)
            own = Q.reshape(len(index), s, 3, s, 3)[:, np.arange(s), :, np.arange(s), :]  # (s, B, 3, 3)
            gain = np.einsum("sbi,sbi->sb", u.swapaxes(0, 1), np.linalg.solve(own, u.swapaxes(0, 1)[..., None])[..., 0])
            z[index] = np.sqrt(np.maximum(gain.T, 0.0))
            made += [(index[i], raw[i].reshape(s, 3), Q[i]) for i in range(len(index))]
    return made, z, A @ x


def _covariance(whiten: Whitening, index: IntArray) -> Array:
    """Noise of the rows of each block, (B, 3s, 3s)."""
    s = index.shape[1]
    rows = whiten.sigma[index][:, :, None] ** 2 * np.eye(s) + whiten.sigma_reference[index][:, :1, None] ** 2
    return np.einsum("bij,kl->bikjl", rows, np.eye(3)).reshape(len(index), 3 * s, 3 * s)


def _factor(whiten: Whitening, index: IntArray) -> Array:
    """Cholesky factor of the same."""
    return np.asarray(np.linalg.cholesky(_covariance(whiten, index)))
