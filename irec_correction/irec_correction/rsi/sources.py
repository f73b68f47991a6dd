# SPDX-License-Identifier: Apache-2.0
"""Where the offset that goes to the robot comes from: the chain in this very process, or another process by shared memory."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from irec_calibration.model import Model
from irec_calibration.robot import Payload, Robot
from irec_calibration.sensors.tool_load import ToolLoad
from irec_calibration.typing import Array

from ..conditioning import Cable, Conditioner, FilterSettings, make_filters, sensor_in_tool
from ..correction import Correction, CorrectionSettings, Counts, Output
from ..deflection import Deflection
from ..errors import CorrectionError
from ..figures import fixed
from ..limits import OffsetLimiter
from ..preview import ForceProfile, Preview
from ..shared import WRENCH_SIZE, SharedValues
from ..spring_chain import build_chain
from ..state import ZERO_OFFSET, State, Supervisor
from ..watchdog import Fault, Finding, RailRange
from .answers import per_answer
from .codec import RobotPacket
from .report import FAULTS, WHERE

# offset block: time (CLOCK_MONOTONIC), wanted (0 or 1), translation(3), rotation vector(3)
OFFSET_SIZE = 8


class OffsetSource(Protocol):
    """What the loop asks. Times are CLOCK_MONOTONIC, s."""

    @property
    def state(self) -> State: ...

    @property
    def reason(self) -> str: ...

    def take(self, packet: RobotPacket, now: float) -> None:
        """What the controller said at `now`."""
        ...

    def offset(self, now: float) -> tuple[Array, Array]:
        """Translation (3,), m, and rotation vector (3,), rad, for the next answer; called once per packet."""
        ...

    def start_session(self, now: float) -> None:
        """A new RSI session: the robot applies no offset yet."""
        ...

    def resynchronise(self, translation: Array, rotation: Array) -> None:
        """The robot stands at this offset, (3,) m and (3,) rad: go on from there, from rest."""
        ...

    def report(self, values: Array) -> None:
        """Write what the chain did into a block, see report.py."""
        ...

    def refuse(self, source: str, finding: Finding | None) -> None:
        """Somebody else found that an input can't be used; None: it can again."""
        ...

    def start(self, now: float) -> None: ...

    def stop(self, now: float) -> None: ...


@dataclass(frozen=True)
class ChainSettings:
    """Everything that the loop's process needs to run the chain by itself; sent to it once.

    Attributes:
        urdf_text: robot description. payload: on tool0, for effects that depend on the total torque.
        wrench_block: name of the shared memory that the sensor's process writes.
        profile, preview_lead, preview_slack: force that is known along the course, s from a reading to the motion that it causes,
            s by which it may come sooner or later.
        rail: where the first external axis can be; None: there is none.
        raw: the block holds readings in `sensor_frame`; otherwise wrenches at the TCP.
    """

    correction: CorrectionSettings
    filters: FilterSettings
    urdf_text: str
    wrench_block: str
    raw: bool = False
    sensor_frame: str = "ft_sensor"
    load: ToolLoad = ToolLoad()
    cable: Cable = Cable()
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    payload: Payload | None = None
    profile: ForceProfile | None = None
    preview_lead: float = 0.0
    preview_slack: float = 0.0
    rail: RailRange | None = None


class ChainSource:
    """The whole chain: joint angles from the packet, wrench from the sensor's shared memory. No ROS anywhere."""

    def __init__(self, settings: ChainSettings) -> None:
        robot = Robot(settings.urdf_text, "robot description")
        self._frame = settings.sensor_frame if settings.raw else "tool0"
        sensor = sensor_in_tool(robot, settings.sensor_frame) if settings.raw else None
        conditioner = Conditioner(make_filters(settings.filters), sensor, settings.load, settings.cable, settings.gravity)
        # without packets there are no ticks, and the joint states are stale
        correction = replace(settings.correction, limits=per_answer(settings.correction.limits), held_up=math.inf)
        self.chain = Correction(correction, robot, conditioner, settings.rail)
        if settings.profile is not None:
            self.chain.preview = Preview(
                settings.profile, settings.preview_lead, make_filters(settings.filters), slack=settings.preview_slack
            )
        self._robot, self._gravity, self._payload = robot, settings.gravity, settings.payload
        build_chain(robot)  # the first time takes longer than a cycle
        self._out: Output | None = None
        self._block_name = settings.wrench_block
        self._block: SharedValues | None = None
        self._values = np.zeros(WRENCH_SIZE)
        self._version = 0
        self._tries = 0

    @property
    def state(self) -> State:
        return self.chain.supervisor.state

    @property
    def reason(self) -> str:
        return self.chain.supervisor.reason

    def put_in_force(self, model: Model, now: float) -> None:
        """Follow another model. Raises CorrectionError."""
        self.chain.put_in_force(model, now, Deflection(model, self._robot, self._gravity, self._payload))

    def start(self, now: float) -> None:
        self.chain.start(now)

    def stop(self, now: float) -> None:
        self.chain.stop(now)

    def refuse(self, source: str, finding: Finding | None) -> None:
        if finding is None:
            self.chain.watchdog.clear(source)
        else:
            self.chain.watchdog.refuse(source, finding.fault, finding.text)

    def take(self, packet: RobotPacket, now: float) -> None:
        self.chain.take_joints(now, now, packet.q, float(packet.external[0]))

    def start_session(self, now: float) -> None:
        self.chain.start_session(now)

    def offset(self, now: float) -> tuple[Array, Array]:
        self._take_wrench(now)
        self._out = out = self.chain.tick(now)
        return out.translation, out.rotation

    def resynchronise(self, translation: Array, rotation: Array) -> None:
        self.chain.resynchronise(translation, rotation)

    def report(self, values: Array) -> None:
        c, faults = self.chain.counts, self.chain.watchdog.counters
        values[WHERE["chain"]] = c.ticks, c.limited, c.held, c.late
        values[WHERE["faults"]] = [faults[f] for f in FAULTS]
        if self._out is not None:
            values[WHERE["deflection"]], values[WHERE["wrench"]] = self._out.deflection, self._out.wrench_at_tcp

    def _take_wrench(self, now: float) -> None:
        if self._block is None:
            self._tries += 1
            if self._tries % 64 != 1:  # looking for the block costs a system call
                return
            try:
                self._block = SharedValues.attach(self._block_name, WRENCH_SIZE)
            except CorrectionError:
                return
        version = self._block.version
        if version == self._version or not self._block.read(self._values):
            return
        if version < self._version:  # the sensor's process was started anew
            self._version = 0
        self._version = version
        status = int(self._values[2])
        self.chain.take_wrench(
            float(self._values[0]), now, self._frame, self._values[3:9].copy(), f"status {status:#x}" if status else ""
        )


