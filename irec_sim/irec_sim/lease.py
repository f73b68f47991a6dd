# SPDX-License-Identifier: Apache-2.0
"""The dead man's switch for the contact: no force set point in time, or no move after force control, leads out of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .cell import FORCE, POSITION, Cell
from .errors import SimError
from .kinematics import Array, forward
from .motion import Move, linear_move

LONGEST = 2.0  # s for which a force set point may hold, by the contract


@dataclass(frozen=True)
class LeaseSettings:
    """hold: s for which a set point holds without coming again, LONGEST at most; 0: for ever, as without the switch.

    ramp: s, from the last set point to none. leave: s within which a move has to begin once the robot was switched to position
    control and touches; touch: N, a force from which on it does. distance: m, way back along tool0 z, at speed m/s.
    """

    hold: float = 0.5
    ramp: float = 0.3
    leave: float = 2.0
    touch: float = 20.0
    distance: float = 0.02
    speed: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 <= self.hold <= LONGEST:  # no number is neither
            raise SimError(
                f"a force set point holds for {self.hold:g} s, 0 (for ever) to {LONGEST:g} s are possible by the contract"
            )


class ForceLease:
    """Watches the set points of one cell, and the contact after them; times are the cell's.

    Attributes:
        expired: times at which the robot had to leave the contact by itself. reason: of the last time, for robot/state.
    """

    def __init__(self, cell: Cell, settings: LeaseSettings) -> None:
        self.settings = settings
        self.expired = 0
        self.reason = ""
        self._cell = cell
        self._renewed = 0.0
        self._from: Array | None = None  # set point when it ran out
        self._stands: float | None = None  # since when it stands in the contact in position control

    @property
    def ramping(self) -> bool:
        return self._from is not None

    def renew(self) -> None:
        """A set point came, or the robot switched to force control."""
        self._renewed, self._from, self._stands = self._cell.time, None, None

    def left_force_control(self) -> None:
        """The robot was asked to switch to position control, and has."""
        self._from, self._stands = None, self._cell.time

    def step(self, moving: bool) -> Move | None:
        """Take the force down where the set point has run out; the way back once the robot has to leave by itself.

        Args:
            moving: a move is under way.

        Raises:
            SimError: the way back can't be reached.
        """
        if self.settings.hold <= 0.0:
            return None
        if self._cell.mode == FORCE:
            return self._pressing()
        return self._standing(moving)

    def _pressing(self) -> Move | None:
        cell, s = self._cell, self.settings
        late = cell.time - self._renewed - s.hold
        if late <= 0.0:
            return None
        if self._from is None:
            self._from = cell.force_setpoint
            self.expired += 1
        share = max(0.0, 1.0 - late / s.ramp)
        cell.set_force(share * self._from)
        if share > 0.0:
            return None
        self._from = None
        self.reason = (
            f"no force set point came for {s.hold:g} s: the force was taken down in {s.ramp:g} s and the tool drawn back by "
            f"{1e3 * s.distance:g} mm"
        )
        cell.control_position()
        return self._way_back()

    def _standing(self, moving: bool) -> Move | None:
        cell, s = self._cell, self.settings
        if self._stands is None:
            return None
        force = float(np.linalg.norm(cell.wrench()[:3]))
        if cell.mode != POSITION or force < s.touch:
            self._stands = None
            return None
        if moving:  # counted anew where it ends in the contact
            self._stands = cell.time
        if cell.time - self._stands <= s.leave:
            return None
        self._stands = None
        self.expired += 1
        self.reason = (
            f"the robot was switched to position control in contact ({force:.0f} N) and no move came for {s.leave:g} s: "
            f"the tool was drawn back by {1e3 * s.distance:g} mm"
        )
        return self._way_back()

    def _way_back(self) -> Move:
        cell, s = self._cell, self.settings
        q, rail = cell.commanded
        pose = forward(cell.chain, q[None])
        p, R = pose.p_tcp[0], pose.R_tool[0]
        return linear_move(cell.chain, q, rail, p - s.distance * R[:, 2], R, s.speed)
