# SPDX-License-Identifier: Apache-2.0
"""The whole chain, without ROS: wrench and joint angles in, offset out, one tick per period.

reading -> watchdog -> bias, weight, cable -> filters -> TCP -> model at the joint angles -> prediction ahead -> state machine
-> limits -> offset
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from irec_calibration.model import Model
from irec_calibration.robot import Robot
from irec_calibration.typing import Array

from .conditioning import Conditioner
from .deflection import Deflection
from .errors import ActivationError, SettingsError
from .figures import fixed
from .limits import OffsetLimiter, OffsetLimits
from .links import Links
from .preview import Preview
from .spring_chain import build_chain
from .state import ZERO_OFFSET, State, StateTimes, Supervisor
from .watchdog import Fault, Finding, RailRange, Watchdog, WatchdogSettings

HELD_UP = 0.1  # s between two ticks, after which the robot's side has begun to fade the offset out (its contract)


@dataclass(frozen=True)
class CorrectionSettings:
    """How the correction behaves.

    Attributes:
        period: nominal time between two ticks, s.
        with_rotation: correct the orientation of the tool too.
        lead: the offset is extrapolated by this time, s: the measured delay from force to robot. 0: not at all.
        lead_smoothing: time constant of the rate that is extrapolated, s. lead_limit: largest extrapolation, m and rad.
        need_envelope: refuse a model without the range that it was identified in.
        start_load: share of the largest force of the model with which it may begin; inf: any.
        held_up: s between two ticks, beyond which this process was held up: hold, then ramp in. inf: who asks for ticks pauses.
    """

    period: float = 0.004
    with_rotation: bool = False
    lead: float = 0.0
    lead_smoothing: float = 0.02
    lead_limit: float = 2e-4
    need_envelope: bool = False
    start_load: float = math.inf
    held_up: float = HELD_UP
    limits: OffsetLimits = field(default_factory=OffsetLimits)
    times: StateTimes = field(default_factory=StateTimes)
    watchdog: WatchdogSettings = field(default_factory=WatchdogSettings)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.period) and 0.0 < self.period <= 0.1):
            raise SettingsError(f"period of the correction is {self.period} s; 0 .. 0.1 s is possible")
        if not 0.0 <= self.lead <= 0.1:
            raise SettingsError(f"lead of the correction is {self.lead} s; 0 .. 0.1 s is possible")
        if not self.lead_smoothing > 0.0:
            raise SettingsError(f"lead_smoothing is {self.lead_smoothing} s; it must be above 0")
        if not self.start_load >= 0.0:
            raise SettingsError(f"start_load of the correction is {self.start_load}; 0 and more is possible")


@dataclass(frozen=True)
class Output:
    """What one tick gave. Vectors in base_link, SI units.

    Attributes:
        translation, rotation: offset to be added to the commanded TCP, (3,), m and rad (rotation vector).
        deflection: predicted translation of the TCP, (3,), m.
        wrench_at_tcp: process wrench in tool0, (6,), N and N m.
        R_tool: tool0 in base_link, (3, 3).
    """

    translation: Array
    rotation: Array
    deflection: Array
    wrench_at_tcp: Array
    R_tool: Array
    state: State
    reason: str


@dataclass
class Counts:
    """Ticks: all, with a limit active, held, later than twice the period."""

    ticks: int = 0
    limited: int = 0
    held: int = 0
    late: int = 0


class Correction:
    """The chain with its memory. Times are seconds on one clock, given by the caller; one thread only.

    Attributes:
        preview: force that is known from earlier courses, or None.
        links: secondary encoders, or None.
    """

    def __init__(
        self, settings: CorrectionSettings, robot: Robot, conditioner: Conditioner, rail: RailRange | None = None
    ) -> None:
        """rail: where the external axis can be; None: there is none, or its position does not matter."""
        self.settings, self.robot = settings, robot
        self.conditioner = conditioner
        self.watchdog = Watchdog(settings.watchdog, robot.velocity, rail)
        self.supervisor = Supervisor(settings.times)
        self.limiter = OffsetLimiter(settings.limits, settings.period)
        self.counts = Counts()
        self.deflection: Deflection | None = None
        self.preview: Preview | None = None
        self.links: Links | None = None
        self._ahead = _Lead(settings.lead, settings.lead_smoothing, settings.lead_limit)
        self._q = np.zeros(robot.n_joints)
        self._rail = 0.0
        self._wrench = np.zeros(6)
        # a raw reading can be freed of the tool's weight only where the orientation is known: by joint angles of its own time
        self._kinematics = build_chain(robot) if conditioner.sensor is not None else None
        self._R_tool = np.eye(3)
        self._oriented = self._kinematics is None
        self._wanted = np.zeros(6)
        self._u, self._turn = np.zeros(3), np.zeros(3)
        self._last_tick: float | None = None
        self._begins: float | None = None  # s, when the load is looked at once

    # -- model ---------------------------------------------------------------------------------------------------------

    def put_in_force(self, model: Model, now: float, deflection: Deflection | None = None) -> None:
        """Follow another model from the next tick on; a running correction blends over.

        Raises:
            ActivationError: an effect can't act in real time, the model has no envelope though one is needed.
        """
        if self.settings.need_envelope and model.envelope is None:
            raise ActivationError("the model does not say in which range it was identified ('envelope'); identify it again")
        envelope = model.envelope
        if envelope is not None and len(envelope.q_lower) != self.robot.n_joints:
            raise ActivationError(f"the model's envelope has {len(envelope.q_lower)} joints, the robot has {self.robot.n_joints}")
        self.deflection = deflection if deflection is not None else Deflection(model, self.robot)
        self.watchdog.clear("model")
        self.watchdog.envelope = envelope
        self.supervisor.restart_ramp(now, self.present, "another model was put in force")

    @property
    def present(self) -> Array:
        """Offset being sent, (6,), m and rad."""
        return np.concatenate([self.limiter.translation.value, self.limiter.rotation.value])

    @property
    def at_rest(self) -> bool:
        """No offset is sent and none is asked for: what takes the offset can do without this chain."""
        return self.supervisor.state in (State.INACTIVE, State.FAULT) and not np.any(np.abs(self.present) > ZERO_OFFSET)

    def start(self, now: float, after: float = 0.0) -> None:
        """Ramp in, `after` s of no offset. Raises ActivationError: without a model, or under load."""
        if self.deflection is None:
            raise ActivationError("no model is in force; activate one first")
        self.watchdog.clear("start")
        if (load := self.load_at_start()) and self.watchdog.untrusted(now) is None:
            raise ActivationError(load)
        if self.supervisor.state is State.FAULT:
            self.supervisor.stop(now, self.present)
        self.deflection.reset()
        if self.links is not None:
            self.links.start()
        self.watchdog.clear_errors()
        self._begins = now + 0.5 * after
        self.supervisor.start(now, self.present, after)

    def load_at_start(self) -> str:
        """Why the correction should not begin with the force of now; empty where it may.

        A robot that stands in contact by its position is pushed by an offset into what pushes it back.
        """
        envelope, share = self.watchdog.envelope, self.settings.start_load
        force = float(np.linalg.norm(self._wrench[:3]))
        if envelope is None or force <= share * envelope.force:
            return ""
        return (
            f"the force is {fixed(force, 0)} N where the correction is to begin, limit {share * envelope.force:.0f} N ({share:g}"
            f" of the {envelope.force:.0f} N that the model was identified up to): the robot seems to press on something, and an"
            " offset would make it press harder; take the tool off first, or raise start_load where it has to begin under load"
        )

    def stop(self, now: float, reason: str = "stopped") -> None:
        """Fade out."""
        self.supervisor.stop(now, self.present, reason)

    def fail(self, source: str, text: str) -> None:
        """Something went wrong that no check has foreseen: hold, fade out, and wait for the operator to start again."""
        self.watchdog.refuse(source, Fault.INTERNAL, text)

    def set_limits(self, limits: OffsetLimits) -> None:
        """Other limits from the next tick on."""
        self.limiter.set_limits(limits)

    def start_session(self, now: float) -> None:
        """A new session of the robot, which applies no offset yet: begin at zero, ramp in again where it was running.

        It may begin where the one before was broken off, in contact: the load is looked at as at the start.
        """
        self.limiter.reset()
        if self.supervisor.state not in (State.INACTIVE, State.FAULT):
            self._begins = now
        self.supervisor.restart_ramp(now, self.present, "a new session of the robot has begun")

    def resynchronise(self, translation: Array, rotation: Array) -> None:
        """The robot missed ticks and stands at this offset, (3,) m and (3,) rad: go on from there, from rest."""
        self.limiter.resynchronise(translation, rotation)

    # -- inputs --------------------------------------------------------------------------------------------------------

    @property
    def joint_angles(self) -> Array:
        """The newest joint angles (k,), rad; zeros before the first."""
        return self._q

    def take_wrench(self, stamp: float, now: float, frame: str, reading: Array, status: str = "") -> None:
        """One reading (6,), N and N m, in the frame that the conditioner expects; `status`: what the sensor itself complains
        of."""
        if status:
            self.watchdog.refuse("force sensor", Fault.SENSOR_STATUS, f"force sensor reports {status}")
        else:
            self.watchdog.clear("force sensor")
        if self.watchdog.accept_wrench(stamp, now, frame, reading) and self._oriented:
            self._wrench = self.conditioner.step(reading, self._R_tool)

    def take_joints(self, stamp: float, now: float, q: Array, rail_position: float = 0.0) -> None:
        """Joint angles (k,), rad, and the external axis, m."""
        if self.watchdog.accept_joints(stamp, now, q, rail_position):
            self._q, self._rail = q, rail_position
            self.conditioner.place(q)
            if self._kinematics is not None:
                self._kinematics.update(q)
                self._R_tool, self._oriented = self._kinematics.R_tool, True

    def take_links(self, now: float, windup: Array) -> None:
        """What secondary encoders tell of the gears, as `Links.take`; what can't be believed holds the offset."""
        wrong = self.links.take(now, windup) if self.links is not None else ""
        if wrong:
            self.watchdog.refuse("secondary encoders", Fault.JOINTS_NOT_FINITE, wrong)
        else:
            self.watchdog.clear("secondary encoders")

    def refuse_links(self, finding: Finding) -> None:
        """What came from the secondary encoders can't be used, and why; stands until windups come that can."""
        self.watchdog.refuse("secondary encoders", finding.fault, finding.text)

    # -- output --------------------------------------------------------------------------------------------------------

    def tick(self, now: float) -> Output:
        """Offset for now. The step since the tick before is never above the rate limit times the period."""
        period = self.settings.period
        dt = period if self._last_tick is None else now - self._last_tick
        self._last_tick = now
        self.counts.ticks += 1
        self.counts.late += dt > 2.0 * period
        finding: Finding | None = None
        if dt > self.settings.held_up and self.supervisor.state is not State.INACTIVE:
            limit = self.settings.held_up
            text = f"no tick for {fixed(dt, 2)} s, limit {limit:g} s: this process was held up, or the clock was set"
            finding = self.watchdog.note(Fault.HELD_UP, text)
            if self.supervisor.state not in (State.RAMP_IN, State.ACTIVE):  # otherwise there is nothing to hold
                finding = None
        if self.links is not None and self.links.is_late(now):
            self.watchdog.refuse("secondary encoders", Fault.JOINTS_STALE, "no windup from the secondary encoders")
        finding = finding or self.watchdog.finding(now, self._wrench)
        if finding is None and self._begins is not None and now >= self._begins:
            self._begins = None
            if load := self.load_at_start():
                self.watchdog.refuse("start", Fault.START_LOAD, load)
                finding = self.watchdog.finding(now, self._wrench)
        if finding is None and self.deflection is not None:
            finding = self._predict(self.deflection, min(max(dt, 0.0), period))
        if finding is None and self.deflection is not None:
            u, turn = self._u, self._turn
            if self._kinematics is None:
                self._R_tool = self.deflection.R_tool
            wanted = np.concatenate([-u, -turn if self.settings.with_rotation else np.zeros(3)])
            self._wanted = self._ahead.step(wanted, dt)
        elif finding is not None:
            self._ahead.reset()
            if self.preview is not None:
                self.preview.reset()
        target = self.supervisor.tick(now, finding, self._wanted, self.present)
        self.counts.limited += self.limiter.step(target[:3], target[3:], dt)
        self.counts.held += self.supervisor.state is State.HOLD
        return Output(
            self.limiter.translation.value, self.limiter.rotation.value, self._u, self._wrench, self._R_tool,
            self.supervisor.state, self.supervisor.reason,
        )  # fmt: skip

    def _predict(self, deflection: Deflection, dt: float) -> Finding | None:
        """Deflection of now; a model that fails or gives no number is not asked again until the operator starts again."""
        wrench = self._wrench if self.preview is None else self._wrench + self.preview.step(self._q, self.conditioner.unfiltered)
        try:
            u, turn = deflection(self._q, wrench[:3], wrench[3:], dt, self._rail)
            if self.links is not None:
                u = u + self.links.displacement(self._q)
            if math.isfinite(u.dot(u) + turn.dot(turn)):
                self._u, self._turn = u, turn
                return None
            text = f"the model predicts {u.tolist()} m at the present joint angles and wrench"
        except Exception as error:  # an effect of a user can raise anything
            text = f"the model can't be evaluated: {type(error).__name__}: {error}"
        self.watchdog.refuse("model", Fault.PREDICTION, f"{text}; put another one in force")
        return self.watchdog.finding(self._last_tick or 0.0, self._wrench)


class _Lead:
    """Extrapolation of the wanted offset by a known delay, along its smoothed rate."""

    def __init__(self, lead: float, smoothing: float, limit: float) -> None:
        self._lead, self._smoothing, self._limit = lead, smoothing, limit
        self.reset()

    def reset(self) -> None:
        self._before: Array | None = None
        self._rate = np.zeros(6)

    def step(self, wanted: Array, dt: float) -> Array:
        if self._lead <= 0.0:
            return wanted
        if self._before is not None and dt > 0.0:
            self._rate = self._rate + (1.0 - math.exp(-dt / self._smoothing)) * ((wanted - self._before) / dt - self._rate)
        self._before = wanted
        return wanted + np.clip(self._lead * self._rate, -self._limit, self._limit)