class GivenSource:
    """Offsets that another process writes, for example from the topic irec/offset: limited again here, held, then faded when
    stale.

    Asked to start, it waits for the first sound offset, and again after the offsets have ended at zero. After a FAULT it starts
    again when an offset of zero comes: whoever gives the offsets has been started again by its operator.
    """

    def __init__(self, settings: CorrectionSettings, block: SharedValues, timeout: float) -> None:
        """Args: timeout: s without a new offset."""
        self._block, self._timeout = block, timeout
        self._supervisor = Supervisor(replace(settings.times, ramp_in=0.0))
        self._limiter = OffsetLimiter(per_answer(settings.limits), settings.period)
        self._period = settings.period
        self._values = np.zeros(OFFSET_SIZE)
        self._last: float | None = None
        self._wanted = np.zeros(6)
        self._counts, self._faults = Counts(), Counter[Fault]()
        self._standing: Fault | None = None
        self._wants = False
        self._refused: dict[str, Finding] = {}

    @property
    def state(self) -> State:
        return self._supervisor.state

    @property
    def reason(self) -> str:
        return self._supervisor.reason

    def start(self, now: float) -> None:
        self._wants = True
        self._refused = {s: f for s, f in self._refused.items() if f.fault is not Fault.INTERNAL}
        if self.state is State.FAULT:
            self._supervisor.stop(now, self._present, "waiting for an offset")
        elif self.state is State.INACTIVE:
            self._supervisor.reason = "waiting for the first offset"

    def stop(self, now: float) -> None:
        self._wants = False
        self._supervisor.stop(now, self._present)

    def refuse(self, source: str, finding: Finding | None) -> None:
        if finding is None:
            self._refused.pop(source, None)
        else:
            self._refused[source] = finding

    def _start_when_sound(self, now: float) -> None:
        if not self._wants:
            return
        if self.state is State.FAULT and not np.any(np.abs(self._wanted) > ZERO_OFFSET):
            self._supervisor.stop(now, self._present)
        if self.state is State.INACTIVE:
            self._supervisor.start(now, self._present)

    @property
    def _at_zero(self) -> bool:
        """Neither asked for nor sent: whoever gives the offsets has ended in order."""
        return not np.any(np.abs(np.concatenate([self._wanted, self._present])) > ZERO_OFFSET)

    @property
    def _present(self) -> Array:
        return np.concatenate([self._limiter.translation.value, self._limiter.rotation.value])

    def take(self, packet: RobotPacket, now: float) -> None:
        """Nothing: whoever gives the offset knows where the robot is."""

    def start_session(self, now: float) -> None:
        self._limiter.reset()
        self._supervisor.restart_ramp(now, self._present, "a new RSI session has begun")

    def resynchronise(self, translation: Array, rotation: Array) -> None:
        self._limiter.resynchronise(translation, rotation)

    def report(self, values: Array) -> None:
        c = self._counts
        values[WHERE["chain"]] = c.ticks, c.limited, c.held, c.late
        values[WHERE["faults"]] = [self._faults[f] for f in FAULTS]

    def _finding(self, now: float) -> Finding | None:
        if self._refused:
            return next(iter(self._refused.values()))
        if not self._block.read(self._values) or not 0.0 <= now - self._values[0] + 1e-3 <= self._timeout:
            age = f"for {fixed(now - self._values[0], 3)} s" if self._block.version else "yet"
            return Finding(Fault.OFFSET_STALE, f"no offset {age}, limit {self._timeout} s")
        if not np.all(np.isfinite(self._values)):
            return Finding(Fault.OFFSET_NOT_FINITE, "offset holds NaN or infinity")
        return None

    def offset(self, now: float) -> tuple[Array, Array]:
        finding = self._finding(now)
        if finding is None:
            self._wanted = self._values[2:8].copy()
            self._start_when_sound(now)
        else:
            if finding.fault is not self._standing:
                self._faults[finding.fault] += 1
            if finding.fault is Fault.OFFSET_STALE and self._at_zero and self.state is not State.FAULT:
                self._supervisor.stop(now, self._present, "waiting for an offset: it ended at zero")
        self._standing = finding.fault if finding is not None else None
        dt = self._period if self._last is None else now - self._last
        self._last = now
        target = self._supervisor.tick(now, finding, self._wanted, self._present)
        c = self._counts
        c.ticks += 1
        c.late += dt > 2.0 * self._period
        c.limited += self._limiter.step(target[:3], target[3:], dt)
        c.held += self.state is State.HOLD
        return self._limiter.translation.value, self._limiter.rotation.value
