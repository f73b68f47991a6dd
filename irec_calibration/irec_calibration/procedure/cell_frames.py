# SPDX-License-Identifier: Apache-2.0
"""The frames of a cell beside those of its robot: base_link on its rail, tracker stations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from ..cell import Cell
from ..robot.transforms import Transform
from ..typing import Array
from .axes import read_axes

CELL_FRAME = "cell"
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True)
class CellFrames:
    """What stands still in a cell, and what rides on its rail.

    Attributes:
        urdf: text of the robot description; joints: name in `joint_states` -> name in the description.
        fixed: frames that never move; rail: joint name and unit direction in the cell frame (3,), None where there is none.
    """

    urdf: str = ""
    joints: dict[str, str] = field(default_factory=dict)
    fixed: tuple[Transform, ...] = ()
    rail: tuple[str, Array] | None = None

    def on_rail(self, positions: Mapping[str, float]) -> list[Transform]:
        """base_link in the cell at the rail's position, m; nothing where the rail is not named."""
        if self.rail is None or self.rail[0] not in positions:
            return []
        return [Transform(CELL_FRAME, "base_link", positions[self.rail[0]] * self.rail[1], LEVEL)]


NO_CELL = CellFrames()


def cell_frames(cell: Cell) -> CellFrames:
    """Frames `cell`, `station_NAME`, and `base_link` in the cell."""
    names = read_axes(cell).driver
    turned = [Rotation.from_matrix(s.R_in_cell).as_quat() for s in cell.stations]
    stations = tuple(
        Transform(CELL_FRAME, f"station_{s.name}", s.p_in_cell, quat) for s, quat in zip(cell.stations, turned, strict=True)
    )
    joints = dict(zip(names, cell.robot.joint_names, strict=False))
    if cell.rail is None:
        return CellFrames(cell.robot.urdf_text, joints, (Transform(CELL_FRAME, "base_link", np.zeros(3), LEVEL), *stations))
    return CellFrames(cell.robot.urdf_text, joints, stations, (names[-1], cell.rail.axis))
