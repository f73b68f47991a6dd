# SPDX-License-Identifier: Apache-2.0
"""A robot that only takes joint positions, as the contract wants a robot: moves, force control, dead man's switch, offset.

One tick per joint state: the reported positions and the process wrench go in, the positions to be sent come out. Force control
is an admittance without stiffness: v = (f_read - f_asked) / (K T), limited in speed, along x, y, z of tool0. It waits for a robot
that is late, or whose states come late: what is sent ahead of where the robot is would be pressed once it gets there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..typing import Array
from .following import Following
from .moves import Motion, MoveError, Planner
from .offset_hold import OffsetHold

POSITION, FORCE, FAULT = 0, 1, 2  # MODE_ constants of irec_msgs/RobotState
DAMPING = 1e-6  # of the pseudo-inverse
RETREAT_SPEED = 0.05  # m/s
NO_WRENCH = 0.1  # s without a wrench in force control: no advance
LEAD_SHARE = 0.1  # of the set point: what the way that was sent and not gone yet may add to the force, by contact_stiffness
LEAD_WAIT = 0.5  # s after which a robot that stays behind is not late: its servo gives way by that under the load
LEAVING = "the robot is leaving the contact by itself: no force set point or no move came in time"


@dataclass(frozen=True)
class Settings:
    """Of one robot.

    Attributes:
        lease: s for which a force set point holds. ramp: s in which the force is taken down after that. retract: m.
        leave: s within which a move has to begin once the robot was switched to position control and touches.
        touch: N, a force from which on it does.
        contact_stiffness: of arm and surface along the tool, N/m; the true one may be 4 times softer or stiffer.
        force_time: s, time constant of the force control. contact_speed: m/s, largest of it.
        offset_limit, offset_turn: m and rad, largest offset that is applied.
        follow_limit: rad or m between what was sent 0.3 s ago and what the robot reports: more is a fault.
    """

    lease: float = 0.5
    ramp: float = 0.3
    retract: float = 0.02
    leave: float = 2.0
    touch: float = 20.0
    contact_stiffness: float = 1e6
    force_time: float = 0.3
    contact_speed: float = 5e-3
    offset_limit: float = 5e-3
    offset_turn: float = math.radians(1.0)
    follow_limit: float = 0.05


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
        self._base: Array | None = None  # commanded positions without the offset, (k,)
        self._order: Order | None = None
        self._retreat = False
        self._asked = np.zeros(3)
        self._renewed = 0.0
        self._ramp_from: tuple[float, Array] | None = None
        self._stands: float | None = None  # since when in the contact in position control
        self._tick_at = -math.inf
        self._gives_way = np.zeros(3)  # m by which the robot stays behind under the load, in tool0
        self._waits: float | None = None  # since when the force control waits for the robot

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
        """Positions that are sent, without the offset (k,). MoveError before the first joint state."""
        if self._base is None:
            raise MoveError("the robot has not reported its joints yet")
        return self._base

    # --- what is asked ------------------------------------------------------------------------------------------------

    def refuse_unless_free(self) -> None:
        """MoveError where a move can't begin now."""
        if self.mode == FAULT:
            raise MoveError(self.message)
        if self.retreating:
            raise MoveError(LEAVING)
        if self.mode != POSITION:
            raise MoveError("moves are refused in force control; switch to position control first")
        if self._order is not None:
            raise MoveError("another move is under way; cancel it first")

    def begin(self, order: Order, now: float) -> None:
        """Start a move. MoveError."""
        self.refuse_unless_free()
        order.since = now
        self._order = order

    def switch(self, force: bool, asked: Sequence[float], now: float) -> None:
        """Control mode; asked: first set point (3,), N, environment on robot in tool0. MoveError."""
        if self.mode == FAULT:
            raise MoveError(self.message)
        if self.retreating:
            raise MoveError(LEAVING)
        if self._order is not None:
            raise MoveError("a move is under way; cancel it before switching the control mode")
        if force:
            self._take(asked)
            if self.mode != FORCE:
                self._freeze()
                self._gives_way, self._waits = np.zeros(3), None
            self.mode, self._renewed, self._stands = FORCE, now, None
        elif self.mode == FORCE:
            self.mode, self._stands = POSITION, now
        self.message = ""

    def set_force(self, asked: Sequence[float], now: float) -> None:
        """A set point; renews the lease. MoveError where it is not taken."""
        if self.mode != FORCE or self._retreat:
            raise MoveError("the robot is not in force control")
        self._take(asked)
        self._renewed, self._ramp_from = now, None

    def set_offset(self, translation: Sequence[float], turn: Sequence[float], now: float) -> None:
        """Offset of the commanded TCP, m and rotation vector (3,) in base_link; what is beyond the limits is cut. MoveError."""
        self._offset.take(translation, turn, now)

    def fade_offset(self) -> None:
        """Two nodes send offsets: hold the last one, fade it out, and follow nobody before it is at zero."""
        self._offset.fade()

    def fault(self, reason: str) -> None:
        """Nothing more is sent until the operator clears it."""
        if self.mode == FAULT:
            return
        self.mode, self.message = FAULT, reason
        self._retreat, self._ramp_from, self._stands, self._offset.applied = False, None, None, np.zeros(6)
        if self._order is not None:
            order, self._order = self._order, None
            order.ended(0.0, reason)

    def clear_fault(self) -> None:
        """The operator has looked: position control, where the robot is."""
        self.mode, self.message, self._base = POSITION, "", None
        self._following.forget()

    # --- one tick -----------------------------------------------------------------------------------------------------

    def tick(self, now: float, reported: Array, wrench: tuple[float, Array] | None) -> Array | None:
        """Positions to be sent (k,), rad and m; None: nothing is sent.

        Args:
            reported: positions of all axes (k,). wrench: when it was taken, s, and the force in tool0 (3,), N; None: never.
        """
        dt = min(max(now - self._tick_at, 0.0), 0.1)
        self._tick_at = now
        if self.mode == FAULT:
            return None
        if self._base is None:
            self._base = reported.copy()
        if problem := self._following.problem(now, reported):
            self.fault(problem)
            return None
        if self.mode == FORCE:
            self._press(now, dt, reported, wrench)
        elif self._stands is not None:
            self._stand(now, wrench)
        self._move(now)
        send = self._with_offset(now, dt)
        self._following.sent(now, send)
        return send

    def _press(self, now: float, dt: float, reported: Array, wrench: tuple[float, Array] | None) -> None:
        s = self.settings
        if self._ramp_from is None and s.lease > 0.0 and now - self._renewed > s.lease:
            self.expired += 1
            self.message = f"no force set point came for {s.lease:g} s: the robot leaves the contact by itself"
            self._ramp_from = now, self._asked.copy()
        asked = self._asked
        if self._ramp_from is not None:
            begun, before = self._ramp_from
            asked = before * max(0.0, 1.0 - (now - begun) / s.ramp)
            if now - begun >= s.ramp:
                self._ramp_from, self.mode = None, POSITION
                self._draw_back(now)
                return
        if wrench is None or now - wrench[0] > NO_WRENCH:
            return
        v = (wrench[1] - asked) / (s.contact_stiffness * s.force_time)
        size = float(np.linalg.norm(v))
        v *= min(1.0, s.contact_speed / size) if size > 0.0 else 1.0
        base = self.commanded
        _, R, J = self._planner.chain.forward(base[None, : self._planner.n])
        ahead = R[0].T @ J[0, :3] @ (base - reported)[: self._planner.n]  # m, in tool0
        v *= self._patience(now, v, ahead, asked)
        stepped = base.copy()
        stepped[: self._planner.n] += _inverse(J[0]) @ np.concatenate([R[0] @ v * dt, np.zeros(3)])
        try:
            self._planner.refuse_beyond_limits(stepped)
        except MoveError as error:
            self.message = f"force control stands: {error}"
            return
        self._base = stepped

    def _patience(self, now: float, v: Array, ahead: Array, asked: Array) -> float:
        """Share of the velocity v (3,) at which to go on, `ahead` (3,), m, of where the robot is; from half the limit on less."""
        s = self.settings
        limit = LEAD_SHARE * max(float(np.linalg.norm(asked)), s.touch) / s.contact_stiffness
        lead = ahead - self._gives_way
        share = 2.0 - 2.0 * float(np.linalg.norm(lead)) / limit if v @ lead > 0.0 else 1.0
        if share > 0.05:
            self._waits = None
        elif self._waits is None:
            self._waits = now
        elif now - self._waits > LEAD_WAIT:
            self._gives_way, self._waits = ahead, None
        return min(1.0, max(0.0, share))

    def _stand(self, now: float, wrench: tuple[float, Array] | None) -> None:
        """In position control where force control left the robot: leave the contact where no move comes."""
        s = self.settings
        known = wrench is not None and now - wrench[0] <= NO_WRENCH
        force = float(np.linalg.norm(wrench[1])) if known and wrench is not None else math.inf  # not known: taken for contact
        if s.lease <= 0.0 or force < s.touch:
            self._stands = None
        elif self._order is not None:  # counted anew where it ends in the contact
            self._stands = now
        elif self._stands is not None and now - self._stands > s.leave:
            self.expired += 1
            self._stands = None
            self.message = (
                f"switched to position control in contact, and no move came for {s.leave:g} s: the robot draws the tool back"
            )
            self._draw_back(now)

    def _draw_back(self, now: float) -> None:
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
            order.ended(order.motion.fraction(t), "")

    def _with_offset(self, now: float, dt: float) -> Array:
        offset = self._offset.tick(now, dt, self.mode == POSITION and not self._retreat)
        base = self.commanded
        if not offset.any():
            return base.copy()
        _, _, J = self._planner.chain.forward(base[None, : self._planner.n])
        sent = base.copy()
        sent[: self._planner.n] += _inverse(J[0]) @ offset
        return sent

    def _freeze(self) -> None:
        """What is sent stays, with the offset in it, so that nothing jumps when the offset is not applied any more."""
        if self._following.last is not None:
            self._base = self._following.last.copy()
        self._offset.drop()

    def _take(self, asked: Sequence[float]) -> None:
        force = np.array(asked, dtype=float)
        if not np.isfinite(force).all():
            raise MoveError(f"force set point {force} is refused, finite numbers are needed")
        self._asked = force


def _inverse(J: Array) -> Array:
    """Damped pseudo-inverse (k, 6)."""
    return np.asarray(J.T @ np.linalg.inv(J @ J.T + DAMPING * np.eye(6)))
