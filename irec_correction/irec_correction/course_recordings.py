# SPDX-License-Identifier: Apache-2.0
"""Recordings from which a filter is learnt, with the tracker on the tool: courses under the process without correction, and
offsets swept on a standing arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell
from irec_calibration.errors import RecordingError
from irec_calibration.procedure.axes import read_axes
from irec_calibration.recording import BagReader
from irec_calibration.sensors.course_recording import RecordedCourse, read_course
from irec_calibration.sensors.structure import frequency_response
from irec_calibration.typing import Array

from .course_training import DrivenPart, known_along, passed
from .filters import Filter
from .offset_answer import impulse
from .preview import Preview

RATE = 250.0  # Hz
BLOCK = 1000  # samples, over which the answer to an offset is averaged
SHORTEST = 12.0  # s of a swept offset: three axes of 4 s
BEGIN, END = 0.8, 0.4  # s after touch-down and before lift-off that are not learnt from
DIRECTIONS = ("along", "across", "normal")
_LEAST = 5e-6  # m RMS, of a swept offset along each axis


@dataclass(frozen=True)
class Topics:
    """Names of topics: wrench at the TCP in tool0, TCP by the controller, joint states, tracker, offset as it was sent."""

    wrench: str = "wrench"
    pose: str = "tcp_pose"
    joints: str = "joint_states"
    tracker: str = "tracker/point"
    offset: str = "irec/offset"


def read_part(
    file: Path, cell: Cell, topics: Topics, direction: str, stages: Sequence[Filter], dry: Path | None = None,
    preview: Preview | None = None,
) -> DrivenPart:  # fmt: skip
    """A course under the process; its deviation is the marker's from where the controller has it, less that of the dry course.

    Where an offset was sent (recorded on the topic of the offset), the deviation is the marker's from where the dry course had
    it: the controller may count the offset in, or not.

    Args:
        direction: that counts: along the path, across it, or normal to it (tool z). stages: of the wrench before the filter.
        dry: the same course without process; None: what the robot misses its path by is left to a constant and a slope.
        preview: of the course's force profile, without filters, where the correction will have one.

    Raises:
        RecordingError: a topic or a joint is missing, the tool is not in contact for long enough, or an offset was sent and no
            dry course is there.
    """
    course = read_course(file, topics.wrench, topics.pose, topics.joints, RATE)
    offset = _offset(file, topics, course.stamp)
    moved = _missed(file, course, cell, topics)
    if dry is not None:
        other = read_course(dry, topics.wrench, topics.pose, topics.joints, RATE, need_force=False)
        missed = _missed(dry, other, cell, topics)
        moved = moved - _at(course.share, other.share, missed)
        if offset is not None:
            moved = moved + course.p - _at(course.share, other.share, other.p)
    elif offset is not None:
        raise RecordingError(f"{file} was driven with correction; record the same course without process and name it with --dry")
    q = _joints(file, course, cell)
    known = known_along(preview, q, course.force, stages) if preview is not None else None
    for stage in stages:
        stage.reset()
    axis = course.path[:, :, DIRECTIONS.index(direction)]
    return DrivenPart(
        q,
        passed(stages, course.force),
        moved,
        axis,
        _in_contact(file, course.force),
        _rail(course, cell),
        offset,
        known,
    )


def _at(share: Array, other: Array, values: Array) -> Array:
    """values (m, 3) along another course at these shares of the way, (k, 3)."""
    return np.stack([np.interp(share, other, x) for x in values.T], axis=1)


def _offset(file: Path, topics: Topics, stamp: Array) -> Array | None:
    """Offset as it was sent at these stamps, (k, 3), m, in base_link; None where none was recorded, or nothing but zeros."""
    rows, frames = [], set()
    bag = BagReader(file)
    for raw in bag.messages({topics.offset: "", f"/{topics.offset}": ""}):
        m = bag.decode(raw)
        frames.add(m.header.frame_id)
        t = m.transform.translation
        rows.append((m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec, t.x, t.y, t.z))
    if not rows or not np.any(np.array(rows)[:, 1:]):
        return None
    sent_at, sent = _sorted(file, topics.offset, rows)
    if _one(file, topics.offset, frames) != "base_link":
        raise RecordingError(f"{file}: '{topics.offset}' is needed in base_link")
    return _held(stamp, sent_at, sent)


def _held(t: Array, sent_at: Array, sent: Array) -> Array:
    """An offset stands until the next one comes: at times t (k,), (k, 3)."""
    return np.asarray(sent[np.clip(np.searchsorted(sent_at, t + 1e-6, side="right") - 1, 0, len(sent) - 1)])


def _joints(file: Path, course: RecordedCourse, cell: Cell) -> Array:
    wanted = read_axes(cell).driver[: cell.robot.n_joints]
    missing = [n for n in wanted if n not in course.names]
    if missing:
        raise RecordingError(f"{file}: joint states lack {', '.join(missing)}; they name {', '.join(course.names)}")
    return course.q[:, [course.names.index(n) for n in wanted]]


def _rail(course: RecordedCourse, cell: Cell) -> float:
    rail = [n for n in read_axes(cell).driver[cell.robot.n_joints :] if n in course.names]
    return float(np.median(course.q[:, course.names.index(rail[0])])) if rail else 0.0


def _missed(file: Path, course: RecordedCourse, cell: Cell, topics: Topics) -> Array:
    """Marker by the tracker less marker by the controller, in base_link, (k, 3), m."""
    stamps, points, frame = _points(file, topics.tracker)
    if stamps[0] > course.stamp[0] + 0.1 or stamps[-1] < course.stamp[-1] - 0.1:
        raise RecordingError(f"{file}: '{topics.tracker}' does not last as long as the course")
    seen = _in_base(file, np.stack([np.interp(course.stamp, stamps, x) for x in points.T], axis=1), frame, cell)
    where = cell.base_in_cell(np.array([_rail(course, cell)]))[0] if frame != "base_link" else np.zeros(3)
    return np.asarray(seen - where - course.p - course.R_tool @ cell.marker_in_tool)


def _in_base(file: Path, points: Array, frame: str, cell: Cell) -> Array:
    """Points of a station turned into the axes of base_link, which are those of the cell frame."""
    if frame == "base_link":
        return points
    station = next((s for s in cell.stations if s.name == frame), None)
    if station is None:
        known = ", ".join(["base_link", *(s.name for s in cell.stations)])
        raise RecordingError(f"{file}: the tracker reports in frame '{frame}'; the cell file knows {known}")
    return np.asarray(points @ station.R_in_cell.T + station.p_in_cell)


def _points(file: Path, topic: str) -> tuple[Array, Array, str]:
    """Stamps (n,), s, points (n, 3), m, and the frame they are in."""
    rows, frames = [], set()
    bag = BagReader(file)
    for raw in bag.messages({topic: "", f"/{topic}": ""}):
        m = bag.decode(raw)
        frames.add(m.header.frame_id)
        rows.append((m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec, m.point.x, m.point.y, m.point.z))
    return (*_sorted(file, topic, rows), _one(file, topic, frames))


def _sorted(file: Path, topic: str, rows: list[tuple[float, float, float, float]]) -> tuple[Array, Array]:
    if len(rows) < 2:
        raise RecordingError(f"{file}: {len(rows)} messages on '{topic}'; irec inspect shows what is in it")
    table = np.array(sorted(rows))
    table = table[np.r_[True, np.diff(table[:, 0]) > 0.0]]
    if not np.isfinite(table).all():
        raise RecordingError(f"{file}: messages on '{topic}' hold values that are not finite")
    return table[:, 0], table[:, 1:]


def _one(file: Path, topic: str, frames: set[str]) -> str:
    if len(frames) != 1:
        raise RecordingError(f"{file}: messages on '{topic}' are in {len(frames)} frames, {sorted(frames)}; one is needed")
    return frames.pop()


def _in_contact(file: Path, force: Array) -> Array:
    """Samples to learn from, (k,): in contact is above half of what the force is for most of the time."""
    wide = round(0.2 * RATE)
    slow = np.convolve(np.linalg.norm(force, axis=1), np.ones(wide) / wide, "same")
    there = np.flatnonzero(slow > 0.5 * np.quantile(slow, 0.7))
    used = np.zeros(len(force), dtype=bool)
    used[there[0] + round(BEGIN * RATE) : max(there[-1] - round(END * RATE), 0)] = True
    if used.sum() < RATE:
        raise RecordingError(f"{file}: the tool is in contact for {len(there) / RATE:.1f} s; {BEGIN + END + 1.0:g} s are needed")
    return used


def read_sweep(file: Path, cell: Cell, topics: Topics) -> tuple[Array, Array]:
    """Posture (joints,), rad, and the answer of the TCP to an offset (`offset_answer.impulse`), from an arm that stands.

    Raises:
        RecordingError: a topic is missing, too short, an axis is not moved, or the arm does not stand.
    """
    bag, rows, angles, frames = BagReader(file), [], [], set()
    names = read_axes(cell).driver[: cell.robot.n_joints]
    for raw in bag.messages({n: "" for t in (topics.offset, topics.joints) for n in (t, f"/{t}")}):
        m = bag.decode(raw)
        at = m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
        if raw.topic.name.strip("/") == topics.offset.strip("/"):
            frames.add(m.header.frame_id)
            t = m.transform.translation
            rows.append((at, t.x, t.y, t.z))
        else:
            angles.append([m.position[list(m.name).index(n)] for n in names if n in m.name])
    sent_at, sent = _sorted(file, topics.offset, rows)
    if _one(file, topics.offset, frames) != "base_link":
        raise RecordingError(f"{file}: '{topics.offset}' is needed in base_link")
    if len(angles) < 2 or any(len(a) != cell.robot.n_joints for a in angles):
        raise RecordingError(f"{file}: '{topics.joints}' does not name all joints of the robot; irec inspect shows what is in it")
    q = np.array(angles)
    if float(np.ptp(q, axis=0).max()) > 0.05:
        raise RecordingError(f"{file}: joints turn by {np.ptp(q, axis=0).max():.2f} rad; the arm has to stand")
    seen_at, points, frame = _points(file, topics.tracker)
    t = np.arange(max(sent_at[0], seen_at[0]), min(sent_at[-1], seen_at[-1]), 1.0 / RATE)
    if len(t) < SHORTEST * RATE:
        raise RecordingError(f"{file}: offset and tracker overlap for {len(t) / RATE:.1f} s; {SHORTEST:g} s or more are needed")
    moved = _in_base(file, np.stack([np.interp(t, seen_at, x) for x in points.T], axis=1), frame, cell)
    held = _held(t, sent_at, sent)
    if (held.std(axis=0) < _LEAST).any():
        raise RecordingError(
            f"{file}: the offset moves by {1e6 * held.std(axis=0).min():.1f} um RMS along an axis; sweep all three"
        )
    f, _, response = frequency_response(held - held.mean(axis=0), moved - moved.mean(axis=0), RATE, BLOCK)
    return q.mean(axis=0), impulse(f, response, RATE)
