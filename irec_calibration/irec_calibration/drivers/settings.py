# SPDX-License-Identifier: Apache-2.0
"""Limits and times of a robot that takes positions only."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from ..errors import IrecError
from ..procedure.commands import LONGEST_LEASE


@dataclass(frozen=True)
class Settings:
    """Of one robot.

    Attributes:
        lease: s for which a force set point holds; 0: for ever. ramp: s in which the force is taken down after that.
        retract: m, way back out of the contact.
        leave: s within which a move has to begin once the robot was switched to position control and touches.
        touch: N, a force from which on it does. first_touch: N, least change of the force in force control that is taken for
            the first sign of contact: above noise, and what hoses pull on the way.
        contact_stiffness: of arm and surface along the tool, N/m; the true one may be 4 times softer or stiffer.
        force_time: s, time constant of the force control. contact_speed: m/s, largest of it.
        advance: m along the tool in contact, within which the force has to rise. approach: m, longest way to the contact.
        offset_limit, offset_turn: m and rad, largest offset that is applied.
        follow_limit: rad or m between what was sent 0.3 s ago and what the robot reports: more is a fault.

    Raises:
        IrecError: a value is no number, negative, or the lease is longer than LONGEST_LEASE.
    """

    lease: float = 0.5
    ramp: float = 0.3
    retract: float = 0.02
    leave: float = 2.0
    touch: float = 20.0
    first_touch: float = 5.0
    contact_stiffness: float = 1e6
    force_time: float = 0.3
    contact_speed: float = 5e-3
    advance: float = 1e-3
    approach: float = 0.03
    offset_limit: float = 5e-3
    offset_turn: float = math.radians(1.0)
    follow_limit: float = 0.05

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise IrecError(f"setting {field.name} of the robot is {value}; a finite number from 0 on is needed")
        if self.lease > LONGEST_LEASE:
            raise IrecError(
                f"lease of a force set point is {self.lease:g} s, limit {LONGEST_LEASE:g} s: for so long the robot would press on"
                " after whoever asked for it has died"
            )
