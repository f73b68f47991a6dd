# SPDX-License-Identifier: Apache-2.0
"""The dead man's switch for pressing: a force set point that is not renewed in time leads out of the contact."""

from __future__ import annotations

from dataclasses import dataclass

from .cell import FORCE, Cell
from .kinematics import Array, forward
from .motion import Move, linear_move


@dataclass(frozen=True)
class LeaseSettings:
    """hold: s for which a set point holds without coming again; 0: for ever, as a driver without the switch does.

    ramp: s, from the last set point to none. distance: m, way back along tool0 z after that, at speed m/s.
    """

    hold: float = 0.5
    ramp: float = 0.3
    distance: float = 0.02
    speed: float = 0.05


class ForceLease:
    """Watches the set points of one cell; times are the cell's."""

    def __init__(self, cell: Cell, settings: LeaseSettings) -> None:
        self.settings = settings
        self.expired = 0  # times a set point has run out
        self._cell = cell
        self._renewed = 0.0
        self._from: Array | None = None  # set point when it ran out

    @property
    def ramping(self) -> bool:
        return self._from is not None

    def renew(self) -> None:
        """A set point came, or the robot switched its control mode."""
        self._renewed, self._from = self._cell.time, None

    def step(self) -> Move | None:
        """Take the force down where the set point has run out; the way back once none is left and the robot stands frozen.

        Raises:
            SimError: the way back can't be reached.
        """
        cell, settings = self._cell, self.settings
        late = cell.time - self._renewed - settings.hold
        if cell.mode != FORCE or settings.hold <= 0.0 or late <= 0.0:
            return None
        if self._from is None:
            self._from = cell.force_setpoint
            self.expired += 1
        share = max(0.0, 1.0 - late / settings.ramp)
        cell.set_force(share * self._from)
        if share > 0.0:
            return None
        self._from = None
        cell.control_position()
        q, rail = cell.commanded
        pose = forward(cell.chain, q[None])
        p, R = pose.p_tcp[0], pose.R_tool[0]
        return linear_move(cell.chain, q, rail, p - settings.distance * R[:, 2], R, settings.speed)

    @property
    def reason(self) -> str:
        """For robot/state, after a set point has run out."""
        s = self.settings
        return (
            f"no force set point came for {s.hold:g} s: the force was taken down in {s.ramp:g} s and the tool drawn back by "
            f"{1e3 * s.distance:g} mm"
        )
