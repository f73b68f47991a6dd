# SPDX-License-Identifier: Apache-2.0
"""From the sensor's reading to the process wrench at the TCP: bias, tool weight, cable, change of frame, filters.

Wrenches are arrays (6,): force, N, then torque, N m; what the environment exerts on the robot side of the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from irec_calibration.robot import Robot, parent_joint
from irec_calibration.sensors.tool_load import ToolLoad
from irec_calibration.typing import Array

from .errors import SettingsError
from .filters import Filter, Median, low_pass, spindle_notches
from .fir import Fir


@dataclass(frozen=True)
class Cable:
    """Pull of a hose or dress pack that keeps its direction in the cell.

    Attributes:
        force_in_base: N, on the tool. point_in_sensor: where it pulls, m.
    """

    force_in_base: tuple[float, float, float] = (0.0, 0.0, 0.0)
    point_in_sensor: tuple[float, float, float] = (0.0, 0.0, 0.0)


def without_load(reading: Array, load: ToolLoad, cable: Cable, R_sensor_in_base: Array, gravity_in_base: Array) -> Array:
    """Take bias, weight of the tool and pull of the cable off a reading.

    Args:
        reading: in the sensor frame, (6,).
        R_sensor_in_base: (3, 3). gravity_in_base: m/s^2, (3,).
    """
    wrench = load.aligned(reading - load.reading(R_sensor_in_base, gravity_in_base))
    if any(cable.force_in_base):
        pull = R_sensor_in_base.T @ np.asarray(cable.force_in_base)
        wrench[:3] -= pull
        wrench[3:] -= _cross(cable.point_in_sensor, pull)
    return wrench


def to_tcp(wrench_in_sensor: Array, R_sensor_in_tool: Array, p_sensor_in_tool: Array) -> Array:
    """The same wrench in tool0, torque about the TCP, (6,); p_sensor_in_tool (3,), m."""
    force = R_sensor_in_tool @ wrench_in_sensor[:3]
    torque = R_sensor_in_tool @ wrench_in_sensor[3:] + _cross(p_sensor_in_tool, force)
    return np.concatenate([force, torque])


def _cross(a: Array | tuple[float, float, float], b: Array) -> Array:
    (ax, ay, az), (bx, by, bz) = a, b
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def sensor_in_tool(robot: Robot, frame: str) -> tuple[Array, Array]:
    """Rotation (3, 3) and position (3,), m, of a sensor frame in tool0, from the robot description.

    Raises:
        SettingsError: no such link, or it moves against tool0.
    """
    model = pin.buildModelFromXML(robot.completed_urdf)
    if not model.existFrame(frame):
        raise SettingsError(f"robot description has no link '{frame}', in which the force sensor is said to measure")
    sensor, tool = model.frames[model.getFrameId(frame)], model.frames[model.getFrameId("tool0")]
    if parent_joint(sensor) != parent_joint(tool):
        raise SettingsError(
            f"link '{frame}' is not fixed to tool0, so that a force sensor there does not measure the process force"
        )
    T = tool.placement.actInv(sensor.placement)
    return np.array(T.rotation), np.array(T.translation)


@dataclass(frozen=True)
class FilterSettings:
    """Filters of the wrench, in the order in which they act.

    Attributes:
        rate: of the samples, Hz. median: samples, 0 for none.
        spindle_speed: 1/s, 0 for none; harmonics: notches; notch_quality: frequency / bandwidth.
        cutoff: of the low-pass, Hz, 0 for none; order.
        taps: of a designed filter in place of the low-pass (`irec filter`), newest sample first; (1.0,) for none.
        posture_taps: of one with other taps for each axis of the force and at each posture (`course_filter.learn`), in place of
            `taps`: postures, taps, axes, and where axes answer one another, the axes that they are from; postures: joint angles,
            rad.
    """

    rate: float = 250.0
    median: int = 0
    spindle_speed: float = 0.0
    harmonics: int = 2
    notch_quality: float = 5.0
    cutoff: float = 40.0
    order: int = 2
    taps: Sequence[float] = (1.0,)
    posture_taps: Sequence[Sequence[Sequence[float | Sequence[float]]]] = ()
    postures: Sequence[Sequence[float]] = ()

    @property
    def designed(self) -> bool:
        """Whether a designed filter takes the place of the low-pass."""
        return len(self.taps) != 1 or len(self.posture_taps) > 0


def make_filters(s: FilterSettings) -> list[Filter]:
    """The stages that the settings ask for. Raises SettingsError."""
    if not (math.isfinite(s.rate) and s.rate > 0.0):
        raise SettingsError(f"sampling rate of the wrench is {s.rate} Hz; it must be above 0")
    out: list[Filter] = []
    if s.median:
        out.append(Median(s.median, s.rate))
    if s.spindle_speed:
        out += spindle_notches(s.spindle_speed, s.harmonics, s.notch_quality, s.rate)
    if len(s.posture_taps):
        out.append(
            Fir(np.array(s.posture_taps, dtype=float), s.rate, np.array(s.postures, dtype=float).reshape(len(s.posture_taps), -1))
        )
    elif s.designed:
        out.append(Fir(np.array(s.taps, dtype=float), s.rate))
    elif s.cutoff:
        out.append(low_pass(s.cutoff, s.order, s.rate))
    return out


class Conditioner:
    """All stages in a row, for a wrench that is either already at the TCP or raw in the sensor frame.

    Attributes:
        unfiltered: the last wrench at the TCP before the filters, (6,), N and N m.
    """

    def __init__(
        self,
        filters: Sequence[Filter],
        sensor_in_tool: tuple[Array, Array] | None = None,
        load: ToolLoad | None = None,
        cable: Cable | None = None,
        gravity_in_base: Sequence[float] = (0.0, 0.0, -9.81),
    ) -> None:
        """Args: sensor_in_tool: rotation and position of the sensor frame in tool0; None: wrenches come at the TCP already."""
        self.filters = list(filters)
        self.sensor = sensor_in_tool
        self.load = load if load is not None else ToolLoad()
        self.cable = cable if cable is not None else Cable()
        self._gravity = np.asarray(gravity_in_base, dtype=float)
        self.unfiltered = np.zeros(6)

    def reset(self) -> None:
        """Forget what the filters hold."""
        for f in self.filters:
            f.reset()

    def place(self, q: Array) -> None:
        """The robot is at joint angles q (joints,), rad."""
        for f in self.filters:
            if isinstance(f, Fir):
                f.place(q)

    def step(self, reading: Array, R_tool_in_base: Array) -> Array:
        """Process wrench at the TCP in tool0, (6,), from one reading (6,)."""
        wrench = reading
        if self.sensor is not None:
            R_sensor_in_tool, p_sensor_in_tool = self.sensor
            R = R_tool_in_base @ R_sensor_in_tool
            wrench = to_tcp(without_load(reading, self.load, self.cable, R, self._gravity), R_sensor_in_tool, p_sensor_in_tool)
        self.unfiltered = wrench
        for f in self.filters:
            wrench = f.step(wrench)
        return wrench
