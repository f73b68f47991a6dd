# SPDX-License-Identifier: Apache-2.0
"""What one pose tells about the compliances before anything is measured: observation blocks, information, uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import PlanError
from ..robot import Kinematics
from ..robot.kinetostatics import deflection_per_compliance
from ..typing import Array

_UNSEEN = 1e-9  # column length relative to the longest, below which no pose shows a parameter at all
_SMALLEST = 1e-12  # eigenvalue of the scaled Gram, relative to the largest, below which a direction is not identifiable


def observation_blocks(kin: Kinematics, forces_in_tool: Array, observed_in_tool: Array, *, bending: bool = True) -> Array:
    """Rows of Eq. (17) and (18) of every candidate pose under every load case.

    Args:
        kin: kinematics of n candidates.
        forces_in_tool: load cases, environment on robot at the TCP, in tool0, shape (M, 3), N.
        observed_in_tool: point whose displacement is observed (marker) or asked for (zeros: TCP), in tool0, shape (3,), m.
        bending: with the two virtual axes of each joint (18 DOF for six joints), or actuated axes only (6 DOF).

    Returns:
        shape (n, M, 3, p), N m^2/rad: displacement in base_link per unit compliance; actuated axes first, then virtual ones
        1a, 1b, 2a, ...
    """
    force = np.einsum("nij,mj->nmi", kin.R_tool, forces_in_tool)
    p_observed = kin.p_tcp + kin.R_tool @ observed_in_tool
    J_t, J_m = kin.jacobian(kin.p_tcp), kin.jacobian(p_observed)
    if bending:
        J_t = np.concatenate([J_t, kin.virtual_jacobian(kin.p_tcp)], axis=2)
        J_m = np.concatenate([J_m, kin.virtual_jacobian(p_observed)], axis=2)
    return deflection_per_compliance(J_m[:, None], force @ J_t)


def gram(blocks: Array) -> Array:
    """Sum of squares and products of each pose's rows, (n, M, 3, p) -> (n, p, p)."""
    rows = blocks.reshape(len(blocks), -1, blocks.shape[-1])
    return rows.swapaxes(1, 2) @ rows


def whitened(blocks: Array, sigma: Array) -> Array:
    """Blocks divided by their noise, for rows that are differences to one shared reference row.

    The M displacements of a pose have covariance sigma^2 (I + 1 1^T) in each coordinate: each has its own noise and all share
    that of the reference. blocks: (n, M, 3, p). sigma: noise of one reading per coordinate, (n,), m. Same shape as blocks.
    """
    M = blocks.shape[1]
    shared = (1.0 - 1.0 / np.sqrt(1.0 + M)) / M
    return (blocks - shared * blocks.sum(axis=1, keepdims=True)) / sigma[:, None, None, None]


@dataclass(frozen=True)
class Subspace:
    """The identifiable combinations of parameters: basis (p, r), chosen so that the mean Gram of the pool is the unit matrix.

    Criteria differ between bases only by a constant, so which poses are chosen does not depend on the basis.
    row_space: orthonormal basis (p, r) of the rows of all observation matrices, in which singular values are those of the
    observation matrix itself.
    """

    basis: Array
    row_space: Array

    @property
    def rank(self) -> int:
        return int(self.basis.shape[1])

    def reduce(self, matrix: Array) -> Array:
        """Gram matrices (..., p, p) in the identifiable combinations, (..., r, r)."""
        return self.basis.T @ matrix @ self.basis


def identifiable_subspace(grams: Array) -> Subspace:
    """Combinations of parameters that a whole pool can determine. grams: (n, p, p).

    Raises PlanError: no pose, or no load acts.
    """
    if len(grams) == 0:
        raise PlanError("the pool is empty: there is no pose to select from")
    mean = grams.mean(axis=0)
    scale = np.sqrt(np.diag(mean))
    if scale.max() == 0.0:
        raise PlanError("no load case moves the marker at any pose: check the load cases of the cell")
    # a column of rounding errors (an axis through the TCP bears no torque) must not be scaled up
    weight = np.where(scale > _UNSEEN * scale.max(), 1.0 / np.maximum(scale, 1e-300), 0.0)
    value, vector = np.linalg.eigh(mean * np.outer(weight, weight))
    keep = value > _SMALLEST * value[-1]
    basis = vector[:, keep] / np.sqrt(value[keep]) * weight[:, None]
    return Subspace(basis, np.linalg.qr(vector[:, keep] * np.where(weight > 0, scale, 0.0)[:, None])[0])


def observability(reduced_gram: Array, subspace: Subspace, rows: int) -> float:
    """O1 of Eq. (20) on the identifiable subspace: geometric mean of the singular values / sqrt(3 N M), N m^2/rad.

    reduced_gram: (r, r) sum over the chosen poses, in the basis of `subspace`. rows: 3 N M.
    """
    sign, log_det = np.linalg.slogdet(reduced_gram)
    if sign <= 0:
        return 0.0
    # A basis = (A row_space) (row_space^T basis): take the determinant of the second factor out again
    volume = np.linalg.slogdet(subspace.row_space.T @ subspace.basis)[1]
    return float(np.exp((0.5 * log_det - volume) / subspace.rank) / np.sqrt(rows))


def condition_number(total_gram: Array, rank: int) -> float:
    """Condition number of the observation matrix of chosen poses: largest / rank-th singular value, columns of length 1.

    total_gram: sum over the chosen poses, (p, p). rank: number of identifiable combinations.
    """
    scale = np.sqrt(np.diag(total_gram))
    weight = np.where(scale > _UNSEEN * scale.max(), 1.0 / np.maximum(scale, 1e-300), 0.0)
    value = np.linalg.eigvalsh(total_gram * np.outer(weight, weight))[::-1]
    smallest = value[rank - 1]
    return float(np.sqrt(value[0] / smallest)) if smallest > 1e-15 * value[0] else float("inf")


def predicted_uncertainty(information: Array, subspace: Subspace, blocks: Array) -> Array:
    """Standard deviation of the predicted deflection that the noise of a calibration leaves, before it is measured.

    Args:
        information: (r, r) sum over the chosen poses of the whitened Gram, in the basis of `subspace`, 1/m^2.
        blocks: observation blocks of the TCP at the work poses, (n, M, 3, p).

    Returns:
        sqrt of the trace of the covariance for each work pose and load case, (n, M), m.
    """
    try:
        L = np.linalg.cholesky(information)
    except np.linalg.LinAlgError:
        return np.full(blocks.shape[:2], np.inf)
    spread = np.linalg.solve(L, subspace.basis.T)
    return np.sqrt(np.sum((blocks @ spread.T) ** 2, axis=(2, 3)))
