# SPDX-License-Identifier: Apache-2.0
"""What the instruments of the simulated cell read of its true state: noise, bias, delay, drop-outs, line of sight."""

from __future__ import annotations

import math

import numpy as np

from .cellfile import CellFile
from .instruments import Delay, InstrumentSettings, Noise
from .kinematics import Array, skew
from .sensing import SensingParameters, force_reading, tracker_reading
from .sight import visible

SIGHT_REUSE = 5e-4  # rad and m by which robot and rail may move before the line of sight is computed again


class Readings:
    """Force sensor, tracker, encoders and thermometers of one cell.

    Attributes:
        wrench_raw: reading of the force sensor in its own frame with bias and tool weight, (6,), N and N m.
        wrench: process wrench at the TCP in tool0, bias and weight removed, (6,), N and N m.
    """

    def __init__(self, cell: CellFile, sensing: SensingParameters, settings: InstrumentSettings, seed: int) -> None:
        self._cell, self._sensing, self._settings = cell, sensing, settings
        self._noise = Noise(seed, settings, cell.chain.n, len(cell.stations))
        self._force_delay: Delay[Array] = Delay(settings.force_delay)
        self._tracker_delay: Delay[tuple[str, Array] | None] = Delay(settings.tracker_delay)
        self._cross_tcp, self._cross_com = skew(cell.chain.p_tcp), skew(cell.chain.tool_com)
        self._sight: tuple[Array, float, int | None] | None = None
        self.wrench_raw, self.wrench = np.zeros(6), np.zeros(6)

    def read_force(self, time: float, force: Array, R_tool: Array) -> None:
        """Take a reading at a time, s, of a force on the robot, (3,), N in base_link, with tool0 turned by R_tool, (3, 3)."""
        clean = force_reading(self._sensing, self._cell.sensor_axis, (R_tool.T @ force)[None], R_tool[None])[0]
        noise = self._noise.force(time)
        chain = self._cell.chain
        R_sensor = R_tool @ chain.R_tcp.T
        weight = R_sensor.T @ np.array([0.0, 0.0, -9.81 * chain.tool_mass])
        at_sensor = chain.R_tcp @ clean
        raw = np.concatenate([at_sensor + weight, self._cross_tcp @ at_sensor + self._cross_com @ weight])
        raw += noise + np.array(self._settings.force_bias)
        wrench = np.concatenate([clean, np.zeros(3)])
        wrench[:3] += chain.R_tcp.T @ noise[:3]
        wrench[3:] += chain.R_tcp.T @ (noise[3:] - self._cross_tcp @ noise[:3])
        both = self._force_delay.pass_through(time, np.concatenate([raw, wrench]))
        self.wrench_raw, self.wrench = both[:6], both[6:]

    def encoders(self) -> Array:
        """Noise of the reported joint angles, (n,), rad."""
        return self._noise.encoder()

    def tracker(self, time: float, marker: Array, q: Array, rail: float) -> tuple[str, Array] | None:
        """Station that sees the marker and the marker in its frame, (3,), m; None without line of sight or in a drop-out.

        With a delay in the settings this is the reading of that time ago.

        Args:
            marker: in the cell frame, (3,), m. q, rail: of the robot, rad and m, for the line of sight.
        """
        moved = self._sight is None or np.abs(self._sight[0] - q).max() > SIGHT_REUSE or abs(self._sight[1] - rail) > SIGHT_REUSE
        if moved:
            self._sight = q, rail, visible(self._cell, q, rail, marker)
        index = self._sight[2] if self._sight is not None else None
        reading: tuple[str, Array] | None = None
        if index is not None and not self._noise.drop_outs[index].silent(time):
            name, p_station, R_station = self._cell.stations[index]
            shifted = np.array([time >= self._sensing.shift_time])
            clean = tracker_reading(self._sensing, marker[None], index, p_station, R_station, shifted)[0]
            noise = self._cell.noise
            sigma = math.hypot(noise["tracker_m"], noise["tracker_m_per_m"] * float(np.linalg.norm(clean)))
            reading = name, clean + self._noise.tracker(index, time, sigma)
        return self._tracker_delay.pass_through(time, reading)

    def thermometers(self, ambient: float, gears: Array) -> dict[str, float]:
        """degC: ambient, gear_1 .. gear_n."""
        values = np.concatenate([[ambient], gears])
        values = np.round(values + self._noise.temperature.normal(0.0, 0.02, values.shape), 2)
        return dict(zip(["ambient", *(f"gear_{k + 1}" for k in range(len(gears)))], values.tolist(), strict=True))
