# SPDX-License-Identifier: Apache-2.0
"""Drive all courses of a part side by side, in steps of 4 ms, faster than real time.

Per step: the static answer of the elastic plant with the memory of its gears, the oscillation of its modes about that answer, the
offset as the motors follow it; then the sensor reads, and a controller from outside answers with the next offset.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from ..cellfile import CellFile
from ..errors import SimError
from ..kinematics import Array, BoolArray, forward
from ..plant import Conditions, Plant, State
from ..sensing import force_reading
from ..truth_catalogue import Physics
from .channel import OffsetPath, Sensor
from .hard import Hard
from .modes import FollowedModes, Oscillators
from .process import Force, make_force
from .ways import PERIOD, Ways

_GEOMETRY = 12  # steps for which lever arms hold: 4 mm of way
_SPRINGS = 3  # steps between two solutions of the nonlinear springs
_ENCODER = 2e-6  # rad, noise of a secondary encoder: 0.4 arc seconds
_REST = 60  # steps between the relaxed states that the deviation is told against


class Controller(Protocol):
    """What corrects: one offset per course and step."""

    def step(self, now: float, wrench: Array, q: Array, rail: Array) -> Array:
        """Offsets in base_link, (rows, 3), m, for wrenches at the TCP in tool0 (rows, 6) and joint angles (rows, n)."""
        ...


@runtime_checkable
class ReadsLinks(Protocol):
    """A controller with secondary encoders, one on the link's side of each gear."""

    def take_links(self, now: float, windup: Array) -> None:
        """Link-side minus motor-side angles, less what they were there on a dry drive, (rows, n), rad; before each `step`."""
        ...


@runtime_checkable
class Zeroes(Protocol):
    """A controller that has its force sensor zeroed before each course."""

    def zero(self, reading: Array) -> None:
        """Mean reading in the air, where each course begins, (rows, 3), N in tool0; before the first `step`."""
        ...


class Oracle:
    """A controller that knows the plant: its offset is minus the true static answer, on the same channel as everybody's.

    smoothed: passed by the static answer (rows, 3), m, of each step, as a correction's low-pass; None: it acts at once.
    """

    def __init__(self, smoothed: Callable[[Array], Array] | None = None) -> None:
        self.smoothed = smoothed

    def step(self, now: float, wrench: Array, q: Array, rail: Array) -> Array:
        """Never asked: the run fills it in."""
        raise NotImplementedError


@dataclass(frozen=True)
class Drive:
    """Record of one drive; (steps, rows, ...), base_link, SI units.

    Attributes:
        deviation: physical TCP minus where it would be without process and offset, as it truly is; measured: by the tracker.
        static: share of the deviation that a plant without mass would show; offset: as the motors had it; sent: as it was sent.
        force: of the environment on the robot; reading: of the sensor in tool0; in_air: its mean reading before each course,
        where nothing touches the tool, (rows, 3).
        counted: samples that make the part; judged: those of them at which the tracker measures.
    """

    ways: Ways
    deviation: Array
    measured: Array
    static: Array
    offset: Array
    sent: Array
    force: Array
    reading: Array
    in_air: Array
    counted: BoolArray
    judged: BoolArray

    def along(self, vector: Array) -> Array:
        """Component of (steps, rows, 3) that is an error of the part, (steps, rows)."""
        return np.asarray((vector * self.ways.counts).sum(axis=2))

    @property
    def error(self) -> Array:
        """Measured error of the part, (steps, rows), m."""
        return self.along(self.measured)

    def only(self, rows: Array) -> Drive:
        """Some of the courses."""
        ways = self.ways.only(rows)
        over_time = ("deviation", "measured", "static", "offset", "sent", "force", "reading", "counted", "judged")
        some = {name: getattr(self, name)[: len(ways.q), rows] for name in over_time}
        return Drive(ways, in_air=self.in_air[rows], **some)

    @property
    def zeroed(self) -> Drive:
        """The same with the force sensor zeroed before each course."""
        return replace(self, reading=self.reading - self.in_air)


