# SPDX-License-Identifier: Apache-2.0
"""What ends a run while the robot presses: sign, way and rise of the force, readings that are late, a force that steps or leaves.

A force sensor that reads less than acts lets the force control press on. It is found by the way of the TCP, which the force
has to rise with, and which has to end when the set point is reached.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .plausible import what_is_read
from .standstill import LOOK_BACK, second_largest
from .table import PRESSING

if TYPE_CHECKING:
    from .machine import Procedure

LATE_S = 1.0  # s by which a wrench may be behind the cell's clock while the robot presses
LEFT_S, LEFT_TOLERANCES = 1.0, 4.0  # s for which the force may be so many settling tolerances off a set point it had reached
MODE_GRACE = 1.0  # s for robot/state to say the mode that was switched to
WRONG_SIGN_N = 40.0  # N, and WRONG_SIGN_SHARE of the set point: a force in the other direction is no noise
WRONG_SIGN_SHARE = 0.04
SIGN_WINDOW = 0.04  # s
AWAY = 3e-3  # m against the direction of pressing
TOUCH_N = 30.0  # N along the tool: there is contact
LOOK_WAY, RISE_WINDOW = 1e-4, 0.02  # m of advance in contact over which the force, a mean over so many s, has to have risen
NOISES, NOISE_WINDOW = 5.0, 0.2  # standard deviations of that rise, and s from whose readings they are found
STEP_SHARE, STEP_TOLERANCES = 0.3, 8.0  # of the normal force, and settling tolerances: a step of the force that no robot makes
STEP_WINDOW, STEP_NEAR = 0.06, 0.2  # s before the step that are averaged; share of the normal force within which it had been
# Along one axis, beyond the way from the last set point to this one: shares of that way and of the normal force, and settling
# tolerances, of which the largest is what a force controller may overshoot by; s that are averaged
OVERSHOOT_OF_WAY, OVERSHOOT_OF_NORMAL, OVERSHOOT_TOLERANCES, OVERSHOOT_WINDOW = 0.5, 0.25, 8.0, 0.1
SLIDING_SHARE = 1.5  # of the friction that load cases may use, which has a margin: across the tool while contact is made


class PressingWatch:
    """Looks at each step of one procedure that presses."""

    def __init__(self, procedure: Procedure) -> None:
        self._p = procedure
        self._near_at = 0.0  # cell's elapsed time when the force was last near its set point, or on the way to it
        self._mark: tuple[float, float] | None = None  # way, m, and force along the tool, N, since which it has to rise

    def problem(self) -> str:
        """Why the run is to end; empty where it may go on, and in all states that do not press."""
        p = self._p
        if p.state not in PRESSING or p.target is None:
            self._mark = None
            return ""
        self._touched()
        if reason := self._late() or self._stepped() or self._ran_away() or self._left():
            return reason
        mean = p.streams.mean_force(p.window_from, SIGN_WINDOW)
        if mean is None:
            return ""
        wanted = float(p.setpoint[2])
        against = -float(mean[2]) * np.sign(wanted)
        if against > max(WRONG_SIGN_N, WRONG_SIGN_SHARE * abs(wanted)):
            return (
                f"the force has the wrong sign: {what_is_read(p.setpoint, mean)}; the contract: what the environment exerts on"
                " the robot, in tool0, so that pressing reads a negative z"
            )
        return self._way(float(mean[2]))

    def _touched(self) -> None:
        """Where the tool was when the force first rose: the arm gives way from then on."""
        p = self._p
        newest, tcp = p.streams.last_forces(LOOK_BACK), p.streams.newest_tcp
        if p.p_touch is None and tcp is not None and second_largest(np.abs(newest[:, 2])) > TOUCH_N:
            p.p_touch = tcp[0]

    def _way(self, read: float) -> str:
        """The way of the TCP since the reference against the force along the tool, N."""
        p = self._p
        tcp, target = p.streams.newest_tcp, p.target
        if tcp is None or p.reference is None or target is None:
            return ""
        z = target.R_tool_in_base[:, 2]
        way = float((tcp[0] - p.reference.p_tcp_in_base.mean(axis=0)) @ z)
        if p.state != "contact":
            return self._goes_on(float((tcp[0] - p.p_contact) @ z), z) if p.p_contact is not None else ""
        if abs(read) > TOUCH_N:
            return self._no_rise(way)
        wanted = float(p.setpoint[2])
        if way < -AWAY:
            return (
                f"the robot moves away from the surface ({-1e3 * way:.1f} mm) when it is to press with z = {wanted:.0f} N: the"
                " driver takes set points with the other sign; the contract: what the environment exerts on the robot, in tool0"
            )
        if way > p.settings.reference_distance + p.settings.checks.surface_m:
            return (
                f"no contact: the tool has advanced {1e3 * way:.0f} mm, the surface should be after"
                f" {1e3 * p.settings.reference_distance:.0f} mm (at most {1e3 * p.settings.checks.surface_m:g} mm more,"
                f" procedure.checks.surface_m), and the wrench still reads {read:.0f} N along the tool; is the surface where the"
                " cell file says, and is it the process force that wrench reports?"
            )
        return ""

    def _no_rise(self, way: float) -> str:
        """In contact the force rises with the way; one that stays is that of a sensor at its end, or frozen."""
        p = self._p
        read = p.streams.forces_of(RISE_WINDOW)[:, 2]
        force, wanted = abs(float(read.mean())), abs(float(p.setpoint[2]))
        if self._mark is None or way < self._mark[0] or force >= wanted - 2.0 * p.settings.settling.force_n:
            self._mark = way, force
            return ""
        gone, rise = way - self._mark[0], force - self._mark[1]
        if gone < LOOK_WAY:
            return ""
        least = p.settings.checks.least_stiffness
        if rise >= least * gone:
            self._mark = way, force
        elif rise < least * gone - NOISES * self._noise(len(read)):
            return (
                f"the force does not rise with the way: the tool has advanced by {1e3 * gone:.2f} mm in contact and the wrench"
                f" has gone from {self._mark[1]:.1f} to {force:.1f} N along the tool, at least {least * gone:.1f} N more are"
                f" expected (procedure.checks.least_stiffness, {least:g} N/m): is the sensor at the end of its range, or does it"
                " repeat a reading?"
            )
        return ""

    def _noise(self, n: int) -> float:
        """Standard deviation of the difference of two means of n readings, N; a steady rise is no part of it."""
        steps = np.diff(self._p.streams.forces_of(NOISE_WINDOW)[:, 2])
        return float(steps.std()) / np.sqrt(n) if len(steps) > 1 else np.inf

    def _goes_on(self, further: float, z: np.ndarray) -> str:
        """At its set point the force holds the tool where it is; `further`, m, into the surface since then."""
        p = self._p
        if p.p_contact is None or p.p_touch is None:
            return ""
        s = p.settings.checks
        limit = s.advance_share * max(0.0, float((p.p_contact - p.p_touch) @ z)) + s.advance_m
        if further <= limit:
            return ""
        return (
            f"the robot presses on: the tool has gone {1e3 * further:.2f} mm further into the surface since contact was made,"
            f" limit {1e3 * limit:.2f} mm (procedure.checks.advance_share, advance_m), while the force is read at its set point:"
            " does the sensor drift, or was its bias set anew under load?"
        )

    def _late(self) -> str:
        p = self._p
        behind = p.now - p.streams.newest().get("force", p.now)
        if behind <= LATE_S or p.time.elapsed - p.switched_at < MODE_GRACE:
            return ""
        return (
            f"no force readings of the last {behind:.1f} s, limit {LATE_S:g} s: wrench is late or silent, and nobody knows how"
            " hard the robot presses now"
        )

    def _stepped(self) -> str:
        """A force along the tool that steps while the same is asked for: bias set anew, a cable, or the contact is lost."""
        p = self._p
        if p.state == "contact":
            return ""
        newest, before = p.streams.last_forces(LOOK_BACK), p.streams.force_before(LOOK_BACK, STEP_WINDOW)
        if before is None or len(newest) < 2:
            return ""
        was, wanted = float(before[2]), float(p.setpoint[2])
        limit = max(STEP_SHARE * abs(wanted), STEP_TOLERANCES * p.settings.settling.force_n)
        if abs(was - wanted) > STEP_NEAR * abs(wanted):  # it had not been reached yet, or is another one now
            return ""
        steps = newest[:, 2] - was
        if max(second_largest(steps), second_largest(-steps)) <= limit:  # two of them, and to the same side
            return ""
        now = newest[int(np.abs(steps).argmax()), 2]
        return (
            f"the force along the tool has stepped from {was:.0f} to {now:.0f} N while {wanted:.0f} N was"
            f" asked for all the time, limit {limit:.0f} N: was the sensor's bias set anew under load, or is the contact lost?"
        )

    def _ran_away(self) -> str:
        """A force that leaves the way from one set point to the next along an axis: what drives it does not read it there."""
        p = self._p
        mean, asked, touching = p.streams.mean_force(p.window_from, OVERSHOOT_WINDOW), p.setpoint, p.state == "contact"
        if mean is None:
            return ""
        before = asked if p.force_before is None else p.force_before
        normal, share = abs(float(asked[2])), OVERSHOOT_OF_NORMAL
        if touching:  # the tool may be dragged along the surface, by no more than the surface holds
            share = max(share, SLIDING_SHARE * p.settings.friction)
        least = max(share * normal, OVERSHOOT_TOLERANCES * p.settings.settling.force_n)
        limit = np.maximum(OVERSHOOT_OF_WAY * np.abs(asked - before), least)
        beyond = np.maximum(mean - np.maximum(before, asked), np.minimum(before, asked) - mean)
        if touching or (mean[2] * asked[2] > 0.0 and abs(mean[2]) < normal):
            beyond[2] = 0.0  # along the tool a touch may be hard, and a force that is lost is none that runs away
        k = int((beyond - limit).argmax())
        if beyond[k] <= limit[k]:
            return ""
        return (
            f"the force along {'xyz'[k]} runs away from its set point: {what_is_read(asked, mean)}, which is {beyond[k]:.0f} N"
            f" beyond {before[k]:.0f} to {asked[k]:.0f} N, the way between the set points, limit {limit[k]:.0f} N; are axes of"
            " the wrench exchanged or a sign turned, so that the force control pushes along one axis and reads another?"
        )

    def _left(self) -> str:
        """A force that had reached its set point has to stay there."""
        p = self._p
        limit = LEFT_TOLERANCES * p.settings.settling.force_n
        mean = p.streams.mean_force(-np.inf, SIGN_WINDOW)
        if p.state != "settle" or mean is None or float(np.abs(mean - p.setpoint).max()) <= limit:
            self._near_at = p.time.elapsed
            return ""
        if p.time.elapsed - self._near_at <= LEFT_S:
            return ""
        return (
            f"the force has left its set point for {LEFT_S:g} s: {what_is_read(p.setpoint, mean)}; is the contact lost, or has"
            " the sensor's bias changed?"
        )
