# SPDX-License-Identifier: Apache-2.0
"""Items about the weight of the tool on the raw sensor."""

from __future__ import annotations

from collections.abc import Iterator

from ..cell import Cell
from ..procedure.weighing import WEIGHT_REST, mass_verdict, sensor_in_tool, weigh
from ..typing import Array

MASS = "mass of the tool on wrench_raw"  # name of an item
LEAST_MASS = 0.5  # kg; a lighter tool has no sign


def weight_items(R_tool_in_base: Array, force: Array, cell: Cell) -> Iterator[tuple[str, bool | None, str, str, str]]:
    """Name, passed (None: not checked), figure, limit and advice of each item on the weight on wrench_raw. force: (n, 3), N."""
    w = weigh(R_tool_in_base @ sensor_in_tool(cell.robot, cell.raw["force_sensor"]["frame"]), force)
    yield (
        "weight on wrench_raw turns with the wrist",
        w.rest <= WEIGHT_REST,
        f"{w.rest:.1f} N besides a weight of {w.mass:.1f} kg and a bias",
        f"{WEIGHT_REST:g} N",
        "is wrench_raw in the frame that the cell file names (force_sensor.frame), which the description places as on the robot?",
    )
    yield (
        "sign of wrench_raw",
        w.mass > -LEAST_MASS,
        f"a tool of {w.mass:.1f} kg",
        "not negative",
        "the sign is turned: what the environment exerts on the robot; a tool that hangs pulls down",
    )
    yield (MASS, *mass_verdict(w, cell))
