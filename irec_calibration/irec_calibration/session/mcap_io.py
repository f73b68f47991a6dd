# SPDX-License-Identifier: Apache-2.0
"""The MCAP form of a session: LoadCaseRecord messages, with `session.yaml` and `robot.urdf` attached.

Both forms have the same columns, so that everything that is checked in a table is checked here by the same code.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from .. import __version__
from ..errors import RecordingError, SessionError
from ..files import not_written, one_line
from ..recording import BagReader, BagWriter
from ..robot import Robot
from . import record_message
from .columns import XYZ, Columns
from .data import Session
from .header import FORMAT, parse_header_text
from .table import columns_of, session_from_columns


class _MessageColumns(Columns):
    """Columns built from messages; places are named by message."""

    def __init__(self, path: Path, rows: list[dict[str, str]]) -> None:
        self.path = path
        self.names = list(dict.fromkeys(name for row in rows for name in row))
        self.lines = list(range(1, len(rows) + 1))
        self._text = {name: [row.get(name, "") for row in rows] for name in self.names}
        self.used: set[str] = set()

    def where(self, row: int, name: str) -> str:
        return f"{self.path}: message {self.lines[row]} of {record_message.TOPIC}: {name}"


def read_mcap(path: str | Path) -> Session:
    """Read a session from an MCAP file or a rosbag2 folder, whole or truncated.

    What is lost of a damaged recording is named in the session's `notes`. A pose that was begun again counts from its last
    beginning.

    Raises:
        SessionError: no session in it; names what is missing.
        RecordingError: not MCAP at all.
    """
    path = Path(path)
    bag = BagReader(path)
    rows: list[dict[str, str]] = []
    notes: list[str] = []
    discarded: set[str] = set()
    unverified: set[str] = set()
    for message in bag.messages({record_message.TOPIC, record_message.EVENT_TOPIC}):
        if message.topic.name == record_message.EVENT_TOPIC:
            rows = _without_discarded(rows, message, bag, discarded)
            unverified |= _unverified(message, bag)
            continue
        if message.topic.type_name != record_message.TYPE:
            found = message.topic.type_name or "of no type"
            raise SessionError(f"{path}: {record_message.TOPIC} is {found}, {record_message.TYPE} is needed")
        where = f"{path}: message {len(rows) + 1} of {record_message.TOPIC}"
        try:
            rows.append(_row_of(bag.decode(message), where))
        except (AttributeError, TypeError) as error:  # a type of that name with other fields
            raise SessionError(one_line(f"{where}: is no {record_message.TYPE} as this program knows it: {error}")) from error
    notes += [f"lost: {loss}" for loss in bag.losses]
    notes += sorted(unverified)
    notes += [f"left out, the run says that it does not count: {text}" for text in sorted(discarded)]
    missing = [name for name in ("session.yaml", "robot.urdf") if name not in bag.attachments]
    if missing:
        raise SessionError(
            f"{path}: {missing[0]} is not attached{_after(bag)}; this is no session recording"
            f" (topics: {', '.join(sorted(bag.topics)) or 'none'}); try `irec inspect`"
        )
    header = parse_header_text(_attached(path, bag, "session.yaml"), f"{path}: session.yaml", path.parent)
    if header.kind == "loaded":
        rows = _last_attempts(rows, notes)
    if not rows:
        raise SessionError(f"{path}: no message on {record_message.TOPIC}{_after(bag)}: nothing was recorded")
    robot = Robot(_attached(path, bag, "robot.urdf"), f"{path}: robot.urdf")
    _name_joints(rows, header.joint_names or robot.joint_names)
    session = session_from_columns(header, robot, _MessageColumns(path, rows), path)
    return replace(session, notes=(*notes, *session.notes), is_whole=not bag.losses)


def _without_discarded(rows: list[dict[str, str]], message: Any, bag: BagReader, told: set[str]) -> list[dict[str, str]]:
    """Rows without those of a pose and repeat that an event says do not count; `told` takes its text."""
    try:
        event = json.loads(bag.decode(message).data)
        if event["kind"] != "discarded":
            return rows
        key = str(int(event["pose"])), str(int(event["repeat"]))
    except (AttributeError, ValueError, KeyError, TypeError, OverflowError, RecursionError):  # of somebody else
        return rows
    told.add(f"pose {key[0]}: {event.get('text', '')}")
    return [row for row in rows if (row["pose"], row["repeat"]) != key]


def _unverified(message: Any, bag: BagReader) -> set[str]:
    """What an event says of the scale of the force that a run could not verify, or nothing."""
    try:
        event = json.loads(bag.decode(message).data)
        return {str(event["text"])} if event["kind"] == "unverified" else set()
    except (AttributeError, ValueError, KeyError, TypeError, RecursionError):  # of somebody else
        return set()


def _after(bag: BagReader) -> str:
    return f" ({'; '.join(bag.losses)})" if bag.losses else ""


def _attached(path: Path, bag: BagReader, name: str) -> str:
    try:
        return bag.attachments[name].decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SessionError(f"{path}: the attached {name} is no UTF-8 text (byte {error.start})") from None


def _last_attempts(rows: list[dict[str, str]], notes: list[str]) -> list[dict[str, str]]:
    """Rows of the last beginning of each pose and repeat; loaded rows whose reference was lost are left out."""
    kept: dict[tuple[str, str], list[dict[str, str]]] = {}
    again, orphans = set(), 0
    for row in rows:
        key = (row["pose"], row["repeat"])
        if row["load_case"] == "0":
            if key in kept:
                again.add(int(row["pose"]))
            kept.pop(key, None)
            kept[key] = [row]
        elif key in kept:
            kept[key].append(row)
        else:
            orphans += 1
    if again:
        notes.append(f"poses begun again, the last attempt counts: {', '.join(map(str, sorted(again)))}")
    if orphans:
        notes.append(f"{orphans} loaded rows left out: their reference row is lost")
    return [row for attempt in kept.values() for row in attempt]


def _row_of(m: Any, where: str) -> dict[str, str]:
    """The columns of one message; NaN is an empty field."""
    row = {"pose": str(m.pose), "load_case": str(m.load_case), "repeat": str(m.repeat), "stamp": _text(m.time)}
    for names, values in ((m.joint_names, m.joint_position), (m.temperature_names, m.temperature)):
        if len(names) != len(values):
            raise SessionError(f"{where}: {len(names)} names and {len(values)} values: {', '.join(names)[:200]}")
    row |= {name: _text(value) for name, value in zip(m.joint_names, m.joint_position, strict=True)}
    row |= {f"target_{i + 1}": _text(value) for i, value in enumerate(m.joint_target)}
    for prefix, vector in (
        ("tcp", m.p_tcp_in_base), ("marker", m.p_marker_in_station), ("force", m.wrench_in_tool.force),
        ("torque", m.wrench_in_tool.torque),
    ):  # fmt: skip
        row |= {f"{prefix}_{a}": _text(getattr(vector, a)) for a in XYZ}
    if all(row[f"torque_{a}"] == "" for a in XYZ):
        for a in XYZ:
            del row[f"torque_{a}"]
    row["station"] = m.station
    if m.marker:
        row["marker"] = m.marker
    row |= {name: _text(value) for name, value in zip(m.temperature_names, m.temperature, strict=True)}
    return row


def _name_joints(rows: list[dict[str, str]], names: tuple[str, ...]) -> None:
    """Columns joint_1 .. joint_n for joints that the messages call by the names of the robot description, in its order."""
    wanted = {name: f"joint_{k + 1}" for k, name in enumerate(names)}
    if all(name == column for name, column in wanted.items()):
        return
    for i, row in enumerate(rows):
        if all(name in row for name in wanted):
            rows[i] = {wanted.get(name, name): value for name, value in row.items()}


def _text(value: float) -> str:
    return "" if math.isnan(value) else repr(float(value))


def write_mcap(session: Session, path: str | Path) -> Path:
    """Write a session as MCAP; nothing half-written is left if it fails.

    Raises:
        RecordingError: the file can't be written.
    """
    path = Path(path)
    part = path.with_name(path.name + ".part")
    header: dict[str, Any] = {**session.meta, "format": FORMAT, "name": session.name, "kind": session.kind}
    header["robot"] = {**header.get("robot", {}), "urdf": "robot.urdf", "serial": session.serial}
    names, columns = columns_of(session)
    try:
        part.unlink(missing_ok=True)
        with BagWriter(part, record_message.Catalogue()) as bag:
            attach_session(bag, header, session.robot.urdf_text)
            channel = bag.add_topic(record_message.TOPIC, record_message.TYPE)
            for i in range(len(session)):
                row = {name: column[i] for name, column in zip(names, columns, strict=True)}
                ns = round(float(row["stamp"]) * 1e9)
                bag.write(channel, _message_of(row, session.robot.n_joints, ns), max(ns, 0))
        os.replace(part, path)
    except (OSError, RecordingError) as error:  # of which the latter names the file that was to become this one
        reason = error if isinstance(error, OSError) else error.__cause__ or error
        raise RecordingError(not_written(path, reason)) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
    return path


def attach_session(bag: BagWriter, header: dict[str, Any], urdf_text: str, files: dict[str, str] | None = None) -> None:
    """Put what belongs to a session beside its messages: session.yaml, robot.urdf, versions, and other files by name."""
    text = yaml.safe_dump(header, sort_keys=False, allow_unicode=True)
    bag.attach("session.yaml", text.encode(), "application/yaml")
    bag.attach("robot.urdf", urdf_text.encode(), "application/xml")
    for name, content in (files or {}).items():
        bag.attach(name, content.encode())
    bag.add_metadata("irec", {"version": __version__, "format": FORMAT})


def _message_of(row: dict[str, str], n_joints: int, stamp_ns: int) -> bytes:
    joints = [f"joint_{i + 1}" for i in range(n_joints)] + [name for name in row if name.startswith("ext_")]
    targets = [f"target_{i + 1}" for i in range(n_joints)] if "target_1" in row else []
    temperatures = [name for name in row if name.startswith("temp_")]

    def numbers(*names: str) -> list[float]:
        return [float(row[n]) if row.get(n, "") else math.nan for n in names]

    def vector(prefix: str) -> list[float]:
        return numbers(*(f"{prefix}_{a}" for a in XYZ))

    return record_message.encode(
        stamp_ns=max(stamp_ns, 0), time=float(row["stamp"]), pose=int(row["pose"]), load_case=int(row["load_case"]),
        repeat=int(row["repeat"]), joint_names=joints, joint_position=numbers(*joints), joint_target=numbers(*targets),
        p_tcp_in_base=vector("tcp"), p_marker_in_station=vector("marker"), marker=row.get("marker", ""),
        station=row["station"], wrench_in_tool=[*vector("force"), *vector("torque")],
        temperature_names=temperatures, temperature=numbers(*temperatures),
    )  # fmt: skip