def drive(
    cell: CellFile, hard: Hard, ways: Ways, controller: Controller | None = None, seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Drive:  # fmt: skip
    """Drive all courses once; None: without correction. Same seed, same process and noise, whatever the controller does.

    Args:
        progress: called with the share that is done; may raise to cancel.

    Raises:
        SimError: the plant has no equilibrium (a correction that blows up).
    """
    run = _Run(cell, hard, ways, make_force(hard.process, ways, seed, hard.ripple), seed)
    if isinstance(controller, Zeroes):
        controller.zero(run.in_air)
    steps = len(ways.q)
    for k in range(steps):
        run.step(k, controller)
        if progress is not None and k % 50 == 0:
            progress(k / steps)
    return run.record()


class _Run:
    def __init__(self, cell: CellFile, hard: Hard, ways: Ways, force: Force, seed: int) -> None:
        self.cell, self.hard, self.ways, self.force = cell, hard, ways, force
        physics = _warmed(hard, hard.truth.physics())
        self.sensing = physics.sensing
        self.plant = plant = Plant(cell.chain, physics.plant)
        steps, rows, n = ways.q.shape
        axis = cell.rail[0] if cell.rail is not None else np.zeros(3)
        self.idle = Conditions(
            np.zeros((rows, 3)), ways.rail, np.full((rows, n), 25.0 + hard.warm.gears), np.zeros(rows, dtype=bool),
            ways.rail[:, None] * axis,
        )  # fmt: skip
        self.rest = _Rest(plant, ways.q, self.idle)
        self.state: State = plant.relaxed(ways.q[0], self.idle)
        self.modes = FollowedModes(plant, ways.q, hard.modes) if hard.modes is not None else None
        if self.modes is not None and hard.modes is not None:
            self.oscillators = Oscillators(rows, self.modes.hertz.shape[2], hard.modes.damping)
        self.sensor = Sensor(hard.sensor, rows, np.random.default_rng([seed, 3]))
        nothing = force_reading(self.sensing, cell.sensor_axis, np.zeros((rows, 3)), ways.R_tool[0])
        self.in_air = self.sensor.in_air(nothing, np.random.default_rng([seed, 7]))
        self.path = OffsetPath(hard.channel, rows, np.random.default_rng([seed, 4]))
        self.encoders, self.wound_dynamic = np.random.default_rng([seed, 6]), np.zeros((rows, n))
        shape = (steps, rows, 3)
        self.out = {name: np.zeros(shape) for name in ("deviation", "static", "offset", "sent", "force", "reading")}
        self.sent, self.dynamic, self.seed = np.zeros((rows, 3)), np.zeros((rows, 3)), seed

    def step(self, k: int, controller: Controller | None) -> None:
        ways, q = self.ways, self.ways.q[k]
        before = self.out["deviation"][k - 1] if k else np.zeros((len(q), 3))
        deeper = -(before * ways.path[k, :, :, 2]).sum(axis=1)  # m into the surface
        local = self.force.steady[k] + self.force.unsteady[k]
        local[:, 2] += self.force.stiffness * deeper * (np.abs(local[:, 2]) > 1.0)
        force = (ways.path[k] @ local[:, :, None])[..., 0]
        static = self._static(k, q, force)
        self.path.step(k * PERIOD, self.sent)
        self._oscillate(k, force)
        deviation = self.path.value + static + self.dynamic
        if not np.isfinite(deviation).all() or np.abs(deviation).max() > 0.05:
            raise SimError(f"the TCP is {1e3 * float(np.abs(deviation).max()):.0f} mm off its way: this correction is unstable")
        reading = force_reading(self.sensing, self.cell.sensor_axis, (ways.R_tool[k].swapaxes(1, 2) @ force[:, :, None])[..., 0],
                                ways.R_tool[k])  # fmt: skip
        reading = self.sensor.read(reading, self._tooth(k))
        if isinstance(controller, Oracle):
            self.sent = -(static if controller.smoothed is None else controller.smoothed(static))
        elif controller is not None:
            if isinstance(controller, ReadsLinks):
                controller.take_links(k * PERIOD, self._windup(force))
            wrench = np.concatenate([reading, np.zeros_like(reading)], axis=1)
            self.sent = controller.step(k * PERIOD, wrench, q, ways.rail)
        for name, value in (
            ("deviation", deviation), ("static", static), ("offset", self.path.value), ("sent", self.sent),
            ("force", force), ("reading", reading),
        ):  # fmt: skip
            self.out[name][k] = value

    def _static(self, k: int, q: Array, force: Array) -> Array:
        """Static answer of the plant, (rows, 3), m; between two solutions of its nonlinear springs along their linear part."""
        plant = self.plant
        if k % _GEOMETRY == 0:
            self.frames = plant.frames(q, self.state.e)
            self.jacobian = np.linalg.pinv(forward(plant.chain, q).jacobian())[:, :, :3]
            compliance = plant.compliance(q, self.idle)
            self.linear = plant.tcp_compliance(self.frames, compliance)
            self.soft = np.broadcast_to(compliance, (len(q), plant.dof))[:, plant.axial]  # one row where all springs are linear
        if k % _SPRINGS == 0:
            conditions = replace(self.idle, force=force, process_on=np.abs(force).max(axis=1) > 1.0)
            c = plant.compliance(q, conditions)
            moved = q - self.ways.q[max(k - _SPRINGS, 0)]
            frees = np.isfinite(plant.parameters.release)
            begin = plant.released(self.frames, q, conditions, self.state, moved) if frees else self.state
            self.state, _ = plant.respond(self.frames, q, conditions, begin, c, _SPRINGS * PERIOD)
            change = self.state.e - self.rest.at(k)
            self.solved, self.wound = ((change[:, None, :] @ self.frames.lever)[:, 0], force), change[:, plant.axial]
        answer, solved_for = self.solved
        return np.asarray(answer + (self.linear @ (force - solved_for)[:, :, None])[..., 0])

    def _oscillate(self, k: int, force: Array) -> None:
        """What the modes add to the static answer: forces they have not followed yet, and the motion of the motors."""
        if self.modes is None:
            return
        form = self.modes.at(k)
        pushed = (form.at_tcp @ force[:, :, None])[..., 0]
        motors = (self.jacobian @ self.path.acceleration[:, :, None])[..., 0]
        self.oscillators.step(form.omega, pushed - (form.by_motor @ motors[:, :, None])[..., 0], PERIOD)
        swinging = (self.oscillators.eta - pushed / form.omega**2)[:, :, None]
        self.dynamic = (form.at_tcp.swapaxes(1, 2) @ swinging)[..., 0]
        self.wound_dynamic = (form.axial.swapaxes(1, 2) @ swinging)[..., 0]

    def _windup(self, force: Array) -> Array:
        """What secondary encoders tell of the gears, (rows, joints), rad: windup since the dry drive, read twice."""
        plant = self.plant
        (_, solved_for), axial = self.solved, plant.axial
        torque = (self.frames.lever[:, axial] @ (force - solved_for)[:, :, None])[..., 0]
        wound = self.wound + self.soft * torque + self.wound_dynamic
        return wound + self.encoders.normal(0.0, math.sqrt(2.0) * _ENCODER, wound.shape)

    def _tooth(self, k: int) -> Array:
        """Tooth passing and run-out of the cutter as the samples show them (they fold), (rows, 3), N."""
        sensor = self.hard.sensor
        if self.force.spindle <= 0.0 or sensor is None or not sensor.folds:
            return np.zeros((len(self.ways.rail), 3))
        t, f = k * PERIOD, self.force.spindle
        amplitude = self.force.tooth[k]
        once = 0.3 * self.sensor.gain(f) * np.sin(2.0 * np.pi * f * t)
        teeth = self.sensor.gain(f * self.force.teeth) * np.sin(2.0 * np.pi * f * self.force.teeth * t)
        return amplitude[:, None] * np.array([1.0, 0.8, 0.3]) * (once + teeth)

    def record(self) -> Drive:
        rng = np.random.default_rng([self.seed, 5])
        measured = self.out["deviation"].copy()
        tracker = self.hard.tracker
        if tracker is not None:
            slow = np.cumsum(rng.normal(0.0, 1.0, measured.shape), axis=0)
            slow *= tracker.slow / max(1e-12, float(slow.std(axis=0).mean()))
            measured += rng.normal(0.0, tracker.noise, measured.shape) + slow - slow.mean(axis=0)
        counted = self.force.counted & self.ways.driving
        judged = counted & self._sampled(len(counted))[:, None]
        return Drive(self.ways, measured=measured, in_air=self.in_air, counted=counted, judged=judged, **self.out)

    def _sampled(self, steps: int) -> BoolArray:
        """Steps at which the tracker measures."""
        tracker = self.hard.tracker
        if tracker is None or tracker.rate * PERIOD >= 1.0:
            return np.ones(steps, dtype=bool)
        due = np.floor(np.arange(steps) * tracker.rate * PERIOD)
        return np.diff(due, prepend=-1.0) > 0.0


class _Rest:
    """Elastic coordinates of the arm without process along the courses."""

    def __init__(self, plant: Plant, q: Array, idle: Conditions) -> None:
        self._at = np.unique(np.r_[np.arange(0, len(q), _REST), len(q) - 1])
        self._e = np.array([plant.relaxed(q[k], idle).e for k in self._at])

    def at(self, k: int) -> Array:
        i = int(np.clip(np.searchsorted(self._at, k, side="right") - 1, 0, len(self._at) - 2))
        u = (k - self._at[i]) / (self._at[i + 1] - self._at[i])
        return (1.0 - u) * self._e[i] + u * self._e[i + 1]


def _warmed(hard: Hard, physics: Physics) -> Physics:
    """Gas of the counterbalance is stiffer by its pressure, which grows with the absolute temperature."""
    balancer = physics.plant.balancer
    warmer = replace(balancer, stiffness=balancer.stiffness * (1.0 + hard.warm.gas / 293.0))
    return replace(physics, plant=replace(physics.plant, balancer=warmer))
