# SPDX-License-Identifier: Apache-2.0
"""What joint states say of the robot, believed as far as an axis can have moved and clocks agree."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..procedure.axes import Axes
from ..procedure.inputs import BEYOND_LIMIT, JOINT_STEP, LONGEST_STEP, SPEED_FACTOR
from ..typing import Array
from .moves import MoveError

UNKNOWN_SPEED = 10.0  # rad/s or m/s, of an axis whose description states none
LARGEST_LAG = 1.0  # s between a stamp and the clock
REFUSED, REFUSED_WITHIN = 5, 1.0  # so many states that are left out within so many s are a fault
STANDS_FOR = 0.5  # s for which states have to agree before the robot is held or moved from where they say it is
STANDS_STATES = 10  # that takes at least
STANDS = 1e-3  # rad or m by which they may differ


class Reported:
    """Joint states of one robot, of all axes (k,), rad and m; stamps and clock are s.

    Attributes:
        newest: what is believed of the last state. refused: why the last state that was left out was.
    """

    def __init__(self, axes: Axes) -> None:
        self._axes = axes
        self._speed = np.array([v if np.isfinite(v) and v > 0.0 else UNKNOWN_SPEED for v in axes.velocity])
        self.newest: Array | None = None
        self.refused = ""
        self._stamp = 0.0
        self._refusals: deque[float] = deque(maxlen=REFUSED)
        self._window: deque[tuple[float, Array]] = deque()

    def forget(self) -> None:
        """Nothing from before is compared with what comes."""
        self.newest, self.refused = None, ""
        self._refusals.clear()
        self._window.clear()

    def take(self, clock: float, stamp: float, positions: Array) -> tuple[bool, str]:
        """Whether a state is taken, and the fault where there is one; what comes after a jump is compared with it.

        clock: now, on the clock of the stamps.
        """
        if not np.isfinite(positions).all():
            return False, f"joint_states: the positions are {positions}, finite numbers are needed"
        if problem := self._beyond(positions):
            return False, problem
        if not abs(clock - stamp) <= LARGEST_LAG:
            side = "behind" if clock > stamp else "ahead of"
            return self._refuse(
                clock,
                f"the stamp is {abs(clock - stamp):.1f} s {side} the clock, limit {LARGEST_LAG:g} s; are they of this clock"
                " (use_sim_time, time synchronisation)?",
            )
        last, passed = self.newest, stamp - self._stamp
        if last is not None and passed <= 0.0:
            if np.array_equal(last, positions):
                return False, ""  # the same state again
            return self._refuse(clock, f"a state with stamp {stamp:.3f} s came after that of {self._stamp:.3f} s")
        jump = self._jump(last, positions, passed) if last is not None and passed <= LONGEST_STEP else ""
        if jump or passed > LONGEST_STEP:
            self._window.clear()
        self.newest, self._stamp = positions, stamp
        self._window.append((stamp, positions))
        while len(self._window) > STANDS_STATES and self._window[1][0] <= stamp - STANDS_FOR:
            self._window.popleft()
        return True, jump

    def standing(self) -> Array:
        """Where the robot stands (k,). MoveError: it is not known, as states do not agree for long enough yet."""
        if self.newest is None:
            raise MoveError(
                f"the robot has not reported its joints yet{': joint_states: ' if self.refused else ''}{self.refused}"
            )
        span = self._window[-1][0] - self._window[0][0]
        if len(self._window) < STANDS_STATES or span < 0.9 * STANDS_FOR:
            raise MoveError(
                f"where the robot stands is known for {span:.2f} s, {STANDS_FOR:g} s of joint_states without a jump are needed"
                " before it is moved; ask again"
            )
        spread = np.ptp([q for _, q in self._window], axis=0)
        k = int(np.argmax(spread))
        if spread[k] > STANDS:
            raise MoveError(
                f"the robot does not stand: {self._axes.driver[k]} has moved by {spread[k]:.4f} rad or m within {span:.2f} s by"
                f" joint_states, limit {STANDS:g}; does another program move it, or do two nodes publish joint_states?"
            )
        return self.newest

    def _refuse(self, clock: float, reason: str) -> tuple[bool, str]:
        self.refused = reason
        if self._refusals and clock < self._refusals[-1]:
            self._refusals.clear()
        self._refusals.append(clock)
        if len(self._refusals) == REFUSED and clock - self._refusals[0] <= REFUSED_WITHIN:
            return False, f"joint_states: {REFUSED} states within {REFUSED_WITHIN:g} s were left out, the last because {reason}"
        return False, ""

    def _beyond(self, positions: Array) -> str:
        axes = self._axes
        for name, value, low, high, turns in zip(axes.driver, positions, axes.lower, axes.upper, axes.revolute, strict=True):
            if not low - BEYOND_LIMIT <= value <= high + BEYOND_LIMIT:
                unit = "rad" if turns else "m"
                return (
                    f"joint_states: {name} is at {value:.4g} {unit}, its limits are {low:.4g} and {high:.4g} {unit}; is it in"
                    f" {'degrees' if turns else 'mm'}?"
                )
        return ""

    def _jump(self, last: Array, positions: Array, passed: float) -> str:
        allowed = SPEED_FACTOR * self._speed * passed + JOINT_STEP
        k = int(np.argmax(np.abs(positions - last) - allowed))
        if abs(positions[k] - last[k]) <= allowed[k]:
            return ""
        unit = "rad" if self._axes.revolute[k] else "m"
        return (
            f"joint_states: {self._axes.driver[k]} has moved from {last[k]:.4g} to {positions[k]:.4g} {unit} in"
            f" {1e3 * passed:.0f} ms, its speed allows {allowed[k]:.3g} {unit}: an encoder is lost, was not read yet, or two"
            " nodes publish joint_states"
        )
