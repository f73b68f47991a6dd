# SPDX-License-Identifier: Apache-2.0
"""How instruments and controller see the cell: systematic errors and noise of sensor, tracker, encoders.

Errors are deterministic functions of the true state; noise is drawn by the caller. Shared by the direct session
generator and the time-stepped cell.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .kinematics import Array, rotation, rotation_of_vector

AMBIENT = 22.0  # degC, at which drift is zero


def _zeros(*shape: int) -> Array:
    return np.zeros(shape)


@dataclass(frozen=True)
class SensingParameters:
    """Systematic errors; neutral by default.

    Attributes:
        sensor_matrix: crosstalk E of the force sensor, reading (I + E) f in tool0, (3, 3).
        sensor_turn: rad by which the sensor is mounted rotated about its axis.
        sensor_lag: share of the load before that it still reads; sensor_hysteresis: N that it reads too little after a rise of
            the load of more than that; sensor_bend: relative loss of gain per kN; sensor_heat: relative gain per kelvin of
            the ambient temperature above AMBIENT. No calibration has a name for these.
        weight_error: mass that the weight removal forgets, kg.
        tracker_scale: relative.
        station_turn: rotation vector of the true against the stated station frame, (stations, 3), rad.
        station_shift: displacement of one station from some moment on, in base_link, (3,), m; shift_station: index;
            shift_time: the moment in a cell that runs, s; shift_share: in a generated session, as a share of its poses.
        drift: of the warming arm against the tracker, in base_link, (3,): m/s (drift_kind linear), m in the end
            (warm_up), m/K (ambient).
        marker_error: true minus stated marker position in tool0, (3,), m.
        encoder_sin, encoder_cos: true minus reported joint angle, per sin(h q), cos(h q), h = 1, 2; (2, n), rad.
        settle: share of the step from the previous row that the arm is further than reported, (n,).
    """

    sensor_matrix: Array = field(default_factory=lambda: _zeros(3, 3))
    sensor_turn: float = 0.0
    sensor_lag: float = 0.0
    sensor_hysteresis: float = 0.0
    sensor_bend: float = 0.0
    sensor_heat: float = 0.0
    weight_error: float = 0.0
    tracker_scale: float = 0.0
    station_turn: Array = field(default_factory=lambda: _zeros(1, 3))
    station_shift: Array = field(default_factory=lambda: _zeros(3))
    shift_time: float = np.inf
    shift_share: float = 1.0
    shift_station: int = 0
    drift: Array = field(default_factory=lambda: _zeros(3))
    drift_kind: str = "linear"
    drift_time: float = 900.0
    marker_error: Array = field(default_factory=lambda: _zeros(3))
    encoder_sin: Array = field(default_factory=lambda: _zeros(2, 6))
    encoder_cos: Array = field(default_factory=lambda: _zeros(2, 6))
    settle: Array = field(default_factory=lambda: _zeros(6))

    @classmethod
    def plain(cls, n: int) -> SensingParameters:
        """Instruments without errors for a robot of n joints."""
        return cls(encoder_sin=_zeros(2, n), encoder_cos=_zeros(2, n), settle=_zeros(n))


def per_joint(n: int) -> dict[str, Any]:
    """The neutral values of all fields that are per joint, for a robot of n joints."""
    return {"encoder_sin": _zeros(2, n), "encoder_cos": _zeros(2, n), "settle": _zeros(n)}


def force_reading(
    par: SensingParameters, sensor_axis: Array, force_in_tool: Array, R_tool_in_base: Array,
    before: Array | None = None, ambient: Array | None = None,
) -> Array:  # fmt: skip
    """What the sensor reads in tool0 after weight removal, without noise, for forces (n, 3) in N.

    Args:
        before: force of the row before, (n, 3), N (None: as now); ambient: degC, (n,) (None: at AMBIENT).
    """
    force = force_in_tool
    if before is not None:
        rise = force_in_tool - before
        force = force - par.sensor_lag * rise
        if par.sensor_hysteresis:
            force = force - par.sensor_hysteresis * np.tanh(rise / (3.0 * par.sensor_hysteresis))
    if par.sensor_bend:
        force = force * (1.0 - par.sensor_bend * np.abs(force) / 1000.0)
    if ambient is not None and par.sensor_heat:
        force = force * (1.0 + par.sensor_heat * (ambient - AMBIENT))[:, None]
    turned = force @ rotation(sensor_axis, par.sensor_turn)  # the sensor's frame is turned, so f turns back
    weight = R_tool_in_base.swapaxes(1, 2) @ np.array([0.0, 0.0, -9.81 * par.weight_error])
    return turned @ (np.eye(3) + par.sensor_matrix).T + weight


def true_force(
    par: SensingParameters, sensor_axis: Array, reading: Array, R_tool_in_base: Array,
    before: Array | None = None, ambient: Array | None = None,
) -> Array:  # fmt: skip
    """The force in tool0, (n, 3), N, behind a reading of `force_reading`; sensors are nearly right, so a few passes find it."""
    force = reading
    for _ in range(30):
        missing = reading - force_reading(par, sensor_axis, force, R_tool_in_base, before, ambient)
        force = force + missing
        if np.abs(missing).max() < 1e-9:
            break
    return force


def motor_angles(par: SensingParameters, q_reported: Array, step: Array) -> Array:
    """True motor angles (n, joints) when the controller reports q_reported and the last step was `step`, rad."""
    out = q_reported + par.settle * step
    for h in (1, 2):
        out = out + par.encoder_sin[h - 1] * np.sin(h * q_reported) + par.encoder_cos[h - 1] * np.cos(h * q_reported)
    return out


def beyond_reported(par: SensingParameters, jacobian: Array, step: Array) -> Array:
    """How far the TCP is beyond its place by the reported angles because they were read early, (n, 3), m in base_link.

    Args:
        jacobian: of the TCP, (n, 6, joints); step: that the joints made last, (n, joints), rad.
    """
    out: Array = (jacobian[:, :3] @ (par.settle * step)[:, :, None])[..., 0]
    return out


def drift_at(par: SensingParameters, stamp: Array, ambient: Array) -> Array:
    """Displacement of the arm against the tracker in base_link, (n, 3), m; stamp in s and ambient in degC, (n,)."""
    if par.drift_kind == "linear":
        course = stamp
    elif par.drift_kind == "warm_up":
        course = 1.0 - np.exp(-stamp / par.drift_time)
    else:
        course = ambient - AMBIENT
    return np.asarray(course)[:, None] * par.drift


def tracker_reading(
    par: SensingParameters, p_in_cell: Array, station: int, p_station: Array, R_station: Array, shifted: Array
) -> Array:
    """Marker in the frame of a station without noise, (n, 3), m.

    Args:
        p_in_cell: true marker, in the cell frame, (n, 3).
        station: index; p_station, R_station: its stated pose in the cell frame.
        shifted: rows after the station was bumped, (n,) bool.
    """
    p = p_in_cell
    if station == par.shift_station:
        p = p - par.station_shift * shifted[:, None]
    away = p - p_station
    turn = par.station_turn[min(station, len(par.station_turn) - 1)]
    R_true = R_station @ rotation_of_vector(turn)
    return (1.0 + par.tracker_scale) * away @ R_true
