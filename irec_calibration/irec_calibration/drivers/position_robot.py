# SPDX-License-Identifier: Apache-2.0
"""A robot that only takes joint positions, as the contract wants a robot: moves, force control, dead man's switch, offset.

Each joint state is reported; one tick then takes the process wrench, and the positions to be sent come out. Nothing is sent
before somebody has asked for something, nor in fault: a robot that takes positions holds by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..procedure.inputs import JOINT_STEP, SPEED_FACTOR
from ..typing import Array
from .advance import AdvanceWatch
from .following import Following
from .force_control import ForceControl, inverse
from .moves import Motion, MoveError, Planner
from .offset_hold import OffsetHold
from .reported import Reported
from .settings import Settings

POSITION, FORCE, FAULT = 0, 1, 2  # MODE_ constants of irec_msgs/RobotState
RETREAT_SPEED = 0.05  # m/s
NO_WRENCH = 0.1  # s without a new wrench in force control: no advance
WRENCH_LOST = 0.5  # s without one: nobody knows how hard the robot presses, it leaves
LEAVING = "the robot is leaving the contact by itself: no force set point or no move came in time"
ENDING = "the driver is ending"


@dataclass
class Order:
    """A move under way; `ended` is told the share of the way and the problem, empty where there is none."""

    motion: Motion
    cancelled: Callable[[], bool]
    feedback: Callable[[float], None]
    ended: Callable[[float, str], None]
    since: float = 0.0


class PositionRobot:
    """State of one robot. Times are s of one clock that never goes back.

    Attributes:
        mode: POSITION, FORCE or FAULT. message: reason of a fault, or why the robot left the contact by itself.
        expired: leases that ran out.
    """

    def __init__(self, planner: Planner, settings: Settings | None = None) -> None:
        self._planner, self.settings = planner, settings or Settings()
        self.mode, self.message, self.expired = POSITION, "", 0
        self._offset = OffsetHold(self.settings.offset_limit, self.settings.offset_turn)
        self._following = Following(self.settings.follow_limit)
        self._reported = Reported(planner.axes)
        self._control = ForceControl(planner, self.settings)
        self._advance = AdvanceWatch(self.settings)
        self._ending = False
        self._base: Array | None = None  # commanded positions without the offset, (k,)
        self._order: Order | None = None
        self._retreat = False
        self._asked = np.zeros(3)
        self._renewed = self._pressed_since = 0.0
        self._ramp_from: tuple[float, Array] | None = None
        self._stands: float | None = None  # since when in the contact in position control
        self._tick_at = -math.inf

    @property
    def offset(self) -> Array:
        """Applied now, (6,): m and rotation vector, in base_link."""
        return self._offset.applied

    @property
    def late_offsets(self) -> int:
        """Times at which an offset was missing for longer than it is held."""
        return self._offset.late

    @property
    def in_motion(self) -> bool:
        return self._order is not None

    @property
    def retreating(self) -> bool:
        """The robot is on its way out of the contact by itself."""
        return self._retreat or self._ramp_from is not None

    @property
    def commanded(self) -> Array:
        """Positions that are sent, without the offset (k,); before that where it stands. MoveError: that is not known."""
        return self._reported.standing() if self._base is None else self._base

    @property
    def at_rest(self) -> bool:
        """Nothing is under way, and force control has not left the robot in contact."""
        return self.mode == FAULT or (
            self.mode == POSITION and not (self.retreating or self.in_motion or self._stands is not None)
        )

    # --- what is asked ------------------------------------------------------------------------------------------------

    def refuse_unless_free(self) -> None:
        """MoveError where a move can't begin now."""
        self._refuse_where_it_obeys_nobody()
        if self.mode != POSITION:
            raise MoveError("moves are refused in force control; switch to position control first")
        if self._order is not None:
            raise MoveError("another move is under way; cancel it first")

    def _refuse_where_it_obeys_nobody(self) -> None:
        if self.mode == FAULT:
            raise MoveError(self.message)
        if self._ending:
            raise MoveError(ENDING)
        if self.retreating:
            raise MoveError(LEAVING)

    def begin(self, order: Order, now: float) -> None:
        """Start a move, which was planned from `commanded`. MoveError."""
        self.refuse_unless_free()
        self._base = self.commanded
        order.since = now
        self._order = order

    def switch(self, force: bool, asked: Sequence[float], now: float) -> None:
        """Control mode; asked: first set point (3,), N, environment on robot in tool0. MoveError."""
        self._refuse_where_it_obeys_nobody()
        if self._order is not None:
            raise MoveError("a move is under way; cancel it before switching the control mode")
        if force:
            wanted = self._checked(asked)
            if self.mode != FORCE:
                self._base = self.commanded
                self._freeze()
                self._control.begin()
                self._advance.begin(wanted)
                self._pressed_since = now
            self.mode, self._asked, self._renewed, self._stands = FORCE, wanted, now, None
        elif self.mode == FORCE:
            self.mode, self._stands = POSITION, now
        self.message = ""

    def set_force(self, asked: Sequence[float], now: float) -> None:
        """A set point; renews the lease. MoveError where it is not taken."""
        if self._ending:
            raise MoveError(ENDING)
        if self.mode != FORCE or self._retreat:
            raise MoveError("the robot is not in force control")
        self._asked, self._renewed, self._ramp_from = self._checked(asked), now, None

    def set_offset(self, translation: Sequence[float], turn: Sequence[float], now: float) -> None:
        """Offset of the commanded TCP, m and rotation vector (3,) in base_link; what is beyond the limits is cut. MoveError."""
        self._offset.take(translation, turn, now)
        if self._base is None and self.mode == POSITION and any((*translation, *turn)):
            self._base = self._reported.standing()

    def fade_offset(self) -> None:
        """Two nodes send offsets: hold the last one, fade it out, and follow nobody before it is at zero."""
        self._offset.fade()

    def fault(self, reason: str) -> None:
        """Nothing more is sent until the operator clears it: the robot holds what was sent last."""
        if self.mode == FAULT:
            return
        self.mode, self.message = FAULT, reason
        self._retreat, self._ramp_from, self._stands, self._offset.applied = False, None, None, np.zeros(6)
        if self._order is not None:
            order, self._order = self._order, None
            order.ended(0.0, reason)

    def clear_fault(self) -> None:
        """The operator has looked: position control. Nothing is sent until somebody asks and joint states agree for a while."""
        self.mode, self.message, self._base = POSITION, "", None
        self._following.forget()
        self._reported.forget()

    def end(self, now: float) -> None:
        """Whoever runs the driver ends it: stop a move on its way, leave a contact of force control, take nothing any more."""
        if self._ending:
            return
        self._ending = True
        if self._order is not None and not self._retreat:
            self._order.motion.way.stop(now - self._order.since)

    # --- one tick -----------------------------------------------------------------------------------------------------

    def report(self, clock: float, stamp: float, positions: Array) -> bool:
        """A joint state, (k,), rad and m: whether it is believed. clock: now, on the clock of the stamps, s."""
        believed, problem = self._reported.take(clock, stamp, positions)
        if problem:
            self.fault(problem)
        return believed

    @property
    def left_out(self) -> str:
        """Why the last joint state that was left out was; empty where none was."""
        return self._reported.refused

    @property
    def waits(self) -> bool:
        """Nobody has asked for anything yet, and it is not known where the robot stands: what is asked would be refused."""
        if self._base is not None or self.mode == FAULT:
            return False
        try:
            self._reported.standing()
        except MoveError:
            return True
        return False

    def tick(self, now: float, wrench: tuple[float, Array] | None, no_newer: str = "") -> Array | None:
        """Positions to be sent (k,), rad and m; None: nothing is sent.

        Args:
            wrench: when the newest one that says something new was taken, s, and the force in tool0 (3,), N; None: never.
            no_newer: why there is none that is newer, where that is known.
        """
        passed = max(now - self._tick_at, 0.0)
        self._tick_at, dt = now, min(passed, 0.1)
        reported = self._reported.newest
        if self.mode == FAULT or reported is None:
            return None
        if problem := self._following.problem(now, reported):
            self.fault(problem)
            return None
        if wrench is not None:
            self._advance.read(dt, wrench[1])
        if self.mode == FORCE:
            self._press(now, dt, reported, wrench, no_newer)
        elif self._stands is not None:
            self._stand(now, wrench)
        self._move(now)
        send = self._with_offset(now, dt)
        if send is None:
            return None
        if problem := self._following.leap(send, reported, SPEED_FACTOR * self._planner.velocity * passed + JOINT_STEP):
            self.fault(problem)
            return None
        self._following.sent(now, send)
        return send

    def _press(self, now: float, dt: float, reported: Array, wrench: tuple[float, Array] | None, no_newer: str) -> None:
        s = self.settings
        out_of_lease = s.lease > 0.0 and now - self._renewed > s.lease
        if self._ramp_from is None and (out_of_lease or self._ending):
            why = ENDING if self._ending else f"no force set point came for {s.lease:g} s"
            self._leave_because(f"{why}: the robot leaves the contact by itself")
            self._ramp_from = now, self._asked.copy()
        asked = self._asked
        if self._ramp_from is not None:
            begun, before = self._ramp_from
            asked = before * max(0.0, 1.0 - (now - begun) / s.ramp)
            if now - begun >= s.ramp:
                self._draw_back(now)
                return
        read_at = self._pressed_since if wrench is None else wrench[0]
        if now - max(read_at, self._pressed_since) > WRENCH_LOST:
            self._leave_because(
                no_newer or f"the force sensor has said nothing new for {WRENCH_LOST:g} s: nobody knows the force"
            )
            self._draw_back(now)
            return
        if wrench is None or now - wrench[0] > NO_WRENCH:
            return
        p, R, _ = self._planner.chain.forward(reported[None, : self._planner.n])
        if problem := self._advance.problem(now, p[0], R[0][:, 2], asked):
            self._leave_because(problem)
            self._draw_back(now)
            return
        try:
            self._base = self._control.step(now, dt, self.commanded, reported, wrench[1], asked)
        except MoveError as error:
            self.message = f"force control stands: {error}"

    def _leave_because(self, reason: str) -> None:
        self.expired += self._ramp_from is None  # once, where it is on its way out already
        self.message = reason

    def _stand(self, now: float, wrench: tuple[float, Array] | None) -> None:
        """In position control where force control left the robot: leave the contact where no move comes."""
        s = self.settings
        known = wrench is not None and now - wrench[0] <= NO_WRENCH
        force = float(np.linalg.norm(wrench[1])) if known and wrench is not None else math.inf  # not known: taken for contact
        if (s.lease <= 0.0 and not self._ending) or force < s.touch:
            self._stands = None
        elif self._order is not None:  # counted anew where it ends in the contact
            self._stands = now
        elif self._stands is not None and (self._ending or now - self._stands > s.leave):
            why = ENDING if self._ending else f"switched to position control in contact, and no move came for {s.leave:g} s"
            self._leave_because(f"{why}: the robot draws the tool back")
            self._draw_back(now)

    def _draw_back(self, now: float) -> None:
        """Position control, and the way back along tool z."""
        self.mode, self._ramp_from, self._stands = POSITION, None, None
        base = self.commanded
        p, R, _ = self._planner.chain.forward(base[None, : self._planner.n])
        back = p[0] - self.settings.retract * R[0][:, 2]
        try:
            motion = self._planner.linear(base, back, Rotation.from_matrix(R[0]).as_quat(), RETREAT_SPEED)
        except MoveError as error:
            self.message += f"; but the way back is barred: {error}"
            return

        def ended(_: float, problem: str) -> None:
            self._retreat = False
            self.message += f"; {problem}" if problem else ""

        self._retreat = True
        self._order = Order(motion, lambda: False, lambda _: None, ended, now)

    def _move(self, now: float) -> None:
        order = self._order
        if order is None:
            return
        t = now - order.since
        if order.cancelled():
            order.motion.way.stop(t)
        self._base = order.motion.at(t)
        order.feedback(order.motion.fraction(t))
        if order.motion.way.done(t - 0.2):  # the robot is given the time to arrive
            self._order = None
            order.ended(order.motion.fraction(t), ENDING if self._ending and not self._retreat else "")

    def _with_offset(self, now: float, dt: float) -> Array | None:
        """What is sent; None before anything was asked for."""
        offset = self._offset.tick(now, dt, self.mode == POSITION and not self._retreat and self._base is not None)
        if self._base is None:
            return None
        base = self._base
        if not offset.any():
            return base.copy()
        _, _, J = self._planner.chain.forward(base[None, : self._planner.n])
        sent = base.copy()
        sent[: self._planner.n] += inverse(J[0]) @ offset
        return sent

    def _freeze(self) -> None:
        """What is sent stays, with the offset in it, so that nothing jumps when the offset is not applied any more."""
        if self._following.last is not None:
            self._base = self._following.last.copy()
        self._offset.drop()

    @staticmethod
    def _checked(asked: Sequence[float]) -> Array:
        force = np.array(asked, dtype=float)
        if not np.isfinite(force).all():
            raise MoveError(f"force set point {force} is refused, finite numbers are needed")
        return force
