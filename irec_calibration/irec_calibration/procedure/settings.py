# SPDX-License-Identifier: Apache-2.0
"""The sections of the cell file that steer Procedure 1 and judge a recalibration. SI units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..cell import Cell, Section
from ..errors import CellError
from ..typing import Array
from .table import STATES

MOST_REPEATS = 1000
LONGEST_HOLD = 600.0  # s
UNLOADED_SHARE, LEAST_UNLOADED_N = 0.05, 10.0  # of the normal force, and N: see Checks.unloaded_n


@dataclass(frozen=True)
class Settling:
    """When a load case stands still over one window.

    Attributes:
        force_n: largest distance of the mean force from the set point, each axis, N.
        force_drift_n, marker_drift_m: largest difference of the means of the two halves, beyond their noise, N and m.
        marker_std_m: largest standard deviation of the marker, each axis, m.
        slip_m: largest lateral way of the marker since the reference, m; more means that the contact has slipped.
            Without a tracker all three go for the TCP: see by_encoders.py.
        hold_s: s that a load case is held before its window begins; gears creep, and the process holds its forces for longer.
    """

    force_n: float
    force_drift_n: float
    marker_drift_m: float
    marker_std_m: float
    slip_m: float
    hold_s: float = 0.0


@dataclass(frozen=True)
class Checks:
    """Limits between what was asked for, what the instruments read, and what the robot does; `procedure.checks` of a cell file.

    Attributes:
        arrival_m: largest distance of tcp_pose from the end of a straight move that was answered with success, m.
        unloaded_n: largest change of the unloaded force from before contact to after it, N; 0: largest of twice
            settling.force_n, UNLOADED_SHARE of the normal force and LEAST_UNLOADED_N.
        least_stiffness: of arm, tool and tooling along the tool, N/m; a force that rises by less while the tool advances in
            contact is not believed.
        surface_m: way beyond the reference distance on which contact has to be made, m.
        advance_share: largest further way into the surface at a constant force, as a share of the way from touch to that force.
        advance_m: further way that is always allowed, m.
        near_m, near_speed: last stretch before the reference, m, and speed of the TCP on it, m/s; faster a cancel comes too late
            where the tooling stands nearer than the cell file says.
        lift_speed: of the TCP on the first millimetres out of the contact, m/s; faster the robot stops too late where it is led
            the other way.
        marker_m: largest difference between the ways of the marker and of the TCP within one pose, m, the deflection left out.
        unverified_n: largest force of a run whose places can't verify the scale of the force sensor, N; 0: any, with a warning.
        least_wrench_hz, least_states_hz: rate of wrench, and of joint_states and tcp_pose, that a window needs.
    """

    arrival_m: float = 0.003
    unloaded_n: float = 0.0
    least_stiffness: float = 2e4
    surface_m: float = 0.01
    advance_share: float = 0.5
    advance_m: float = 2e-4
    near_m: float = 0.01
    near_speed: float = 0.003
    lift_speed: float = 0.005
    marker_m: float = 1e-3
    unverified_n: float = 0.0
    least_wrench_hz: float = 50.0
    least_states_hz: float = 25.0


@dataclass(frozen=True)
class Settings:
    """How Procedure 1 is run.

    Attributes:
        home_speed: share of the joint velocity limits. linear_speed: of the TCP, m/s.
        window_s: averaging window, s. min_samples: tracker samples that it needs; without a tracker joint states.
        force_abort_n: norm of the force that ends the run, N. sensor_range_n: largest valid reading of one axis, N.
        friction: largest ratio of lateral to normal force, safety included.
        timeouts: state -> s. skip_limit: share of the poses that may fail.
        workspace: lower and upper corner (2, 3) of the box that the TCP may be in, cell frame, m.
        reference_distance: m from the reference to contact.
        operator_at_robot: somebody stands at the emergency stop, so that a driver without dead man's switch may press.
        without_tracker: no tracker measures; joint_states, tcp_pose and force say whether the robot stands.
        pad_radius: of the contact pad, m; 0: not known.
        checks: limits of what is believed.
    """

    home_speed: float
    linear_speed: float
    window_s: float
    settling: Settling
    min_samples: int
    force_abort_n: float
    sensor_range_n: float
    friction: float
    repeats: int
    timeouts: dict[str, float]
    skip_limit: float
    workspace: Array
    reference_distance: float = 0.003
    operator_at_robot: bool = False
    without_tracker: bool = False
    pad_radius: float = 0.0
    checks: Checks = Checks()

    @property
    def near_speed(self) -> float:
        """Of the TCP on the last stretch before the reference, m/s."""
        return min(self.checks.near_speed, self.linear_speed)


@dataclass(frozen=True)
class Acceptance:
    """What must hold before a recalibration puts its model in force.

    Attributes:
        min_poses: complete poses. held_out_share: share of the poses that judge and never take part in the fit.
        held_out_rms_m: largest RMS of the new model on held-out poses, m.
        max_ratio_to_old: largest ratio of that to the RMS of the model in force on the same rows.
        max_noise_floors: largest ratio of that to the noise floor.
    """

    min_poses: int
    held_out_share: float
    held_out_rms_m: float
    max_ratio_to_old: float
    max_noise_floors: float


def read_settings(cell: Cell) -> Settings:
    """Read `procedure`, `workspace` and `force_sensor` of a cell file.

    Raises:
        CellError: names file, key, value and what is allowed.
    """
    top = Section(cell.path, "", cell.raw)
    s = top.section("procedure")
    s.only(
        "home_speed", "linear_speed", "window_s", "settling", "min_samples", "force_abort_n", "repeats", "timeouts", "skip_limit",
        "operator_at_robot", "without_tracker", "checks",
    )  # fmt: skip
    still = s.section("settling")
    needed = ("force_n", "force_drift_n", "marker_drift_m", "marker_std_m", "slip_m")
    still.only(*needed, "hold_s")
    timed = [state.name for state in STATES.values() if state.otherwise and not state.timeout]
    timeouts = s.section("timeouts")
    timeouts.only(*timed)
    sensor = top.section("force_sensor")
    sensor.only("frame", "axis_in_tool0", "range_n")
    box = top.section("workspace")
    box.only("lower", "upper")
    workspace = np.array([box.vector("lower", 3), box.vector("upper", 3)])
    if (workspace[0] >= workspace[1]).any():
        lower, upper = workspace.tolist()
        raise CellError(f"{cell.path}: workspace.upper is {upper}, must be more than lower {lower}")
    settings = Settings(
        home_speed=s.number("home_speed", 0.001, 1.0),
        linear_speed=s.number("linear_speed", 0.0001, 1.0),
        window_s=s.number("window_s", 0.05, 60.0),
        settling=Settling(
            **{k: still.number(k, 1e-9) for k in needed},
            hold_s=still.number("hold_s", 0.0, LONGEST_HOLD) if "hold_s" in still else 0.0,
        ),
        min_samples=int(s.number("min_samples", 4)),
        force_abort_n=s.number("force_abort_n", 1.0),
        sensor_range_n=sensor.number("range_n", 1.0),
        friction=cell.friction,
        repeats=int(s.number("repeats", 1, MOST_REPEATS)),
        timeouts={state: timeouts.number(state, 0.1, 86400.0) for state in timed},
        skip_limit=s.number("skip_limit", 0.0, 1.0),
        workspace=workspace,
        reference_distance=cell.reference_distance,
        operator_at_robot=_flag(cell, s, "operator_at_robot"),
        without_tracker=_flag(cell, s, "without_tracker"),
        pad_radius=cell.pad_radius,
        checks=_checks(s),
    )
    check_loads(cell, settings)
    settings = _in_time(cell, settings, "checks" in s and "near_m" in s.section("checks"))
    held = settings.settling.hold_s + settings.window_s
    if held >= settings.timeouts["settle"]:
        raise CellError(
            f"{cell.path}: procedure.timeouts.settle is {settings.timeouts['settle']:g} s, must be more than"
            f" settling.hold_s and window_s, {held:g} s"
        )
    return settings


def _checks(procedure: Section) -> Checks:
    if "checks" not in procedure:
        return Checks()
    s = procedure.section("checks")
    s.only(*Checks.__dataclass_fields__)
    return Checks(**{name: s.number(name, 0.0) for name in Checks.__dataclass_fields__ if name in s})


def _in_time(cell: Cell, settings: Settings, stated: bool) -> Settings:
    """With a last stretch that half of the time-out is enough for; one that the cell file states has to be. Raises CellError."""
    most = 0.5 * settings.timeouts["advance"] * settings.near_speed
    if settings.checks.near_m <= most:
        return settings
    if stated:
        raise CellError(
            f"{cell.path}: procedure.checks.near_m is {settings.checks.near_m:g} m, at {settings.near_speed:g} m/s (near_speed)"
            f" this takes {settings.checks.near_m / settings.near_speed:.3g} s, must be at most half of"
            f" procedure.timeouts.advance, {settings.timeouts['advance']:g} s"
        )
    return replace(settings, checks=replace(settings.checks, near_m=most))


def _flag(cell: Cell, section: Section, key: str) -> bool:
    value = section.get(key) if key in section else False
    if not isinstance(value, bool):
        raise CellError(f"{cell.path}: procedure.{key} is {value!r}; true or false is needed")
    return value


def check_loads(cell: Cell, settings: Settings) -> None:
    """The load cases must be within what the contact holds and the run survives. Raises CellError."""
    for f in cell.forces_in_tool:
        lateral, norm = float(np.hypot(f[0], f[1])), float(np.linalg.norm(f))
        if lateral > cell.friction * abs(f[2]):
            raise CellError(
                f"{cell.path}: load_cases: {lateral:.0f} N across at {abs(f[2]):.0f} N normal would slip; the contact holds"
                f" {cell.friction * abs(f[2]):.0f} N (friction / friction_safety); lower fx, fy or raise fz"
            )
        if norm >= settings.force_abort_n:
            raise CellError(
                f"{cell.path}: procedure.force_abort_n is {settings.force_abort_n:g} N, must be more than the largest"
                f" load case, {norm:.0f} N"
            )


def read_acceptance(cell: Cell) -> Acceptance:
    """Read `acceptance` of a cell file. Raises CellError."""
    s = Section(cell.path, "", cell.raw).section("acceptance")
    s.only(*Acceptance.__dataclass_fields__)
    return Acceptance(
        int(s.number("min_poses", 2)),
        s.number("held_out_share", 0.05, 0.9),
        s.number("held_out_rms_m", 1e-9),
        s.number("max_ratio_to_old", 1e-3),
        s.number("max_noise_floors", 1e-3),
    )
