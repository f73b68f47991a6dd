# SPDX-License-Identifier: Apache-2.0
"""Level `moves`: in free air. Kinematics on the way, gravity on the raw sensor, marker against TCP, cancel and refusals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..cell import Cell
from ..identification.validation import rms
from ..procedure.axes import Axes
from ..typing import Array
from .observed import Answer, Item, Observation, Stream, at
from .passive import positions
from .weighing import MASS, weight_items

LEVEL = "moves"
ON_THE_WAY = 2e-3  # m between forward kinematics and tcp_pose while moving: 10 ms at 0.2 m/s
ARRIVAL = 5e-4  # m between where a move was to end and where it ended
RIGID = 1e-3  # m, RMS of the marker about a rigid fit to tcp_pose
STATION = np.radians(1.0)  # rad between the station of that fit and of the cell file
WEIGHTLESS = 30.0  # N of wrench in any orientation
OFF_PATH = 2e-3  # m off the line after a cancel
SKEW = 0.02  # s between tracker and tcp_pose
STOPPED = 2.0  # s for a cancelled move to stand
REACTION = 0.5  # s of the speed asked for, that a cancelled move may still go; half of the line is more
LEFT_OVER = 5e-3  # m before its end that it has to have stopped
FURTHER, BEFORE_END = "a cancelled move goes no further", "a cancelled move stops before its end"
BEFORE_PRESSING = (FURTHER, BEFORE_END, MASS)  # with less than this, what presses is dangerous


@dataclass(frozen=True)
class Moves:
    """What was done and seen.

    Attributes:
        standing: observations at standing poses of different orientation, at least three. way: one straight move at speed.
        line: begin and end of it, (2, 3), m in base_link. arrived: (asked, reached) positions of moves that succeeded, m.
        answers: of those moves. cancelled: answer to a cancelled one, and where it stood then, (3,), m.
        at_cancel: where it was when that was asked for, (3,), m. speed: that was asked for, m/s.
        refused: what should be refused -> answer; moved: way of the TCP meanwhile, m.
    """

    standing: list[Observation]
    way: Observation
    line: Array
    arrived: list[tuple[Array, Array]]
    answers: list[Answer]
    cancelled: Answer
    p_cancelled: Array
    at_cancel: Array
    speed: float
    refused: dict[str, Answer]
    moved: float


def judge_moves(m: Moves, cell: Cell, axes: Axes) -> list[Item]:
    """All items of the level."""
    marker = () if cell.without_tracker else _marker(m, cell, axes)
    return [*_answers(m), *_on_the_way(m, cell, axes), *marker, *_weight(m, cell)]


def _item(name: str, passed: bool | None, figure: str, limit: str, advice: str) -> Item:
    """passed: None where it could not be checked."""
    return Item(LEVEL, name, bool(passed), figure, limit, advice, passed is not None)


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
    yield from _stopped(m, off @ along, float(np.linalg.norm(b - a)))
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


def _stopped(m: Moves, at: float, length: float) -> Iterator[Item]:
    """What it claims about a cancel is not enough. at: how far along the line, of this length, the robot stands, m."""
    further, limit = float(np.linalg.norm(m.p_cancelled - m.at_cancel)), REACTION * m.speed
    yield _item(
        FURTHER,
        further <= limit,
        f"{1e3 * further:.1f} mm after the cancel at {1e3 * m.speed:g} mm/s",
        f"{1e3 * limit:.1f} mm, {REACTION:g} s of the speed",
        "stop at once: a touch of the tooling is answered by a cancel, and each millimetre then is hundreds of newtons and more",
    )
    yield _item(
        BEFORE_END,
        length - at >= LEFT_OVER,
        f"{1e3 * (length - at):.1f} mm before the end of a line of {1e3 * length:.0f} mm that was cancelled on its way",
        f"at least {1e3 * LEFT_OVER:g} mm",
        "is the cancel carried out, or ignored and the move driven to its end? is it driven faster than asked?",
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
        figure = f"{len(raw)} standing places with wrench, wrench_raw and tcp_pose, at least 4 are needed"
        yield _item(MASS, None, figure, "", "publish all three while the robot stands, and check again")
        return
    yield _item(
        "wrench in every orientation",
        max(free) <= WEIGHTLESS,
        f"{max(free):.1f} N",
        f"{WEIGHTLESS:g} N",
        "remove the tool's weight from wrench",
    )
    for item in weight_items(np.array(R), np.array(raw), cell):
        yield _item(*item)
