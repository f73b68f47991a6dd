# SPDX-License-Identifier: Apache-2.0
"""What the readings of a standing robot in free air must be like before a recertification may begin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from ..session import Session
from ..typing import Array, IntArray
from .preconditions import Precondition

FEWEST = 20  # readings of one instrument in the time looked at
FORCE_ZERO = 0.02  # of the sensor's range: largest mean force in free air
MARKER_DRIFT = 2.0e-6  # m/s, each axis: between reference and load case that stays below the noise of a tracker
SLOW = 1.57  # line through slow noise (air) of unit standard deviation: largest standard deviation of its rise, whatever the time
CLAIM = 2.0  # a tracker may be noisier than its data sheet by so much
DRIFT_HIDDEN_M = 5.0e-4  # where readings scatter so that not even this would show, nothing is measured
MOVED_RAD = 1.0e-3
FALSE_REFUSAL = 5.0e-4  # probability at the most, for an instrument that is just within its limit
BLOCKS = 20  # of readings, at the most; readings within a block may be correlated
COLDER = 15.0  # K below the coldest reading of the calibration in force
MANNED = ("area", "disc", "tool")  # what only a person can see
ASK = {
    "area": "look whether nobody is in the area of the robot",
    "disc": "look whether the disc is whole, clean and tight, and the surface too",
    "tool": "look whether this is the tool that the calibration is for, and that it is tight",
}


@dataclass(frozen=True)
class Readings:
    """Readings over a few seconds in which nothing was asked of the robot.

    Attributes:
        force_in_tool: (n, 3), N. p_marker_in_station: (m, 3), m. q: (k, joints), rad.
        t_marker: stamps of the marker readings, (m,), s. stations: station that each of them carried, m names.
        temperature: name -> degC.
        mode: control mode by the driver in words, empty where it said nothing; moving: it is under way.
    """

    force_in_tool: Array
    p_marker_in_station: Array
    q: Array
    t_marker: Array
    stations: Sequence[str]
    temperature: Mapping[str, float]
    mode: str
    moving: bool


def judged_readings(
    r: Readings,
    range_n: float,
    stations: Sequence[str],
    confirmed: Sequence[str],
    before: Session | None,
    noise: Mapping[str, float],
) -> tuple[Precondition, ...]:
    """Robot, force sensor, tracker, temperature, and what a person has to look at.

    Args:
        range_n: of the force sensor, one axis, N. stations: names in the cell file.
        confirmed: what the operator has looked at. before: session of the calibration in force.
        noise: of the cell file: tracker_m (m), tracker_m_per_m.
    """
    return (_robot(r), _force(r, range_n), _tracker(r, stations, noise), _temperature(r, before), *_manned(confirmed))


@dataclass(frozen=True)
class Trend:
    """Straight line through readings of a standing instrument, each axis.

    Attributes:
        mean, mean_se: of the readings, and its standard error, (3,). drift, drift_se: by how much the line rises over the time
            looked at, (3,). margin: standard errors to allow for, so that all axes together exceed it by chance with
            probability FALSE_REFUSAL.
    """

    mean: Array
    mean_se: Array
    drift: Array
    drift_se: Array
    margin: float


def trend_of(t: Array, readings: Array) -> Trend:
    """Mean and drift of readings (n, axes) at times (n,), s, with standard errors from medians of blocks.

    The readings themselves are not taken as independent: vibration and turbulence are correlated over many of them, and single
    ones may be far off. n >= FEWEST.
    """
    count = int(np.clip(len(t) // 2, 4, BLOCKS))
    order = np.argsort(t, kind="stable")[len(t) % count :]
    y = np.median(readings[order].reshape(count, -1, readings.shape[1]), axis=1)
    x = t[order].reshape(count, -1).mean(axis=1)
    length = float(np.ptp(t)) or 1.0
    x = (x - x.mean()) / length
    spread = float(x @ x) or 1.0
    drift = x @ y / spread
    freedom = count - 2
    scatter = np.sqrt(np.sum((y - y.mean(axis=0) - np.outer(x, drift)) ** 2, axis=0) / freedom)
    margin = float(-stdtrit(freedom, FALSE_REFUSAL / (2.0 * y.shape[1])))
    return Trend(y.mean(axis=0), scatter / np.sqrt(count), drift, scatter / np.sqrt(spread), margin)


def enough_readings(r: Readings, noise: Mapping[str, float]) -> bool:
    """Whether the marker plainly stands still; else it is worth looking longer."""
    seen = _rows_by_station(r)
    if len(r.force_in_tool) < FEWEST or len(r.q) < FEWEST or not seen or len(seen[0]) < FEWEST:
        return False
    line, allowed = _drift(r, seen[0], noise)
    return bool(np.all(np.abs(line.drift) <= 0.5 * allowed) and np.all(line.margin * line.drift_se <= DRIFT_HIDDEN_M))


def _drift(r: Readings, rows: IntArray, noise: Mapping[str, float]) -> tuple[Trend, Array]:
    """Trend of the marker, and what each axis may drift: the limit, and what the noise makes of a marker that stands, (3,), m.

    Standard errors from the scatter of the readings don't hold the slow noise, which looks like a drift; how large it can be is
    what the data sheet says.
    """
    t, p = r.t_marker[rows], r.p_marker_in_station[rows]
    line = trend_of(t, p)
    distance = float(np.median(np.linalg.norm(p, axis=1)))
    sigma = CLAIM * (noise.get("tracker_m", 0.0) + noise.get("tracker_m_per_m", 0.0) * distance)
    slow = SLOW * sigma * float(-ndtri(FALSE_REFUSAL / 6.0))
    return line, MARKER_DRIFT * float(np.ptp(t)) + np.hypot(line.margin * line.drift_se, slow)


def _robot(r: Readings) -> Precondition:
    if not r.mode or len(r.q) < FEWEST:
        return Precondition("robot", False, "robot/state or joint_states is silent; start the robot's driver")
    ends = len(r.q) // 4  # medians: one reading that is far off is no movement
    moved = float(np.abs(np.median(r.q[-ends:], axis=0) - np.median(r.q[:ends], axis=0)).max())
    if r.mode != "position" or r.moving or moved > MOVED_RAD:
        now = f"is in {r.mode} control" + (" and moves" if r.moving or moved > MOVED_RAD else "")
        return Precondition("robot", False, f"the robot {now}; let it stand in position control, away from the surface")
    return Precondition("robot", True, "stands in position control")


def _force(r: Readings, range_n: float) -> Precondition:
    if len(r.force_in_tool) < FEWEST:
        return Precondition("force sensor", False, "topic wrench is silent; start the sensor's driver")
    number = np.isfinite(r.force_in_tool).all(axis=1)
    if not number.all():
        lost = f"{np.count_nonzero(~number)} of {number.size} readings are no number"
        return Precondition("force sensor", False, f"{lost}; restart its driver, look at its cable")
    line = trend_of(np.arange(len(r.force_in_tool), dtype=float), r.force_in_tool)
    mean = float(np.abs(line.mean).max())
    limit = FORCE_ZERO * range_n
    zero = bool(np.all(np.abs(line.mean) <= limit + line.margin * line.mean_se))
    advice = "" if zero else "; free the tool, then set the sensor to zero or identify the tool load anew (irec tool-load)"
    return Precondition("force sensor", zero, f"reads {mean:.1f} N in free air (limit {limit:.0f} N){advice}")


def _tracker(r: Readings, stations: Sequence[str], noise: Mapping[str, float]) -> Precondition:
    strange = sorted(set(r.stations) - set(stations))
    if strange:
        known = ", ".join(stations)
        return Precondition(
            "tracker", False, f"readings carry the station {strange[0]!r}, the cell file has {known}; name it so there"
        )
    seen = _rows_by_station(r)
    if not seen or len(seen[0]) < FEWEST:
        return Precondition("tracker", False, "does not see the marker; free the line of sight, lock on to the marker")
    line, allowed = _drift(r, seen[0], noise)
    um, worst = 1e6, int(np.argmax(np.abs(line.drift) / allowed))
    seconds = float(np.ptp(r.t_marker[seen[0]]))
    text = f"the marker drifts by {um * abs(line.drift[worst]):.0f} um in {seconds:.1f} s while the robot stands"
    text += f" (limit with the noise of this tracker {um * allowed[worst]:.0f} um)"
    if np.any(np.abs(line.drift) > allowed):
        return Precondition("tracker", False, f"{text}; let the tracker warm up, look at its stand")
    if np.any(line.margin * line.drift_se > DRIFT_HIDDEN_M):
        text = f"its readings scatter so much that a drift of {um * DRIFT_HIDDEN_M:.0f} um would not be seen"
        return Precondition("tracker", False, f"{text}; free the line of sight, look at marker and stand for vibration")
    return Precondition("tracker", True, text)


def _rows_by_station(r: Readings) -> list[IntArray]:
    """Readings that are numbers, of each station, the one that sees most first."""
    number = np.isfinite(r.p_marker_in_station).all(axis=1)
    of = np.array(list(r.stations))
    rows: list[IntArray] = [np.flatnonzero((of == name) & number) for name in sorted(set(r.stations))]
    return sorted((i for i in rows if len(i)), key=lambda i: len(i), reverse=True)


def _temperature(r: Readings, before: Session | None) -> Precondition:
    if before is None or not before.temperature:
        return Precondition("temperature", True, "not compared: none was logged with the calibration in force")
    if not r.temperature:
        return Precondition("temperature", True, "not compared: no thermometer is heard now; the calibration in force had some")
    for name, now in r.temperature.items():
        then = before.temperature.get(name)
        if then is not None and np.isfinite(then).any() and now < float(np.nanmin(then)) - COLDER:
            low = float(np.nanmin(then))
            text = f"{name} is {now:.0f} degC, the calibration in force began at {low:.0f} degC; move the robot until it is warm"
            return Precondition("temperature", False, text)
    return Precondition("temperature", True, "like that of the calibration in force")


def _manned(confirmed: Sequence[str]) -> tuple[Precondition, ...]:
    given = set(confirmed)
    return tuple(
        Precondition(name, name in given, "confirmed by the operator" if name in given else f"{ASK[name]}, then confirm '{name}'")
        for name in MANNED
    )
