# SPDX-License-Identifier: Apache-2.0
"""Level `moves`: in free air. Kinematics on the way, gravity on the raw sensor, marker against TCP, cancel and refusals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ..cell import Cell
from ..identification.validation import rms
from ..procedure.axes import Axes
from ..typing import Array
from .observed import Answer, Item, Observation, Stream, at
from .passive import positions

LEVEL = "moves"
ON_THE_WAY = 2e-3  # m between forward kinematics and tcp_pose while moving: 10 ms at 0.2 m/s
ARRIVAL = 5e-4  # m between where a move was to end and where it ended
RIGID = 1e-3  # m, RMS of the marker about a rigid fit to tcp_pose
STATION = np.radians(1.0)  # rad between the station of that fit and of the cell file
WEIGHT_REST = 15.0  # N of wrench_raw that weight and bias leave
WEIGHTLESS = 30.0  # N of wrench in any orientation
LEAST_MASS = 0.5  # kg; a lighter tool has no sign
OFF_PATH = 2e-3  # m off the line after a cancel
SKEW = 0.02  # s between tracker and tcp_pose
STOPPED = 2.0  # s for a cancelled move to stand


@dataclass(frozen=True)
class Moves:
    """What was done and seen.

    Attributes:
        standing: observations at standing poses of different orientation, at least three. way: one straight move at speed.
        line: begin and end of it, (2, 3), m in base_link. arrived: (asked, reached) positions of moves that succeeded, m.
        answers: of those moves. cancelled: answer to a cancelled one, and where it stood then, (3,), m.
        refused: what should be refused -> answer; moved: way of the TCP meanwhile, m.
    """

    standing: list[Observation]
    way: Observation
    line: Array
    arrived: list[tuple[Array, Array]]
    answers: list[Answer]
    cancelled: Answer
    p_cancelled: Array
    refused: dict[str, Answer]
    moved: float


def judge_moves(m: Moves, cell: Cell, axes: Axes) -> list[Item]:
    """All items of the level."""
    marker = () if cell.without_tracker else _marker(m, cell, axes)
    return [*_answers(m), *_on_the_way(m, cell, axes), *marker, *_weight(m, cell)]


def _item(name: str, passed: bool, figure: str, limit: str, advice: str) -> Item:
    return Item(LEVEL, name, bool(passed), figure, limit, advice)


def _answers(m: Moves) -> Iterator[Item]:
    failed = next((a.message for a in m.answers if not a.success), "")
    yield _item("moves succeed", not failed, failed or f"{len(m.answers)} moves", "", "see the message of the driver")
    if m.arrived:
        worst = max(float(np.linalg.norm(asked - reached)) for asked, reached in m.arrived)
        yield _item(
            "moves arrive where asked",
            worst <= ARRIVAL,
            f"{1e3 * worst:.3f} mm",
            f"{1e3 * ARRIVAL:g} mm",
            "answer success only when standing at the goal; m and rad, tool0 in base_link",
        )
    c = m.cancelled
    yield _item(
        "a cancelled move answers canceled",
        c.cancelled,
        c.message or ("canceled" if c.cancelled else "not canceled"),
        "",
        "a cancelled move slows down on its path and answers canceled when standing",
    )
    yield _item(
        "a cancelled move stands soon", c.took <= STOPPED, f"{c.took:.2f} s", f"{STOPPED:g} s", "stop on the path, at once"
    )
    a, b = m.line
    along = (b - a) / np.linalg.norm(b - a)
    off = m.p_cancelled - a
    side = float(np.linalg.norm(off - (off @ along) * along))
    yield _item(
        "a cancelled move stays on its path",
        side <= OFF_PATH,
        f"{1e3 * side:.2f} mm",
        f"{1e3 * OFF_PATH:g} mm",
        "stop on the path",
    )
    for what, answer in m.refused.items():
        yield _item(
            f"refused: {what}",
            not answer.success and bool(answer.message),
            answer.message or ("accepted" if answer.success else "no reason"),
            "aborted with a reason",
            "check a goal before the robot moves; abort it at once with the reason in `message`",
        )
    yield _item(
        "a refused goal moves nothing",
        m.moved <= ARRIVAL,
        f"{1e3 * m.moved:.3f} mm",
        f"{1e3 * ARRIVAL:g} mm",
        "never drive part of the way",
    )


def _on_the_way(m: Moves, cell: Cell, axes: Axes) -> Iterator[Item]:
    found, tcp = positions(m.way, axes), m.way.streams.get("tcp_pose")
    if found is None or tcp is None or len(tcp.stamp) < 10:
        yield _item("readings while moving", False, "too few", "", "keep publishing joint_states and tcp_pose while moving")
        return
    q = at(Stream(found[1].stamp, found[1].arrival, found[0]), tcp.stamp)
    off = np.linalg.norm(cell.robot.kinematics(q[:, : cell.robot.n_joints]).p_tcp - tcp.value[:, :3], axis=1)
    yield _item(
        "tcp_pose against the joint angles while moving",
        float(off.max()) <= ON_THE_WAY,
        f"{1e3 * off.max():.2f} mm",
        f"{1e3 * ON_THE_WAY:g} mm",
        "stamp both with the time of the reading; tcp_pose comes from the measured angles, not from the commanded",
    )
    state = m.way.streams.get("robot/state")
    if state is not None and len(state.value):
        yield _item(
            "robot/state says in_motion",
            bool(state.value[:, 1].any()),
            "yes" if state.value[:, 1].any() else "never",
            "",
            "set in_motion while a Move runs",
        )
    marker = m.way.streams.get("tracker/point")
    if marker is not None and len(marker.stamp) > 20 and not cell.without_tracker:
        skew = _skew(marker, tcp, m.line)
        yield _item(
            "stamps of tracker/point against tcp_pose",
            abs(skew) <= SKEW,
            f"{1e3 * skew:.0f} ms",
            f"{1e3 * SKEW:g} ms",
            "bring the tracker's clock to the ROS clock; the stamp is that of the measurement",
        )


def _skew(marker: Stream, tcp: Stream, line: Array) -> float:
    """Time by which the marker's stamps are late, s, from how far along the line both have come."""
    p0, p1 = marker.value[0], marker.value[-1]
    way = float(np.linalg.norm(p1 - p0))
    if way < 0.02:
        return 0.0
    seen = (marker.value - p0) @ (p1 - p0) / way
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    by_tcp = tcp.value[:, :3] @ along
    delays = np.linspace(-0.3, 0.3, 301)
    cost = []
    for delay in delays:
        expected = np.interp(marker.stamp - delay, tcp.stamp, by_tcp)
        cost.append(float(np.std(seen - expected)))
    return float(delays[int(np.argmin(cost))])


