# SPDX-License-Identifier: Apache-2.0
"""What must hold between the values of a cell file, beyond what its schema says of each."""

from __future__ import annotations

import math
from typing import Any

from ..files.document import Document, short
from ..robot import Robot

PROCEDURE_SECTIONS = ("procedure", "workspace", "force_sensor", "acceptance")  # planning does without


def _norm(values: list[float]) -> float:
    return math.sqrt(sum(v * v for v in values))


def _quaternions(document: Document) -> None:
    places: list[tuple[str | int, ...]] = [("surface", "quat_xyzw")]
    if document.sound("stations"):
        places += [("stations", i, "quat_xyzw") for i in range(len(document.data["stations"]))]
    for place in places:
        check_quaternion(document, place)


def check_quaternion(document: Document, place: tuple[str | int, ...]) -> None:
    """Note a quaternion whose length is not 1."""
    if document.sound(*place):
        value: Any = document.data
        for step in place:
            value = value[step]
        if abs(_norm(value) - 1.0) > 1e-3:
            document.wrong(place, f"is {short(value)} of length {_norm(value):.4f}, must have length 1 (x, y, z, w)")


def check_direction(document: Document, *place: str) -> None:
    """Note a direction of length 0."""
    if document.sound(*place):
        value: Any = document.data
        for step in place:
            value = value[step]
        if not 1e-9 < _norm(value):
            document.wrong(place, f"is {short(value)}, a direction must not be 0")


def _rail(document: Document) -> None:
    check_direction(document, "robot", "rail", "axis")
    if document.sound("robot", "rail", "range"):
        low, high = document.data["robot"]["rail"]["range"]
        if low >= high:
            document.wrong(("robot", "rail", "range"), f"is {short([low, high])}, the lower end must come first and lie below")


def _surface(document: Document) -> None:
    if document.sound("surface", "radius") and 0.0 in document.data["surface"]["radius"]:
        document.wrong(("surface", "radius"), f"is {short(document.data['surface']['radius'])}, write 1e6 for a flat direction")


def _names(document: Document) -> None:
    if document.sound("stations"):
        seen: set[str] = set()
        for i, station in enumerate(document.data["stations"]):
            if station["name"] in seen:
                document.wrong(("stations", i, "name"), f"is {station['name']!r} again; every station has a name of its own")
            seen.add(station["name"])


def _loads(document: Document) -> None:
    """The load cases must be within what the contact holds, the sensor reads, and the run survives."""
    if not document.sound("load_cases"):
        return
    loads = document.data["load_cases"]
    held = loads["friction"] / loads["friction_safety"]
    for key in ("fx", "fy"):
        if loads[key] > held * loads["fz"]:
            document.wrong(
                ("load_cases", key),
                f"is {loads[key]:g} N across at {loads['fz']:g} N normal, which would slip; the contact holds"
                f" {held * loads['fz']:.0f} N (fz * friction / friction_safety); lower it or raise fz",
            )
    largest = math.hypot(loads["fz"], max(loads["fx"], loads["fy"]))
    if document.sound("procedure", "force_abort_n") and largest >= document.data["procedure"]["force_abort_n"]:
        limit = document.data["procedure"]["force_abort_n"]
        document.wrong(
            ("procedure", "force_abort_n"), f"is {limit:g} N, must be more than the largest load case, {largest:.0f} N"
        )
    if document.sound("force_sensor", "range_n"):
        reach, single = document.data["force_sensor"]["range_n"], max(loads["fx"], loads["fy"], loads["fz"])
        if single >= reach:
            document.wrong(("force_sensor", "range_n"), f"is {reach:g} N, the load cases need more: {single:g} N along one axis")


def _distances(document: Document) -> None:
    if document.sound("approach_distance") and document.sound("reference_distance"):
        near, far = document.data["reference_distance"], document.data["approach_distance"]
        if near >= far:
            document.wrong(
                ("reference_distance",), f"is {near:g} m, must be less than approach_distance, {far:g} m: it is nearer to contact"
            )


def _workspace(document: Document) -> None:
    if document.sound("workspace"):
        lower, upper = document.data["workspace"]["lower"], document.data["workspace"]["upper"]
        for axis, low, high in zip("xyz", lower, upper, strict=True):
            if low >= high:
                document.wrong(("workspace", "upper"), f"is {high:g} m in {axis}, must be more than lower, {low:g} m")


def _sensor(document: Document) -> None:
    check_direction(document, "force_sensor", "axis_in_tool0")


def _course(document: Document) -> None:
    if document.sound("course", "tool_x") and isinstance(document.data["course"]["tool_x"], list):
        check_direction(document, "course", "tool_x")


RULES = (_quaternions, _rail, _surface, _names, _loads, _distances, _workspace, _sensor, _course)


def check_robot(document: Document, robot: Robot) -> None:
    """Note what of a cell file does not fit its robot description."""
    n = robot.n_joints
    for key in ("home", "joint_names"):
        if document.sound("robot", key) and len(document.data["robot"][key]) != n:
            given = len(document.data["robot"][key])
            names = ", ".join(robot.joint_names)
            document.wrong(("robot", key), f"has {given} values, the description has {n} joints: {names}")
    if document.sound("robot", "home"):
        for k, q in enumerate(document.data["robot"]["home"]):
            low, high = float(robot.lower[k]), float(robot.upper[k])
            if not low <= q <= high:
                unit = "m" if robot.is_prismatic[k] else "rad; are these degrees?"
                document.wrong(
                    ("robot", "home", k), f"is {q:g}, {robot.joint_names[k]} has the limits {low:.4f} .. {high:.4f} {unit}"
                )
    if not (robot.effort > 0).all():
        names = ", ".join(name for name, e in zip(robot.joint_names, robot.effort, strict=True) if not e > 0)
        document.wrong(("robot", "urdf"), f"states no effort limit for {names}; give <limit effort=...> from the data sheet")
    if document.sound("force_sensor", "frame") and not robot.has_link(document.data["force_sensor"]["frame"]):
        frame = document.data["force_sensor"]["frame"]
        document.wrong(("force_sensor", "frame"), f"is {frame!r}, the robot description has no link of that name")
