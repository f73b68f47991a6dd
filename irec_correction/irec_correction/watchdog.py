# SPDX-License-Identifier: Apache-2.0
"""Whether wrench and joint angles can be trusted, sample by sample, and whether the model holds where the robot is.

Samples that fail are not used. `finding()` names the first reason that stands now; the state machine decides what follows.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from irec_calibration.model import Envelope
from irec_calibration.typing import Array

from .figures import fixed, signed


class Fault(StrEnum):
    """Why the correction does not follow the model. Values are keys of counters and diagnostics."""

    WRENCH_STALE = "wrench_stale"
    WRENCH_FROZEN = "wrench_frozen"
    WRENCH_NOT_FINITE = "wrench_not_finite"
    WRENCH_JUMP = "wrench_jump"
    WRENCH_FRAME = "wrench_frame"
    WRENCH_CLOCK = "wrench_clock"
    WRENCH_RANGE = "wrench_range"
    SENSOR_STATUS = "sensor_status"
    JOINTS_STALE = "joints_stale"
    JOINTS_NOT_FINITE = "joints_not_finite"
    JOINTS_JUMP = "joints_jump"
    JOINTS_NAMES = "joints_names"
    JOINTS_CLOCK = "joints_clock"
    RAIL_RANGE = "rail_range"
    ROBOT_CHANGED = "robot_changed"
    OFFSET_STALE = "offset_stale"
    OFFSET_NOT_FINITE = "offset_not_finite"
    OFFSET_FRAME = "offset_frame"
    OFFSET_CLOCK = "offset_clock"
    OTHER_SENDER = "other_sender"
    ROBOT_FAULT = "robot_fault"
    NOT_OBEYED = "not_obeyed"
    PREDICTION = "prediction"
    INTERNAL = "internal"
    HELD_UP = "held_up"
    START_LOAD = "start_load"
    OUTSIDE_JOINTS = "outside_joints"
    OUTSIDE_WRENCH = "outside_wrench"


OUTSIDE = frozenset({Fault.OUTSIDE_JOINTS, Fault.OUTSIDE_WRENCH})


@dataclass(frozen=True)
class Finding:
    """A reason that stands now; `text` has the value and its limit."""

    fault: Fault
    text: str

    @property
    def outside(self) -> bool:
        """The input is sound but the model was not identified for it: fade, and come back by yourself."""
        return self.fault in OUTSIDE


@dataclass(frozen=True)
class RailRange:
    """Where the external axis can be, m."""

    lower: float
    upper: float


@dataclass(frozen=True)
class WatchdogSettings:
    """Limits of what is believed.

    Attributes:
        wrench_timeout, joints_timeout: s since the last message came in.
        frozen_after: s during which the sensor repeats one reading to the last bit.
        force_jump, torque_jump: between two samples, N and N m. A step that lasts `jump_samples` samples is believed.
        joint_speed_factor: joint jumps are steps above this times the velocity limit (plus `joint_jump`, rad), over the time
            since the last angles that were believed: a gap in the messages hides no jump.
        rail_speed: m/s, fastest the external axis can be; a step above it (plus `joint_jump`, m) is a jump as of a joint.
        rail_margin: m beyond the range of the external axis.
        clock_tolerance: s, |stamp - now|: beyond, the clocks differ.
        age_limit: s, an input that is older when it comes in is stale.
        force_range, torque_range: of the sensor, any axis, N and N m.
        wrench_frame: frame_id that wrenches must have; empty: any.
        joint_margin: rad beyond the joint angles that the model was identified in.
        wrench_factor: times the largest force and torque that the model was identified with; torque_margin: N m on top.
    """

    wrench_timeout: float = 0.02
    joints_timeout: float = 0.05
    frozen_after: float = 0.1
    force_jump: float = 400.0
    torque_jump: float = 100.0
    jump_samples: int = 3
    joint_speed_factor: float = 1.5
    joint_jump: float = 0.01
    rail_speed: float = 5.0
    rail_margin: float = 0.1
    clock_tolerance: float = 0.5
    age_limit: float = 0.15
    force_range: float = math.inf
    torque_range: float = math.inf
    wrench_frame: str = ""
    joint_margin: float = 0.2
    wrench_factor: float = 1.3
    torque_margin: float = 100.0


class _Stream:
    """What is remembered of one input."""

    def __init__(self) -> None:
        self.stamp = -math.inf
        self.came_in = -math.inf
        self.refused: Finding | None = None

    def follow_clock(self, refused: Finding, stamp: float) -> None:
        """After a clock was set, one sample is refused and the next one is compared with the new time."""
        if refused.fault in (Fault.WRENCH_CLOCK, Fault.JOINTS_CLOCK) and math.isfinite(stamp):
            self.stamp = stamp


class Watchdog:
    """Checks both inputs. All times in seconds on one clock, given by the caller."""

    def __init__(self, settings: WatchdogSettings, velocity_limit: Array, rail: RailRange | None = None) -> None:
        """Args: velocity_limit: of each joint, (k,), rad/s; 0 or not finite: not known. rail: None: the cell has none."""
        self.settings, self._rail_range = settings, rail
        v = np.asarray(velocity_limit, dtype=float)
        self._speed = np.where(np.isfinite(v) & (v > 0.0), v * settings.joint_speed_factor, np.inf)
        self.envelope: Envelope | None = None
        self.counters: Counter[Fault] = Counter()
        self.newest: Finding | None = None  # that has begun, whether it still stands or not
        self._standing: Finding | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all samples, keep the counters."""
        self._wrench, self._joints = _Stream(), _Stream()
        self._reading: Array | None = None
        self._changed_at = -math.inf
        self._suspect: Array | None = None
        self._suspect_count = 0
        self._q: Array | None = None
        self._rail = 0.0
        self._refused: dict[str, Finding] = {}

    def refuse(self, source: str, fault: Fault, text: str) -> None:
        """A reason that somebody else found (status of the sensor, another robot). Stands until the same source is cleared."""
        self._refused[source] = Finding(fault, text)

    def clear(self, source: str) -> None:
        """Take back what was refused for this source, and only that."""
        self._refused.pop(source, None)

    def clear_errors(self) -> None:
        """Take back what only an operator can take back: internal errors and predictions that failed."""
        for source in [s for s, f in self._refused.items() if f.fault in (Fault.INTERNAL, Fault.PREDICTION)]:
            del self._refused[source]

    def note(self, fault: Fault, text: str) -> Finding:
        """Something that has passed already: counted and told."""
        self.counters[fault] += 1
        self.newest = Finding(fault, text)
        return self.newest

    def accept_wrench(self, stamp: float, now: float, frame: str, reading: Array) -> bool:
        """Whether a reading (6,), N and N m, can be used. Times in s."""
        s, w = self.settings, self._wrench
        w.refused = self._wrench_refused(stamp, now, frame, reading)
        if w.refused is not None:
            w.follow_clock(w.refused, stamp)
            return False
        if self._reading is None or now < self._changed_at or not np.array_equal(reading, self._reading):
            self._changed_at = now
        self._reading = reading.copy()
        self._suspect, self._suspect_count = None, 0
        w.stamp, w.came_in = stamp, now
        if now - self._changed_at > s.frozen_after:
            w.refused = Finding(
                Fault.WRENCH_FROZEN,
                f"force sensor repeats one reading for {fixed(now - self._changed_at, 2)} s, limit {s.frozen_after} s",
            )
        return w.refused is None

    def _wrench_refused(self, stamp: float, now: float, frame: str, reading: Array) -> Finding | None:
        s = self.settings
        if s.wrench_frame and frame != s.wrench_frame:
            return Finding(Fault.WRENCH_FRAME, f"wrench comes in frame '{frame}', '{s.wrench_frame}' is needed")
        if not np.all(np.isfinite(reading)):
            return Finding(Fault.WRENCH_NOT_FINITE, "wrench holds NaN or infinity")
        clock = self._clock_refused((Fault.WRENCH_CLOCK, Fault.WRENCH_STALE), "wrench", self._wrench.stamp, stamp, now)
        if clock is not None:
            return clock
        force, torque = float(np.abs(reading[:3]).max()), float(np.abs(reading[3:]).max())
        if force > s.force_range or torque > s.torque_range:
            return Finding(
                Fault.WRENCH_RANGE,
                f"wrench {fixed(force, 0)} N, {fixed(torque, 0)} N m is beyond the sensor's range "
                f"{s.force_range:g} N, {s.torque_range:g} N m",
            )
        if self._reading is not None and now - self._wrench.came_in <= s.wrench_timeout and self._jumped(reading, self._reading):
            believed = self._suspect is not None and not self._jumped(reading, self._suspect)
            self._suspect_count = self._suspect_count + 1 if believed else 1
            self._suspect = reading.copy()
            if self._suspect_count < s.jump_samples:
                step = float(np.abs(reading - self._reading)[:3].max())
                return Finding(Fault.WRENCH_JUMP, f"wrench jumped by {fixed(step, 0)} N in one sample, limit {s.force_jump:g} N")
        return None

    def _jumped(self, a: Array, b: Array) -> bool:
        d = np.abs(a - b)
        return bool(d[:3].max() > self.settings.force_jump or d[3:].max() > self.settings.torque_jump)

    def _clock_refused(self, faults: tuple[Fault, Fault], what: str, last: float, stamp: float, now: float) -> Finding | None:
        """faults: where the clocks differ, and where the input is old."""
        fault, limit = faults[0], self.settings.age_limit
        if not math.isfinite(stamp) or abs(stamp - now) > self.settings.clock_tolerance:
            away = stamp - now
            return Finding(fault, f"{what} is stamped {signed(away, 3)} s from now, limit {self.settings.clock_tolerance} s")
        if stamp < last:
            return Finding(fault, f"{what} is stamped {fixed(last - stamp, 4)} s before the one before it")
        if now - stamp > limit:
            age = f"{what} is {fixed(now - stamp, 3)} s old when it comes in, limit {limit:g} s; look for what delays it"
            return Finding(faults[1], age)
        return None

    def accept_joints(self, stamp: float, now: float, q: Array, rail: float = 0.0) -> bool:
        """Whether joint angles (k,), rad, and the external axis, m, can be used. Times in s."""
        j = self._joints
        j.refused = self._joints_refused(stamp, now, q, rail)
        if j.refused is not None:
            j.follow_clock(j.refused, stamp)
            return False
        self._q, self._rail = q.copy(), rail
        j.stamp, j.came_in = stamp, now
        return True

    def _joints_refused(self, stamp: float, now: float, q: Array, rail: float) -> Finding | None:
        if len(q) != len(self._speed):
            return Finding(Fault.JOINTS_NAMES, f"{len(q)} joint angles came in, the robot has {len(self._speed)}")
        if not np.all(np.isfinite(q)):
            return Finding(Fault.JOINTS_NOT_FINITE, "joint angles hold NaN or infinity")
        if not math.isfinite(rail):
            return Finding(Fault.JOINTS_NOT_FINITE, f"the position of the rail is {rail}, a finite number is needed")
        clock = self._clock_refused((Fault.JOINTS_CLOCK, Fault.JOINTS_STALE), "joint state", self._joints.stamp, stamp, now)
        if clock is not None:
            return clock
        if self._q is not None:
            passed = stamp - self._joints.stamp
            allowed = self._speed * passed + self.settings.joint_jump
            step = np.abs(q - self._q)
            k = int(np.argmax(step - allowed))
            if step[k] > allowed[k]:
                return Finding(
                    Fault.JOINTS_JUMP,
                    f"joint_{k + 1} jumped by {fixed(step[k], 4)} rad in {fixed(1e3 * passed, 0)} ms, "
                    f"its speed allows {fixed(allowed[k], 4)} rad",
                )
        return self._rail_refused(stamp, rail)

    def _rail_refused(self, stamp: float, rail: float) -> Finding | None:
        s, reach = self.settings, self._rail_range
        if reach is None:
            return None
        if not reach.lower - s.rail_margin <= rail <= reach.upper + s.rail_margin:
            return Finding(
                Fault.RAIL_RANGE,
                f"the rail is at {rail:.4g} m, its range is {reach.lower:g} .. {reach.upper:g} m (margin {s.rail_margin:g} m);"
                " is it in mm?",
            )
        if self._q is not None:
            passed, step = stamp - self._joints.stamp, abs(rail - self._rail)
            allowed = s.rail_speed * passed + s.joint_jump
            if step > allowed:
                return Finding(
                    Fault.JOINTS_JUMP,
                    f"the rail jumped by {fixed(step, 4)} m in {fixed(1e3 * passed, 0)} ms, "
                    f"its speed allows {fixed(allowed, 4)} m",
                )
        return None

    def finding(self, now: float, wrench_at_tcp: Array) -> Finding | None:
        """The first reason that stands now, or None; counted once when it begins.

        Args:
            wrench_at_tcp: process wrench, (6,), N and N m.
        """
        found = self._find(now, wrench_at_tcp)
        if found is not None and (self._standing is None or self._standing.fault is not found.fault):
            self.counters[found.fault] += 1
            self.newest = found
        self._standing = found
        return found

    def _find(self, now: float, wrench_at_tcp: Array) -> Finding | None:
        return self.untrusted(now) or self._outside(wrench_at_tcp)

    def untrusted(self, now: float) -> Finding | None:
        """Why the inputs of now can't be used, or None; not counted."""
        s = self.settings
        if self._refused:
            return next(iter(self._refused.values()))
        for stream, fault, what, timeout in (
            (self._wrench, Fault.WRENCH_STALE, "wrench", s.wrench_timeout),
            (self._joints, Fault.JOINTS_STALE, "joint state", s.joints_timeout),
        ):
            if stream.refused is not None:
                return stream.refused
            if not abs(now - stream.came_in) <= timeout:  # in the future: the clock was set back
                age = f"for {fixed(now - stream.came_in, 3)} s" if math.isfinite(stream.came_in) else "yet"
                return Finding(fault, f"no {what} {age}, limit {timeout} s")
        return None

    def _outside(self, wrench_at_tcp: Array) -> Finding | None:
        e, s = self.envelope, self.settings
        if e is None or self._q is None:
            return None
        low = np.asarray(e.q_lower) - s.joint_margin - self._q
        high = self._q - np.asarray(e.q_upper) - s.joint_margin
        beyond = np.maximum(low, high)
        k = int(np.argmax(beyond))
        if beyond[k] > 0.0:
            return Finding(
                Fault.OUTSIDE_JOINTS,
                f"joint_{k + 1} is at {fixed(self._q[k], 3)} rad, the model was identified for {e.q_lower[k]:.3f} .. "
                f"{e.q_upper[k]:.3f} rad"
                f" (margin {s.joint_margin} rad)",
            )
        force, torque = float(np.linalg.norm(wrench_at_tcp[:3])), float(np.linalg.norm(wrench_at_tcp[3:]))
        torque_limit = s.wrench_factor * e.torque + s.torque_margin
        if force > s.wrench_factor * e.force or torque > torque_limit:
            return Finding(
                Fault.OUTSIDE_WRENCH,
                f"wrench {fixed(force, 0)} N, {fixed(torque, 0)} N m; the model was identified up to {e.force:.0f} N, "
                f"{e.torque:.0f} N m"
                f" (factor {s.wrench_factor}, margin {s.torque_margin:g} N m)",
            )
        return None