def _marker(m: Moves, cell: Cell, axes: Axes) -> Iterator[Item]:
    by_tcp, seen, stations = [], [], []
    for o in m.standing:
        tcp, s, found = o.mean("tcp_pose"), o.streams.get("tracker/point"), positions(o, axes)
        if tcp is None or s is None or not len(s.value) or found is None:
            continue
        rail = found[0][-1, cell.robot.n_joints] if cell.rail is not None else 0.0
        R = Rotation.from_quat(tcp[3:]).as_matrix()
        by_tcp.append(tcp[:3] + R @ cell.marker_in_tool + cell.base_in_cell(np.array([rail]))[0])
        seen.append(s.value.mean(axis=0))
        stations.append(s.frame[-1])
    station = next((st for st in cell.stations if stations and st.name == stations[0]), None)
    if station is None or len(by_tcp) < 4 or len(set(stations)) > 1:
        yield _item(
            "marker against tcp_pose, rigid fit",
            False,
            f"{len(by_tcp)} poses with a marker in one station's sight",
            "4",
            "let one station see the marker in free air above the surface",
        )
        return
    a, b = np.array(by_tcp), np.array(seen)
    fit, _ = Rotation.align_vectors(a - a.mean(axis=0), b - b.mean(axis=0))
    rest = (a - a.mean(axis=0)) - fit.apply(b - b.mean(axis=0))
    left = rms(rest)
    scale = float(np.linalg.norm(b - b.mean(axis=0)) / np.linalg.norm(a - a.mean(axis=0)))
    advice = (
        "tracker/point is in mm, m is needed"
        if scale > 300
        else (
            "does the tracker hold a point, or see another reflector?"
            if scale < 0.1
            else "is tool.marker_in_tool0 of the cell file right?"
        )
    )
    yield _item("marker against tcp_pose, rigid fit", left <= RIGID, f"{1e3 * left:.2f} mm", f"{1e3 * RIGID:g} mm", advice)
    turn = float((Rotation.from_matrix(station.R_in_cell).inv() * fit).magnitude())
    yield _item(
        "station of the tracker against the cell file",
        turn <= STATION,
        f"{np.degrees(turn):.2f} deg",
        f"{np.degrees(STATION):.1f} deg",
        "the points are to be in the frame of the station that the cell file describes; register it anew",
    )


def _weight(m: Moves, cell: Cell) -> Iterator[Item]:
    raw, R, free = [], [], []
    for o in m.standing:
        tcp, f, w = o.mean("tcp_pose"), o.mean("wrench_raw"), o.mean("wrench")
        if tcp is None or f is None or w is None:
            continue
        raw.append(f[:3])
        free.append(float(np.abs(w[:3]).max()))
        R.append(Rotation.from_quat(tcp[3:]).as_matrix())
    if len(raw) < 4:
        return
    yield _item(
        "wrench in every orientation",
        max(free) <= WEIGHTLESS,
        f"{max(free):.1f} N",
        f"{WEIGHTLESS:g} N",
        "remove the tool's weight from wrench",
    )
    S = _sensor_in_tool(cell)
    down = np.array([S.T @ r.T @ [0.0, 0.0, -9.81] for r in R])  # free fall in the sensor's frame: raw = mass * down + bias
    A = np.vstack([np.hstack([d[:, None], np.eye(3)]) for d in down])
    x, *_ = np.linalg.lstsq(A, np.concatenate(raw), rcond=None)
    rest = float(np.abs(np.concatenate(raw) - A @ x).max())
    yield _item(
        "weight on wrench_raw turns with the wrist",
        rest <= WEIGHT_REST,
        f"{rest:.1f} N besides a weight of {x[0]:.1f} kg and a bias",
        f"{WEIGHT_REST:g} N",
        "is wrench_raw in the frame that the cell file names (force_sensor.frame), which the description places as on the robot?",
    )
    yield _item(
        "sign of wrench_raw",
        x[0] > -LEAST_MASS,
        f"a tool of {x[0]:.1f} kg",
        "not negative",
        "the sign is turned: what the environment exerts on the robot; a tool that hangs pulls down",
    )


def _sensor_in_tool(cell: Cell) -> Array:
    """Rotation of the sensor's frame into tool0, (3, 3), from the robot description."""
    model = pin.buildModelFromXML(cell.robot.completed_urdf)
    name = cell.raw["force_sensor"]["frame"]
    if not model.existFrame(name):
        return np.eye(3)
    sensor, tool = (model.frames[model.getFrameId(frame)] for frame in (name, "tool0"))
    return np.array(tool.placement.actInv(sensor.placement).rotation)
