# SPDX-License-Identifier: Apache-2.0
"""The offset of the TCP as an offset of each joint, for controllers that take joint positions only."""

from __future__ import annotations

import numpy as np
from irec_calibration.robot import Robot
from irec_calibration.typing import Array

DAMPING = 0.02  # m and rad: singular values of the Jacobian (1 m for 1 rad) well below it are not asked for
LARGEST = 0.05  # rad or m of one joint; the rest of the offset is left out


def joint_offset(robot: Robot, q: Array, translation: Array, rotation: Array) -> Array:
    """What is to be added to each joint, (k,), rad or m: dq = J^T (J J^T + d^2)^-1 (t, r), scaled down where a joint passes 0.05.

    Near a singularity less than the whole offset comes out, never a large step of a joint.

    Args:
        q: joint angles (k,). translation: m, rotation: rotation vector, rad, of tool0 in base_link (3,).
    """
    wanted = np.concatenate([translation, rotation])
    if not wanted.any():
        return np.zeros(robot.n_joints)
    at = robot.kinematics(q[None])
    angular = np.where(at.is_prismatic[:, None], 0.0, at.axis[0]).T
    J = np.vstack([at.jacobian(at.p_tcp)[0], angular])
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    # plain inverse of what is large enough; below it fades out as s / d^2
    inverse = np.where(s > DAMPING, 1.0 / np.maximum(s, DAMPING), s / DAMPING**2)
    step = Vt.T @ (inverse * (U.T @ wanted))
    largest = float(np.abs(step).max())
    return np.asarray(step * min(1.0, LARGEST / largest))
