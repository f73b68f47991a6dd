# SPDX-License-Identifier: Apache-2.0
"""What an effect says about itself besides its formula, as typed values: who reads them knows no effect by name."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Cause(StrEnum):
    """What an effect's displacement comes from: decides about its part in predictions and in the live correction.

    Attributes:
        LOAD: the process force moves the tool, or it is what the force sensor makes of it: part of both.
        STATE: joint angles alone, whatever the force: only predictions of `absolute` sessions have it.
        MOTION: how the joints came to where they are, whatever the force: only predictions of `absolute` sessions have it.
        TIME: passes with time whatever the force; no part of either.
        MEASUREMENT: only the tracker sees it; no part of either.
    """

    LOAD = "load"
    STATE = "state"
    MOTION = "motion"
    TIME = "time"
    MEASUREMENT = "measurement"


def is_predicted(cause: Cause, kind: str) -> bool:
    """Whether predictions of sessions of a kind have effects of a cause (`predictions.csv` of contracts/results.md)."""
    return cause is Cause.LOAD or (kind == "absolute" and cause in (Cause.STATE, Cause.MOTION))


class Evidence(StrEnum):
    """Where a session shows an effect.

    Attributes:
        DISPLACEMENTS: in measured displacements of all poses, so that held-out poses test it.
        REFERENCE_READINGS: in what the force sensor reads where nothing touches the tool; displacements are blind to it.
        ONE_POSE: in single poses (something happened at one moment), so that held-out poses say nothing about it.
    """

    DISPLACEMENTS = "displacements"
    REFERENCE_READINGS = "reference readings"
    ONE_POSE = "one pose"


class Family(StrEnum):
    """Effects that pass for each other where their form is not quite the true one.

    Attributes:
        SPRING: linear in the wrench. TORQUE_LAW: another law of the torque of one joint. SENSOR: of the wrench that acts.
        ANGLE_ERROR: joint angles and geometry. TIME: grows or jumps with time. INSTRUMENT: what measures.
    """

    SPRING = "spring"
    TORQUE_LAW = "law of a joint's torque"
    SENSOR = "force sensor"
    ANGLE_ERROR = "joint angles and geometry"
    TIME = "time"
    INSTRUMENT = "measuring instrument"


class Axes(StrEnum):
    """Axes of which the parameters of an effect are the compliances, Eq. (11): C_a (actuated) or C_v (virtual) of the paper."""

    ACTUATED = "actuated"
    VIRTUAL = "virtual"


@dataclass(frozen=True)
class Ageing:
    """A change of the robot over the years that one parameter describes, at the size at which a check must find it.

    Attributes:
        parameter: name of the parameter that grows.
        words: in plain words with a place for the amount, e.g. `axis 3: {:.0f} % softer`. amount: at this size, in that unit.
        size: growth of the parameter, in its unit; with `relative` a share of the value in force.
        fault: in one or two words, e.g. `softer`.
        look: what a person with tools looks at, e.g. `check the gear of axis 3`.
        renewable: multiple of this size up to which a new calibration may take the change into account; beyond it, and always
            where this is 0, somebody looks at the robot first.
    """

    parameter: str
    words: str
    amount: float
    size: float
    fault: str
    look: str
    relative: bool = False
    renewable: float = 0.0
