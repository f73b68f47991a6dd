# SPDX-License-Identifier: Apache-2.0
"""The checked boundary: every reading passes here before anything is decided or recorded from it.

Frame, stamp, finiteness, length, names, range. The first fault of a source stays, with its value, until the next run begins;
a reading that is refused goes nowhere. A reading from before the run, which comes late, is left out: it may be of a driver that
has ended since. Freshness is watched by the state machine.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence

from ..joint_states import contradiction, named_twice
from .axes import Axes
from .standstill import Streams

LARGEST_LAG = 2.0  # s between a stamp and the cell's clock; clocks that differ by more measure different moments
# Clocks that differ by less than that, and by more than half a window, give rows whose readings are of different load cases, and
# stand still in each stream by itself. What is of another moment in less than half a window shows as a drift between its halves.
# The least lag of a while tells the clocks' difference: where a process or the network holds readings up, some come in time.
LAG_SHARE, LEAST_LAG, MOST_LAG = 0.5, 0.1, 0.3  # of the averaging window; s, between which the limit is in any case
LAG_PERIOD, LAG_READINGS = 1.0, 5  # s, and readings in it at least, of which the least lag is taken
# A simulated clock is heard by messages, and may be heard later than what a driver stamps by it: so far, and for so long of the
# machine's clock, a stamp may be ahead
FARTHEST_AHEAD, AHEAD_FOR = 60.0, 0.5  # s
SAME_STAMP = 20  # readings with one stamp, after which the stamp is no measurement
LARGEST_FORCE = 1e5  # N
LARGEST_TORQUE = 1e5  # N m
LARGEST_REACH = 50.0  # m of the TCP from base_link
LARGEST_SIGHT = 200.0  # m of the marker from the tracker
BEYOND_LIMIT = 0.1  # rad or m that a reported joint may be outside the limits of the description
TEMPERATURES = (-90.0, 500.0)  # degC
FROZEN_S = 1.0  # s with one wrench or point repeated to the last bit; the noise of a working instrument changes it
FROZEN_READINGS = 20  # that takes at least
SPEED_FACTOR, JOINT_STEP = 2.0, 0.02  # times the velocity limit, and rad or m on top: an axis that moves further has jumped
STEPS_KEPT, LONGEST_USUAL = 20, 0.1  # joint states whose mean interval is the usual one, and s that it is at most
LONGEST_STEP = 1.0  # s between two joint states that can be compared


def lag_limit(window_s: float) -> float:
    """Largest difference between the clocks of a cell, s, with which rows of such an averaging window, s, are of one moment."""
    return min(max(LAG_SHARE * window_s, LEAST_LAG), MOST_LAG)


class Inputs:
    """Checks readings and hands the good ones to the streams.

    Args:
        stations: names of the tracker stations of the cell file.
        largest_lag: least lag of a second's readings, either way, s; of a real clock `lag_limit`. A simulated one may be heard
            late, and what that takes of its time goes with its speed.
    """

    def __init__(self, streams: Streams, axes: Axes, stations: Sequence[str], largest_lag: float = LARGEST_LAG) -> None:
        self._largest_lag = largest_lag
        self._lags: dict[str, tuple[float, list[float]]] = {}  # of each source: when they begin, and lags since then
        self.streams, self._axes, self._stations = streams, axes, tuple(stations)
        self.faults: dict[str, str] = {}
        self.dropped: dict[str, str] = {}  # what is refused without ending a run: the newest reason of each source
        self._begun = -math.inf  # cell's clock at which the run under way began
        self._last: dict[str, float] = {}
        self._same: dict[str, int] = {}
        self._ahead: dict[str, float] = {}  # since when the stamps of a source are ahead, by the machine's clock
        self._repeated: dict[str, tuple[float, int, tuple[float, ...]]] = {}  # since when, how often, which values
        self._steps: deque[float] = deque(maxlen=STEPS_KEPT)  # s between the last joint states
        self._q: tuple[float, tuple[float, ...]] | None = None  # stamp and positions of the last joint states
        self._names: tuple[str, ...] | None = None  # of the last joint_states, and where in it each axis is
        self._twice: list[tuple[str, list[int]]] = []
        self._places: tuple[int, ...] = ()

    @property
    def problem(self) -> str:
        """The first fault of any source since `clear`, in a sentence; empty where there is none."""
        return next(iter(self.faults.values()), "")

    def begin_run(self, now: float) -> None:
        """A new run begins; nothing from before is kept or believed any more. now: the cell's clock, s."""
        self._begun = now
        self.faults.clear()
        self.dropped.clear()
        self.streams.clear()
        self._last.clear()
        self._same.clear()
        self._ahead.clear()
        self._lags.clear()
        self._repeated.clear()
        self._q = None
        self._steps.clear()

    def of_before(self, now: float, stamp: float) -> bool:
        """Whether what is stamped so was said before the run began; a stamp that can't be of now is judged as a fault instead."""
        if now < self._begun:  # the clock was set back, with another simulated cell for example
            self._begun = -math.inf
        return stamp < self._begun and now - stamp <= LARGEST_LAG

    def _fault(self, source: str, text: str) -> bool:
        self.faults.setdefault(source, f"{source}: {text}")
        return False

    def _stamped(self, source: str, now: float, stamp: float) -> bool:
        """Whether the reading is new and of now; an old one that is sent again is left out."""
        if stamp == 0.0:
            return self._fault(source, "the stamp is 0; the driver has to stamp each reading with the time at which it was taken")
        lag = now - stamp
        if not abs(lag) <= LARGEST_LAG:
            why = f"the stamp is {abs(lag):.1f} s {'behind' if lag > 0 else 'ahead of'} the clock, limit {LARGEST_LAG:g} s"
            if self._may_be_late(source, -lag):
                self.dropped[source] = f"{source}: {why}"
                return False
            return self._fault(source, f"{why}; does the driver use this clock (use_sim_time, time synchronisation)?")
        self._ahead.pop(source, None)
        if not self._same_clock(source, now, lag):
            return False
        last = self._last.get(source, -math.inf)
        if stamp <= last and last - stamp < LARGEST_LAG:
            self._same[source] = self._same.get(source, 0) + 1
            if self._same[source] >= SAME_STAMP:
                return self._fault(source, f"{SAME_STAMP} readings in a row are not newer than stamp {last:.3f} s")
            return False
        self._last[source], self._same[source] = stamp, 0
        return True

    def _same_clock(self, source: str, now: float, lag: float) -> bool:
        """Whether the stamps of a source are of the cell's clock; judged once in LAG_PERIOD."""
        begin, lags = self._lags.setdefault(source, (now, []))
        lags.append(lag)
        if abs(now - begin) < LAG_PERIOD or len(lags) < LAG_READINGS:
            return True
        del self._lags[source]
        least, middle = min(lags), sorted(lags)[len(lags) // 2]
        off = least if least > 0.0 else min(middle, 0.0)  # no delay makes a stamp be ahead; one that is may be a slip
        if abs(off) <= self._largest_lag:
            return True
        which = f"{1e3 * abs(off):.0f} ms {'behind' if off > 0 else 'ahead of'} the clock"
        return self._fault(
            source,
            f"the stamps of {len(lags)} readings in {abs(now - begin):.1f} s are {'at least ' if off > 0 else ''}{which}, limit"
            f" {1e3 * self._largest_lag:.0f} ms (half of procedure.window_s, so that a row is of one moment): bring the"
            " instrument's clock to that of ROS (chrony, PTP), or let its driver stamp by the arrival less the delay of the way;"
            " and see that this computer keeps up",
        )

    def _may_be_late(self, source: str, ahead: float) -> bool:
        """Whether a stamp that is ahead, s, may only show that the clock is heard late."""
        if not LARGEST_LAG < ahead <= FARTHEST_AHEAD:
            return False
        machine = time.monotonic()
        return machine - self._ahead.setdefault(source, machine) < AHEAD_FOR

    def _moves(self, source: str, stamp: float, values: Sequence[float]) -> bool:
        """Whether the reading has changed lately; an instrument that repeats one to the last bit measures nothing."""
        since, times, before = self._repeated.get(source, (stamp, 0, ()))
        if tuple(values) != before or stamp < since:
            self._repeated[source] = stamp, 1, tuple(values)
            return True
        self._repeated[source] = since, times + 1, before
        if stamp - since <= FROZEN_S or times < FROZEN_READINGS:
            return True
        return self._fault(
            source,
            f"{_list(values)} is repeated to the last bit for {stamp - since:.1f} s, limit {FROZEN_S:g} s: the instrument or its"
            " driver has stopped measuring, or the driver holds readings back (a dead band?)",
        )

    def _numbers(self, source: str, what: str, values: Sequence[float], largest: float, unit: str) -> bool:
        for value in values:
            if not math.isfinite(value):
                return self._fault(source, f"{what} is {_list(values)}; finite numbers are needed, or no message")
            if abs(value) > largest:
                return self._fault(source, f"{what} is {_list(values)} {unit}; more than {largest:g} {unit} can't be")
        return True

    def _frame(self, source: str, frame: str, wanted: str) -> bool:
        return frame == wanted or self._fault(source, f"header.frame_id is '{frame}', the contract says '{wanted}'")

    def wrench(self, now: float, stamp: float, frame: str, force: Sequence[float], torque: Sequence[float]) -> bool:
        """Force (3), N, and torque (3), N m, of the environment on the robot at the TCP in tool0. Whether it was taken."""
        if self.of_before(now, stamp):
            return False
        if not (
            self._frame("wrench", frame, "tool0")
            and self._numbers("wrench", "the force", force, LARGEST_FORCE, "N")
            and self._numbers("wrench", "the torque", torque, LARGEST_TORQUE, "N m")
            and self._stamped("wrench", now, stamp)
            and self._moves("wrench", stamp, (*force, *torque))
        ):
            return False
        self.streams.add_wrench(stamp, (*force, *torque))
        return True

    def joints(self, now: float, stamp: float, names: Sequence[str], position: Sequence[float]) -> bool:
        """Joints and external axes by the driver's names, rad and m, in any order. Whether they were taken."""
        source = "joint_states"
        if self.of_before(now, stamp):
            return False
        if len(names) != len(position):
            return self._fault(source, f"{len(names)} names with {len(position)} positions")
        if tuple(names) != self._names:
            missing = [name for name in self._axes.driver if name not in names]
            if missing:
                return self._fault(
                    source,
                    f"there is no '{missing[0]}' among {', '.join(map(repr, names)) or 'no names'}; the cell file can state how"
                    " the driver names the joints (robot.joint_names, robot.rail.joint_name)",
                )
            self._names, self._places = tuple(names), tuple(list(names).index(name) for name in self._axes.driver)
            self._twice = named_twice(names, self._axes.driver)
        if why := contradiction(self._twice, position):
            return self._fault(source, why)
        q = [position[k] for k in self._places]
        if not (self._numbers(source, "the position", q, math.inf, "rad") and self._within_limits(source, q)):
            return False
        if not (self._stamped(source, now, stamp) and self._no_jump(source, stamp, q)):
            return False
        self.streams.add_joints(stamp, self._axes.recorded, tuple(q))
        return True

    def _within_limits(self, source: str, q: Sequence[float]) -> bool:
        axes = self._axes
        for name, value, low, high, turns in zip(axes.driver, q, axes.lower, axes.upper, axes.revolute, strict=True):
            if not low - BEYOND_LIMIT <= value <= high + BEYOND_LIMIT:
                unit = "rad" if turns else "m"
                return self._fault(
                    source,
                    f"{name} is at {value:.4g} {unit}, its limits are {low:.4g} and {high:.4g} {unit}; "
                    + ("is it in degrees?" if turns else "is it in mm?"),
                )
        return True

    def _no_jump(self, source: str, stamp: float, q: Sequence[float]) -> bool:
        before, self._q = self._q, (stamp, tuple(q))
        if before is None or not 0.0 < stamp - before[0] <= LONGEST_STEP:
            return True
        axes, passed, steps = self._axes, stamp - before[0], self._steps
        steps.append(passed)
        # stamps that are made on arrival are close to each other after a hiccup; the robot has moved for the time in between
        judged = max(passed, min(sum(steps) / len(steps), LONGEST_USUAL))
        for name, value, last, speed, turns in zip(axes.driver, q, before[1], axes.velocity, axes.revolute, strict=True):
            allowed = SPEED_FACTOR * speed * judged + JOINT_STEP
            if abs(value - last) > allowed:
                unit = "rad" if turns else "m"
                return self._fault(
                    source,
                    f"{name} has moved from {last:.4g} to {value:.4g} {unit} in {1e3 * passed:.0f} ms, its speed allows"
                    f" {allowed:.3g} {unit} in {1e3 * judged:.0f} ms: an encoder or the rail's scale is lost, somebody else"
                    f" publishes, or the stamps jitter (the last {len(steps)} are {1e3 * min(steps):.3g} to"
                    f" {1e3 * max(steps):.3g} ms apart): are they made when the angles are read, or when these arrive?",
                )
        return True

    def tcp(self, now: float, stamp: float, frame: str, p: Sequence[float], quat_xyzw: Sequence[float]) -> bool:
        """tool0 in base_link, m and unit quaternion. Whether it was taken."""
        source = "tcp_pose"
        if self.of_before(now, stamp):
            return False
        if not (
            self._frame(source, frame, "base_link")
            and self._numbers(source, "the orientation", quat_xyzw, 1.01, "(unit quaternion)")
            and self._numbers(source, "the position", p, math.inf, "m")
        ):
            return False
        if max(map(abs, p)) > LARGEST_REACH:
            return self._fault(source, f"the position is {_list(p)} m, further than {LARGEST_REACH:g} m can't be; is it in mm?")
        norm = math.sqrt(sum(c * c for c in quat_xyzw))
        if abs(norm - 1.0) > 1e-2:
            return self._fault(source, f"the orientation is {_list(quat_xyzw)} of length {norm:.3f}; a unit quaternion is needed")
        if not self._stamped(source, now, stamp):
            return False
        self.streams.add_tcp(stamp, *p, *quat_xyzw)
        return True

    def marker(self, now: float, stamp: float, frame: str, p: Sequence[float]) -> bool:
        """Marker in the frame of the station that measured, m. Whether it was taken; never in a cell without a tracker."""
        source = "tracker/point"
        if "marker" not in self.streams.needed or self.of_before(now, stamp):
            return False
        if frame not in self._stations:
            known = ", ".join(f"'{name}'" for name in self._stations)
            return self._fault(source, f"header.frame_id is '{frame}'; the stations of the cell file are {known}")
        if not self._numbers(source, "the marker", p, math.inf, "m"):
            return False
        if max(map(abs, p)) > LARGEST_SIGHT:
            return self._fault(source, f"the marker is {_list(p)} m from the station; is it in mm?")
        if not any(p):
            return self._fault(source, "the marker is at (0, 0, 0); nothing may be sent while the line of sight is broken")
        if not (self._stamped(source, now, stamp) and self._moves(source, stamp, p)):
            return False
        self.streams.add_marker(stamp, p[0], p[1], p[2], frame)
        return True

    def temperature(self, name: str, value: float) -> bool:
        """degC. What can't be is left out and noted: a temperature is not needed."""
        low, high = TEMPERATURES
        if not low <= value <= high:
            self.streams.temperature.pop(name, None)
            self.dropped[f"temperature/{name}"] = f"temperature/{name}: {value} degC is left out"
            return False
        self.streams.temperature[name] = value
        return True


def _list(values: Sequence[float]) -> str:
    return f"({', '.join(f'{v:.4g}' for v in values)})"
