# SPDX-License-Identifier: Apache-2.0
"""`check_driver`: does a live driver keep the contract? Level by level, with a report item by item.

    ros2 run irec_calibration check_driver --ros-args -p cell:=cell.yaml                         listens only
    ... -p level:=moves -p approach:=true         goes to HOME and above the first pose first, then moves in free air there
    ... -p level:=pressing -p approach:=true -p surface_confirmed:=true      presses 200 N on the surface at the first pose
    ... -p level:=offset                          sends correction offsets of a millimetre in free air

Each level does those before it. Exit code 0: nothing failed (what could not be checked is named), 1: something failed, 2: bad
input or no driver.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

import rclpy
from irec_ros.guard import GuardedNode
from irec_ros.parameters import P, Parameters
from irec_ros.startup import begin, refuse_unknown_parameters
from rclpy.exceptions import ParameterException

from ..cell import read_cell
from ..driver_check.moving import BEFORE_PRESSING
from ..driver_check.observed import Item, conclusion, report
from ..driver_check.weighing import MASS
from ..errors import CellError, IrecError
from ..files import check_replaceable
from ..poses.store import read_poses
from ..procedure.axes import read_axes
from ..procedure.settings import read_settings
from . import driver_levels
from .driver_client import DriverClient

LEVELS = ("passive", "moves", "offset", "pressing")
FREE = 0.10  # m above the surface for moves in free air
REPORT = rb'\A\[\s*(\]|\{\s*"level")'  # how a report begins
PARAMETERS = (
    P("cell", "", "cell file (irec-cell/1)"),
    P("level", "passive", f"how far to go: {', '.join(LEVELS)}; each does those before it"),
    P("approach", False, "go to HOME, then above the first pose of the cell's pose file; false: check where the robot stands"),
    P("surface_confirmed", False, "somebody has seen that the surface is where the cell file says and the way to it is free"),
    P("report", "", "JSON file for the report; empty: none"),
)


def run(node: GuardedNode) -> list[Item]:
    """All levels asked for. IrecError: bad input, or a driver that does not answer."""
    p = Parameters(node, PARAMETERS)
    refuse_unknown_parameters(node)
    if not p["cell"]:
        raise CellError("parameter 'cell' is empty; name a cell file, e.g. -p cell:=config/cells/afp.yaml")
    if p["level"] not in LEVELS:
        raise CellError(f"parameter 'level' is '{p['level']}', one of {', '.join(LEVELS)} is needed")
    levels = LEVELS[: LEVELS.index(p["level"]) + 1]
    if "pressing" in levels and not (p["surface_confirmed"] and p["approach"]):
        raise CellError("level pressing needs -p approach:=true and -p surface_confirmed:=true: it presses on the first pose")
    if p["report"]:
        check_replaceable(p["report"], "a report of check_driver", (REPORT,))
    cell = read_cell(p["cell"])
    axes, settings = read_axes(cell), read_settings(cell)
    client = DriverClient(node)
    items = driver_levels.passive(client, cell, axes)
    print(report(items), flush=True)
    if len(levels) > 1 and any(item.failed for item in items):
        print("the robot is not moved while the passive level fails", flush=True)
        levels = LEVELS[:1]
    pose = None
    if p["approach"] and len(levels) > 1:
        pose = read_poses(cell.poses_path, cell.serial, cell.robot.sha256).poses[0]
    rail = pose.ext.get("rail", 0.0) if pose is not None else 0.0
    for level in levels[1:]:
        if level == "pressing" and (why := [item.name for item in items if item.name in BEFORE_PRESSING and item.failed]):
            print(f"nothing is pressed while this fails: {', '.join(why)}", flush=True)
            break
        if level == "pressing" and any(item.name == MASS and not item.checked for item in items):
            print("the scale of the force was not checked: watch how hard it presses, hand at the emergency stop", flush=True)
        if pose is not None:
            distance = cell.reference_distance if level == "pressing" else FREE
            there = driver_levels.above_surface(client, cell, axes, settings, pose.q, rail, distance)
            if not there.success:
                items.append(Item(level, "way to the first pose", False, there.message, "", "see the message of the driver"))
                break
        found = {
            "moves": lambda: driver_levels.moves(client, cell, axes, settings),
            "offset": lambda: driver_levels.offset(client),
            "pressing": lambda: driver_levels.pressing(client, settings),
        }[level]()
        print(report(found), flush=True)
        items += found
    if pose is not None:
        p_tcp, R = client.tcp()
        client.move_line(p_tcp - FREE * R[:, 2], R, settings.linear_speed)
    if p["report"]:
        Path(p["report"]).write_text(json.dumps([asdict(item) for item in items], indent=1), encoding="utf-8")
    return items


def main() -> int:
    """Check once and end."""
    if not begin("check_driver"):
        return 2
    try:
        items = run(GuardedNode("check_driver"))
    except (IrecError, ParameterException, OSError) as error:
        print(f"check_driver: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    finally:
        rclpy.try_shutdown()
    print(conclusion(items))
    return 1 if any(item.failed for item in items) else 0


if __name__ == "__main__":
    sys.exit(main())
