# SPDX-License-Identifier: Apache-2.0
"""Services by which the tool load is identified in the cell: turn the tool, record, turn, record, ..., identify."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from irec_calibration.commands.tool_load import describe
from irec_calibration.errors import IrecError
from irec_calibration.sensors.tool_load import ToolLoad
from rclpy.node import Node
from std_srvs.srv import Trigger

from ..orientations import Orientations


def create_services(node: Node, orientations: Orientations, put_in_force: Callable[[ToolLoad], str]) -> list[tuple[Any, Any]]:
    """`irec/wrench/record_orientation` and `irec/wrench/identify_tool_load` (std_srvs/Trigger).

    Args:
        put_in_force: takes the new load; empty, or why it was not taken.

    Returns:
        (destroy function, entity) of each service.
    """

    def record(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = f"orientation {orientations.record()} recorded"
            response.success = True
        except IrecError as error:
            response.message = str(error)
        return response

    def identify(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            fit = orientations.identify()
        except IrecError as error:
            response.message = str(error)
            return response
        refused = put_in_force(fit.load)
        response.success = not refused
        response.message = f"{describe(fit)}\n{refused or 'in force until the node ends; keep it by the parameters tool_load.*'}"
        return response

    made = (
        node.create_service(Trigger, "irec/wrench/record_orientation", record),
        node.create_service(Trigger, "irec/wrench/identify_tool_load", identify),
    )
    return [(node.destroy_service, service) for service in made]
