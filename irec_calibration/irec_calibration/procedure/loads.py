# SPDX-License-Identifier: Apache-2.0
"""Load cases with larger forces across the tool than those of the cell file, as far as contact, sensor and drives bear them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..cell import Cell
from ..errors import CellError, PlanError
from ..poses.checker import overloaded
from ..poses.store import PoseList
from .checks import SLIP_MARGIN
from .settings import Settings, check_loads

STEP = 0.05  # between two factors that are tried


def with_lateral(cell: Cell, factor: float) -> Cell:
    """The cell with load cases of which the forces across the tool are multiplied; those along it stay."""
    return replace(cell, forces_in_tool=cell.forces_in_tool * np.array([factor, factor, 1.0]))


def loaded_as_asked(cell: Cell, settings: Settings, poses: PoseList, path: str) -> Cell:
    """The cell with the load cases that a pose file asks for.

    Raises:
        PlanError: the contact would slip, or the run be aborted, with these.
    """
    if poses.lateral_factor == 1.0:
        return cell
    loaded = with_lateral(cell, poses.lateral_factor)
    try:
        check_loads(loaded, settings)
    except CellError as error:
        raise PlanError(f"{path}: lateral_factor is {poses.lateral_factor:g}: {error}") from error
    return loaded


def largest_lateral(cell: Cell, settings: Settings, poses: PoseList, most: float) -> float:
    """The largest factor, 1 to `most`, with which no row is rejected, no limit of the cell file reached at any of the poses."""
    q = np.array([p.q for p in poses.poses])
    kin = cell.robot.kinematics(q)
    for factor in np.arange(round(most / STEP), round(1.0 / STEP), -1) * STEP:
        loaded = with_lateral(cell, float(factor))
        if _held(loaded, settings) and not overloaded(loaded, q, kin).any():
            return round(float(factor), 2)
    return 1.0


def _held(loaded: Cell, settings: Settings) -> bool:
    """Whether the run takes these forces and accepts the rows, wherever the force controller comes to rest."""
    try:
        check_loads(loaded, settings)
    except CellError:
        return False
    off = settings.settling.force_n
    f = loaded.forces_in_tool
    lateral, normal = np.hypot(f[:, 0], f[:, 1]) + off, np.abs(f[:, 2]) - off
    holds = lateral <= SLIP_MARGIN * settings.friction * normal
    size = np.linalg.norm(f, axis=1) + off
    return bool(np.all(holds & (size < settings.force_abort_n)) and np.abs(f).max() + off < settings.sensor_range_n)
