# SPDX-License-Identifier: Apache-2.0
"""What one pass over the poses leaves in the table, before it is written."""

from __future__ import annotations

from dataclasses import dataclass

from .kinematics import Array, IntArray


@dataclass(frozen=True)
class Pass:
    """N poses, M + 1 rows each in the order of time, row 0 the reference. SI units.

    Attributes:
        pose: number in the table, (N,); case: load case of each row, (N, M + 1).
        stamp: s; q: reported, rad; p_controller: in base_link; marker: in the frame of the station; force: reading in tool0.
    """

    pose: IntArray
    case: IntArray
    stamp: Array
    q: Array
    p_controller: Array
    marker: Array
    force: Array
