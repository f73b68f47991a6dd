# SPDX-License-Identifier: Apache-2.0
"""What the raw sensor weighs while the wrist turns, against the mass that robot description and cell file say it carries.

A sensor that is read in pounds, or with half its gain, passes every other check: the force control of the robot, which uses it
too, reaches each set point, with several times the force.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..cell import Cell
from ..robot import Robot
from ..typing import Array

GRAVITY = np.array([0.0, 0.0, -9.81])
WEIGHT_REST = 15.0  # N of wrench_raw that weight and bias leave, at most
LOW, HIGH = 0.7, 1.4  # of the mass that is stated: what cables, hoses and a forgotten adapter plate do not explain
LEAST_STATED = 0.5  # kg; a lighter tool is not weighed well enough
SURE, DRIFT = 3.0, 5.0  # standard errors of the mass, and N of drift and hoses, which the limits are wider by
RUN_LOW, RUN_HIGH = 0.6, 1.7  # likewise in a run, which nobody watches: what is beyond is another scale
RUN_LEAST = 0.05  # of the mass that is stated; a sensor that weighs less seems to be set to zero at each pose
RUN_SPREAD = 10.0  # m^2/s^4, sum of squares of gravity in the sensor's frame about its mean: two orientations 26 degrees apart
UNITS = (
    (0.2248, "pounds (lbf), N is needed"), (0.102, "kilograms (kgf), N is needed"), (1e-3, "kN, N is needed"),
    (1e3, "mN, N is needed"), (4.448, "N that were taken for pounds and converted once more"),
    (9.807, "N that were taken for kilograms and converted once more"),
)  # fmt: skip
UNIT_NEAR = 1.15  # ratio to one of these within which it is likely
POUNDS = UNITS[0][0] * UNIT_NEAR  # of the mass that is stated: the scale that does most harm of those that are met


@dataclass(frozen=True)
class Weighed:
    """Mass, kg, with its standard error, kg.

    rest: largest of the forces that mass and a constant bias leave, N. spread: sum of squares of gravity in the sensor's frame
    about its mean, m^2/s^4: how much the orientations tell.
    """

    mass: float
    error: float
    rest: float
    spread: float

    @property
    def slack(self) -> float:
        """By how much limits of the mass are to be wider, kg."""
        return SURE * self.error + DRIFT / max(np.sqrt(self.spread), 1e-3)


def weigh(R_sensor_in_base: Array, force: Array) -> Weighed:
    """Mass and bias by least squares. R_sensor_in_base: (n, 3, 3). force: of the raw sensor in its frame, (n, 3), N; n >= 2."""
    down = np.einsum("nji,j->ni", R_sensor_in_base, GRAVITY)  # free fall in the sensor's frame: raw = mass * down + bias
    off = down - down.mean(axis=0)
    spread = float((off * off).sum())
    mass = float((off * (force - force.mean(axis=0))).sum()) / max(spread, 1e-12)
    left = force - force.mean(axis=0) - mass * off
    sigma = float(np.sqrt((left * left).sum() / max(1, left.size - 4)))
    return Weighed(mass, sigma / max(np.sqrt(spread), 1e-6), float(np.abs(left).max()), spread)


def stated_mass(cell: Cell) -> tuple[float, float]:
    """Mass beyond the force sensor by the robot description and `tool.payload` of the cell file, kg: without and with the link
    that is the sensor, part of which it may feel. (0, 0) where neither states one, or the description does not have the sensor
    between arm and tool."""
    root = ElementTree.fromstring(cell.robot.completed_urdf)
    children: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            children.setdefault(str(parent.get("link")), []).append(str(child.get("link")))
    masses = {}
    for link in root.findall("link"):
        mass = link.find("inertial/mass")
        masses[str(link.get("name"))] = 0.0 if mass is None else float(mass.get("value") or 0.0)
    sensor = cell.raw["force_sensor"]["frame"]
    beyond: list[str] = []
    follow = list(children.get(sensor, []))
    while follow:
        beyond.append(follow.pop())
        follow += [name for name in children.get(beyond[-1], []) if name not in beyond]
    total = cell.payload.mass + sum(masses.get(name, 0.0) for name in beyond)
    if "tool0" not in beyond or total <= 0.0:
        return 0.0, 0.0
    return total, total + masses.get(sensor, 0.0)


def nothing_stated(cell: Cell) -> str:
    """Why the weight on the raw force sensor can't be compared with what is stated, in a sentence; empty where it can."""
    low = stated_mass(cell)[0]
    if low >= LEAST_STATED:
        return ""
    nothing = (
        "state no mass (or the description has no such link before tool0)"
        if low == 0.0
        else f"state {low:g} kg, at least {LEAST_STATED:g} kg are needed"
    )
    return f"beyond {cell.raw['force_sensor']['frame']} the robot description and tool.payload of the cell file {nothing}"


def mass_verdict(w: Weighed, cell: Cell) -> tuple[bool | None, str, str, str]:
    """Whether what was weighed is what is carried: passed, figure, limit and advice of an item; None: it can't be said. The sign
    is judged elsewhere."""
    low, high = stated_mass(cell)
    seen, slack = abs(w.mass), w.slack
    if nothing := nothing_stated(cell):
        return None, f"{seen:.1f} kg are weighed, and {nothing}", "", (
            "state tool.payload.mass, or the masses of the links, and check again; till then compare with the tool's weight"
        )  # fmt: skip
    passed = LOW * low - slack <= seen <= HIGH * high + slack
    stated = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    ratio = seen / (0.5 * (low + high))
    figure = f"{seen:.1f} kg are weighed, {stated} kg are stated (links beyond the sensor, tool.payload): {ratio:.3g} of it"
    limit = f"{LOW * low - slack:.1f} to {HIGH * high + slack:.1f} kg"
    if passed and not tells_pounds(w, LOW, low):
        return None, figure, limit, "so light a tool, or so little turned, does not tell the scale: hang a known weight on it"
    return passed, figure, limit, scale_advice(ratio)


def tells_pounds(w: Weighed, share: float, stated: float) -> bool:
    """Whether a sensor that reads in pounds would have been beyond the lower limit, `share` of the mass that is stated, kg."""
    return w.spread >= RUN_SPREAD and share * stated - w.slack > POUNDS * stated


def scale_advice(ratio: float) -> str:
    """What a force that reads `ratio` of what acts is likely to be; the cell file may be wrong as well."""
    return (
        f"{likely_scale(ratio)}. Hang a known weight on the tool; or mend the mass in the description or the cell file, where"
        " that is wrong"
    )


def likely_scale(ratio: float) -> str:
    """What a force that reads `ratio` of what acts is likely to be, and what that means, without a full stop."""
    unit = next((u for factor, u in UNITS if max(ratio, 1e-9) / factor < UNIT_NEAR and factor / max(ratio, 1e-9) < UNIT_NEAR), "")
    likely = f"it seems to be in {unit}" if unit else f"the sensor's gain seems to be {ratio:.2g} of what it should be"
    return f"{likely}; with such a scale the robot presses with {1.0 / max(ratio, 1e-9):.3g} times the force that is asked for"


def sensor_in_tool(robot: Robot, name: str) -> Array:
    """Rotation of the sensor's frame into tool0, (3, 3), from the robot description; the identity where it has no such frame."""
    model = pin.buildModelFromXML(robot.completed_urdf)
    if not model.existFrame(name):
        return np.eye(3)
    sensor, tool = (model.frames[model.getFrameId(frame)] for frame in (name, "tool0"))
    return np.array(tool.placement.actInv(sensor.placement).rotation)
