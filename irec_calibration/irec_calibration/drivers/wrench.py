# SPDX-License-Identifier: Apache-2.0
"""The process wrench at the TCP from a sensor that knows neither tool nor contract."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..cell import Cell
from ..errors import CellError
from ..robot import parent_joint
from ..sensors.tool_load import G, ToolLoad
from ..typing import Array


class ProcessWrench:
    """Takes bias and weight off a reading and moves it to tool0; environment on robot.

    Args:
        frame: link in which the sensor reads. sign: -1 where it reads what the robot exerts on the environment.

    Raises:
        CellError: no such link, or it moves against tool0.
    """

    def __init__(self, cell: Cell, frame: str, load: ToolLoad, sign: float = 1.0) -> None:
        self._robot, self._load, self.sign = cell.robot, load, sign
        model = pin.buildModelFromXML(cell.robot.completed_urdf)
        self.links = frozenset(frame.name for frame in model.frames)  # of the robot description
        if not model.existFrame(frame):
            raise CellError(f"robot description has no link '{frame}', in which the force sensor is said to measure")
        sensor, tool = model.frames[model.getFrameId(frame)], model.frames[model.getFrameId("tool0")]
        if parent_joint(sensor) != parent_joint(tool):
            raise CellError(f"link '{frame}' is not fixed to tool0: a force sensor there does not measure the process force")
        T = tool.placement.actInv(sensor.placement)
        self.R_sensor_in_tool, self._p = np.array(T.rotation), np.array(T.translation)

    def raw(self, reading: Array) -> Array:
        """The reading (6,), N and N m, in the sensor frame, with the contract's sign."""
        return self.sign * reading

    def at_tcp(self, raw: Array, R_tool_in_base: Array) -> Array:
        """Process wrench (6,) in tool0, torque about the TCP, from a raw one (6,); R_tool_in_base (3, 3)."""
        in_sensor = self._load.aligned(raw - self._load.reading(R_tool_in_base @ self.R_sensor_in_tool, np.array(G)))
        force = self.R_sensor_in_tool @ in_sensor[:3]
        return np.concatenate([force, self.R_sensor_in_tool @ in_sensor[3:] + np.cross(self._p, force)])
