# SPDX-License-Identifier: Apache-2.0
"""Where the joints and the TCP of a robot are, and the Jacobians of the paper, Eq. (2)-(3)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from ..typing import Array, BoolArray


@dataclass(frozen=True)
class Kinematics:
    """Where the joints and the TCP are in each row; n rows, k moving joints on the path base_link to tool0.

    Attributes:
        axis: unit vector of each actuated axis in base_link, shape (n, k, 3), Eq. (2) `e_i`.
        origin: URDF origin of each joint in base_link, shape (n, k, 3), m.
        R_joint: rotation of the frame that turns with each joint into base_link, shape (n, k, 3, 3).
        p_tcp: TCP in base_link, shape (n, 3), m.
        R_tool: rotation of tool0 into base_link, shape (n, 3, 3).
        is_prismatic: shape (k,).
        virtual_in_joint: the two unit vectors orthogonal to each axis, in the joint's own frame, shape (k, 2, 3).
    """

    axis: Array
    origin: Array
    R_joint: Array
    p_tcp: Array
    R_tool: Array
    is_prismatic: BoolArray
    virtual_in_joint: Array

    def jacobian(self, p_in_base: Array) -> Array:
        """Translational Jacobian of the actuated axes at one point per row, Eq. (2)-(3).

        Args:
            p_in_base: points fixed to tool0, shape (n, 3), m.

        Returns:
            shape (n, 3, k), m/rad (revolute) or 1 (prismatic).
        """
        lever = p_in_base[:, None, :] - self.origin
        columns = np.cross(self.axis, lever)
        columns = np.where(self.is_prismatic[None, :, None], self.axis, columns)
        return np.swapaxes(columns, 1, 2)

    @cached_property
    def virtual_axis(self) -> Array:
        """Unit vectors of the two virtual axes of each joint in base_link, shape (n, k, 2, 3)."""
        return np.einsum("nkij,kvj->nkvi", self.R_joint, self.virtual_in_joint)

    def virtual_jacobian(self, p_in_base: Array) -> Array:
        """Translational Jacobian of the virtual axes, shape (n, 3, 2k), ordered 1a, 1b, 2a, ...; m/rad."""
        lever = (p_in_base[:, None, :] - self.origin)[:, :, None, :]
        columns = np.cross(self.virtual_axis, lever)
        n, k = columns.shape[:2]
        return np.swapaxes(columns.reshape(n, 2 * k, 3), 1, 2)

    def changed(self, joint: int, shift: Array, turn: Array, p_in_base: Array) -> tuple[Kinematics, Array]:
        """With everything beyond a joint moved, as where its link is not as described.

        Args:
            joint: index.
            shift, turn: translation (3,) and rotation vector (3,) in the frame that turns with the joint, m and rad. What of the
                rotation is about the joint's own axis turns that frame too.
            p_in_base: points fixed to tool0, (n, 3), m.

        Returns:
            the kinematics, and where the points are then.
        """
        R, o = self.R_joint[:, joint], self.origin[:, joint]
        E = R @ Rotation.from_rotvec(turn).as_matrix() @ np.swapaxes(R, 1, 2)

        def there(p: Array) -> Array:
            return np.asarray(o + np.einsum("nij,nj->ni", E, p - o) + R @ shift)

        origin, axis, R_joint = self.origin.copy(), self.axis.copy(), self.R_joint.copy()
        beyond = range(joint + 1, origin.shape[1])
        for k in beyond:
            origin[:, k] = there(origin[:, k])
            axis[:, k] = np.einsum("nij,nj->ni", E, axis[:, k])
            R_joint[:, k] = E @ R_joint[:, k]
        own = R[0].T @ self.axis[0, joint]
        R_joint[:, joint] = R @ Rotation.from_rotvec(own * (turn @ own)).as_matrix()
        moved = replace(self, axis=axis, origin=origin, R_joint=R_joint, p_tcp=there(self.p_tcp), R_tool=E @ self.R_tool)
        return moved, there(p_in_base)


def cross_matrices(v: Array) -> Array:
    """Matrices with M w = v x w, (n, 3, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return out
