# SPDX-License-Identifier: Apache-2.0
"""The one writing of the paper's linear relation between compliances and deflection, Eq. (11) and (14)."""

from __future__ import annotations

from ..typing import Array


def deflection_per_compliance(J: Array, torque: Array) -> Array:
    """Deflection of a point per unit compliance of each axis: J diag(tau), one row of Eq. (14), of O_a and O_v in Eq. (17)-(18).

    Args:
        J: translational Jacobian at the observed point, (..., 3, k), m/rad.
        torque: about each axis, J_t^T f of Eq. (9), (..., k), N m.

    Returns:
        (..., 3, k), N m^2/rad: times the compliances it is the deflection, Eq. (11).
    """
    rows: Array = J * torque[..., None, :]
    return rows
