# SPDX-License-Identifier: Apache-2.0
"""Whether a model may come into force: it belongs to this robot and tool, and everything in it is physically possible.

A model file can be edited, mixed up, or come from a session that was measured with a wrong unit. What can be checked without the
robot is checked here, before an offset is made of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..effects import Parameter
from ..effects.scene import Scene
from ..errors import ModelError
from ..robot import Robot
from .file import check_belongs
from .largest import Predict, largest_prediction
from .model import Envelope, Model
from .term import Term

# m; ten times the largest deviation of the paper's robots (2.05 mm): a wrong unit is beyond it, a soft robot is not
LARGEST_OFFSET = 0.02
LARGEST_FORCE, LARGEST_TORQUE = 1e5, 1e5  # N, N m; of a load that an envelope can speak of
BEYOND = 0.02  # rad by which measured angles may be beyond the limits of the robot description
ELASTIC_UNITS = ("rad/(N m)", "m/N", "rad/N", "1/N")


@dataclass(frozen=True)
class Plausible:
    """What was found of a model that may come into force.

    Attributes:
        largest_offset: over its envelope, under the largest load that it was identified with in any direction, m.
        doubts: what somebody should look at, a sentence each.
    """

    largest_offset: float
    doubts: tuple[str, ...] = ()


def check_plausible(
    model: Model,
    robot: Robot,
    serial: str,
    scene: Scene,
    predict: Predict,
    *,
    tool: str = "",
    largest_offset: float = LARGEST_OFFSET,
    need_envelope: bool = True,
) -> Plausible:
    """Refuse a model that does not belong here or can't be true.

    Args:
        serial: of the robot. tool: that is mounted; empty: not known, then that of the model is not looked at.
        scene: of this robot, from which effects tell the bounds of their parameters.
        predict: deflection by the model.
        largest_offset: m, that a prediction over the envelope may reach.

    Raises:
        ModelError: with what is wrong, its value, its limit.
    """
    check_identity(model, robot, serial, tool)
    for term in model.terms:
        _check_parameters(term, scene, robot)
    if model.envelope is None:
        if need_envelope:
            raise ModelError("the model does not say in which range it was identified ('envelope'); identify it again")
        return Plausible(math.nan, doubts_of(model, robot))
    check_envelope(model.envelope, robot)
    return Plausible(largest_prediction(model.envelope, robot, predict, largest_offset), doubts_of(model, robot))


def doubts_of(model: Model, robot: Robot) -> tuple[str, ...]:
    """What is possible and yet seldom what was meant: values that were changed in the file, none at all, a range beyond the
    limits of the joints."""
    doubts = []
    if model.edited:
        doubts.append("its effects or envelope were changed by hand after the file was written: no session stands behind them")
    elastic = [e.value for t in model.terms if t.effect.elastic for e in t.estimates.values()]
    if elastic and not any(elastic):
        doubts.append("all its compliances are 0: it corrects nothing")
    if model.envelope is not None:
        ends = zip(model.envelope.q_lower, model.envelope.q_upper, robot.lower, robot.upper, strict=True)
        for k, (low, high, least, most) in enumerate(ends, 1):
            if low < least - BEYOND or high > most + BEYOND:
                doubts.append(
                    f"its envelope of joint_{k} is {low:.3f} .. {high:.3f} rad, the joint can be at {least:.3f} .. {most:.3f}"
                    " rad: no session can have been measured there"
                )
    return tuple(doubts)


def check_identity(model: Model, robot: Robot, serial: str, tool: str = "") -> None:
    """Serial, robot description and, where it is known which one is mounted, the tool. Raises ModelError."""
    if not serial:
        raise ModelError("the serial of this robot is not known; name it (cell file: robot: serial, or parameter robot_serial)")
    for name, value in (("serial", model.serial), ("urdf_sha256", model.urdf_sha256)):
        if not value:
            raise ModelError(f"the model does not say to which robot it belongs (robot: {name} is empty); identify it again")
    check_belongs(model, robot, serial, "this cell")
    if tool and not model.tool:
        raise ModelError(
            f"the model does not say with which tool it was identified (robot: tool is empty), '{tool}' is mounted; identify it "
            f"again from a session with 'tool: {tool}', or write that under 'robot:' in the model file if it was this tool"
        )
    if tool and model.tool != tool:
        raise ModelError(f"the model was identified with tool '{model.tool}', '{tool}' is mounted")


def check_envelope(envelope: Envelope, robot: Robot) -> None:
    """Lengths, order and finiteness. Raises ModelError."""
    for name, values in (("q_lower", envelope.q_lower), ("q_upper", envelope.q_upper)):
        if len(values) != robot.n_joints:
            raise ModelError(f"the model's envelope has {len(values)} joints in {name}, the robot has {robot.n_joints}")
        for k, v in enumerate(values, 1):
            if not math.isfinite(v):
                raise ModelError(f"the model's envelope: {name} of joint_{k} is {v}, a finite number is needed")
    for k, (low, high) in enumerate(zip(envelope.q_lower, envelope.q_upper, strict=True), 1):
        if low > high:
            raise ModelError(f"the model's envelope of joint_{k} begins at {low:g} rad and ends at {high:g} rad")
    if not 0.0 < envelope.force <= LARGEST_FORCE:
        raise ModelError(f"the model's envelope has a force of {envelope.force:g} N; above 0 to {LARGEST_FORCE:g} N can be")
    if not 0.0 <= envelope.torque <= LARGEST_TORQUE:
        raise ModelError(f"the model's envelope has a torque of {envelope.torque:g} N m; 0 to {LARGEST_TORQUE:g} N m can be")


def _check_parameters(term: Term, scene: Scene, robot: Robot) -> None:
    effect = term.effect
    for name, estimate in term.estimates.items():
        if not math.isfinite(estimate.value):
            raise ModelError(f"effect '{effect.id}': {name} is {estimate.value}, a finite number is needed")
    if effect.no_live_form() is not None:  # has no part in a correction; its parameters may belong to a session
        return
    known = {p.name: p for p in effect.parameters(scene)}
    rated = bool(np.all(np.isfinite(robot.effort) & (robot.effort > 0.0)))
    for name, estimate in term.estimates.items():
        parameter = known.get(name)
        if parameter is None:
            if effect.elastic:
                raise ModelError(f"effect '{effect.id}' has no parameter '{name}' on this robot; it has {', '.join(known)}")
            continue
        low, high, why = _bounds(parameter, rated and estimate.identified)
        if not low - 1e-15 <= estimate.value <= high + 1e-15:
            raise ModelError(
                f"effect '{effect.id}': {name} is {estimate.value:g} {parameter.unit}; {low:g} to {high:g} {why}; "
                "identify it again"
            )


def _bounds(parameter: Parameter, known: bool) -> tuple[float, float, str]:
    """Args: known: the torque ratings of the robot description (effort 0: unknown), and the value itself, not only a sum."""
    if parameter.plausible is None or (parameter.unit in ELASTIC_UNITS and not known):
        return parameter.lower, parameter.upper, "is physically possible"
    low, high = parameter.plausible
    return max(low, parameter.lower), min(high, parameter.upper), "is plausible for a robot of these torque ratings"
