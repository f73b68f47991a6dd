# SPDX-License-Identifier: Apache-2.0
"""The table form of a session: a folder with `session.yaml`, `samples.csv` and the robot description."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml

from ..errors import SessionError
from ..files import all_or_none, write_file
from ..robot import Robot
from ..typing import Array, IntArray
from .columns import XYZ, Columns, in_short
from .copies import check_copies
from .data import Session
from .header import Header, described, read_header
from .stamps import trusted

LIMIT_MARGIN_RAD = 0.01


def read_table(folder: str | Path) -> Session:
    """Read a session from a folder with session.yaml and samples.csv.

    Raises:
        SessionError: what is wrong, with file, line and column.
        RobotError: the URDF can't be used.
    """
    folder = Path(folder)
    header = read_header(folder / "session.yaml")
    robot = described(header.urdf_path, folder / "session.yaml")
    return session_from_columns(header, robot, Columns(folder / "samples.csv"), folder)


def session_from_columns(header: Header, robot: Robot, columns: Columns, folder: Path) -> Session:
    """Build and check a session from its header and columns."""
    loaded = header.kind == "loaded"
    pose = columns.integers("pose", minimum=1)
    load_case = columns.integers("load_case", absent=None if loaded else 0)
    repeat = columns.integers("repeat", absent=0)
    stamp = columns.numbers("stamp", absent=None if loaded or header.clock != "none" else 0.0)
    q = np.stack([columns.numbers(f"joint_{i + 1}") for i in range(robot.n_joints)], axis=1)
    _check_limits(columns, robot, q)
    p_marker = columns.vectors("marker", required=False)
    force = columns.vectors("force", required=loaded, absent=None if loaded else 0.0)
    torque = columns.vectors("torque", required=False, absent=0.0)
    has_tcp = loaded or ("tcp_x" in columns and not all(t == "" for t in columns.text("tcp_x")))
    fk = robot.kinematics(q).p_tcp
    p_tcp = columns.vectors("tcp", required=loaded) if has_tcp else fk
    p_tcp = np.where(np.isnan(p_tcp), fk, p_tcp)
    names = [s.name for s in header.stations]
    station = _index(columns, "station", names)
    marker = _index(columns, "marker", [m.name for m in header.markers])
    ext = {n[4:]: columns.numbers(n, required=False) for n in columns.names if n.startswith("ext_")}
    temperature = {n[5:]: columns.numbers(n, required=False) for n in columns.names if n.startswith("temp_")}
    q_target = None
    if "target_1" in columns:
        q_target = np.stack([columns.numbers(f"target_{i + 1}", required=False) for i in range(robot.n_joints)], axis=1)
    notes = list(header.notes)
    clock, stamp, about_time = trusted(header.clock, stamp, pose, repeat, load_case, loaded)
    notes += about_time
    notes += _unknown_cases(columns, header, load_case)
    unknown = [n for n in columns.names if n not in columns.used]
    if unknown:
        notes.append(f"columns ignored: {', '.join(map(in_short, unknown))}")
    meta = header.meta if clock == header.clock else {**header.meta, "clock": clock}
    session = Session(
        name=header.name, kind=header.kind, robot=robot, serial=header.serial, pose=pose, load_case=load_case,
        repeat=repeat, stamp=stamp, q=q, p_tcp_in_base=p_tcp, p_marker_in_station=p_marker, station=station,
        stations=header.stations, marker=marker, markers=header.markers, force_in_tool=np.nan_to_num(force),
        torque_in_tool=np.nan_to_num(torque), noise=header.noise, q_target=q_target, ext=ext,
        ext_axes=header.ext_axes, temperature=temperature, load_case_names=header.load_case_names,
        load_cases=header.load_cases, gravity_in_base=header.gravity_in_base, payload=header.payload,
        passive=header.passive, clock=clock, inertials=header.inertials, has_torque="torque_x" in columns,
        has_tcp=has_tcp, meta=meta, notes=tuple(notes), path=folder,
    )  # fmt: skip
    check_rows(session, lambda row: f"{columns.path}:{columns.lines[row]}")
    check_copies(session, lambda row: f"{columns.path}:{columns.lines[row]}")
    return session


def _unknown_cases(columns: Columns, header: Header, load_case: IntArray) -> list[str]:
    """Load cases of the rows that session.yaml, which lists load cases, does not list, as notes."""
    listed = {0, *header.load_cases}
    if len(listed) == 1:
        return []
    unknown = [int(c) for c in np.unique(load_case) if int(c) not in listed]
    notes = []
    for case in unknown:
        first = columns.where(int(np.argmax(load_case == case)), "load_case")
        notes.append(
            f"load_case {case} of {int((load_case == case).sum())} row(s), first {first}, is not in load_cases of session.yaml "
            f"({', '.join(str(c) for c in sorted(header.load_cases))})"
        )
    return notes


def check_rows(session: Session, where: object) -> None:
    """Refuse duplicated keys and loaded rows without their reference row.

    Args:
        session: rows to check.
        where: function row index -> place for the message.

    Raises:
        SessionError: names the place.
    """
    place = where if callable(where) else str
    seen: dict[tuple[int, int, int, int], int] = {}
    for i, key in enumerate(
        zip(session.pose.tolist(), session.load_case.tolist(), session.repeat.tolist(), session.marker.tolist(), strict=True)
    ):
        if key in seen:
            raise SessionError(
                f"{place(i)}: pose {key[0]}, load_case {key[1]}, repeat {key[2]} is there already ({place(seen[key])});"
                " if it was measured a second time, count repeat up, else leave the row out"
            )
        seen[key] = i
    if session.kind == "loaded":
        for (pose, case, repeat, marker), i in seen.items():
            if case != 0 and (pose, 0, repeat, marker) not in seen:
                raise SessionError(
                    f"{place(i)}: loaded row (pose {pose}, load_case {case}, repeat {repeat}) without its reference row"
                    f" (load_case 0 of the same pose and repeat)"
                )


def _check_limits(columns: Columns, robot: Robot, q: Array) -> None:
    margin = np.where(robot.is_prismatic, 0.001, LIMIT_MARGIN_RAD)
    outside = (q < robot.lower - margin) | (q > robot.upper + margin)
    for i, k in np.argwhere(outside):
        raise SessionError(
            f"{columns.where(int(i), f'joint_{k + 1}')}: {q[i, k]:.4f} is outside the limits of the robot description"
            f" {robot.lower[k]:.4f} .. {robot.upper[k]:.4f} ({_why_outside(robot, q, int(k))})"
        )


def _why_outside(robot: Robot, q: Array, k: int) -> str:
    """What may have brought joint k outside its limits, in words."""
    if robot.is_prismatic[k]:
        return "mm instead of m?"
    low, high = robot.lower[k] - LIMIT_MARGIN_RAD, robot.upper[k] + LIMIT_MARGIN_RAD
    outside = q[(q[:, k] < low) | (q[:, k] > high), k]
    turned = np.stack([outside - 2.0 * np.pi, outside + 2.0 * np.pi])
    # an angle in degrees is seldom just one turn off, and never in every row
    if len(outside) < len(q) and bool(((turned >= low) & (turned <= high)).any(axis=0).all()):
        return "a turn of 2 pi too many or too few in some rows?"
    return "degrees instead of radians?"


def _index(columns: Columns, name: str, names: list[str]) -> IntArray:
    if name not in columns:
        return np.zeros(len(columns), dtype=np.int64)
    out = np.zeros(len(columns), dtype=np.int64)
    for i, text in enumerate(columns.text(name)):
        if text == "":
            continue
        if text not in names:
            raise SessionError(
                f"{columns.where(i, name)}: '{in_short(text)}' is not declared in session.yaml ({', '.join(names)})"
            )
        out[i] = names.index(text)
    return out


def write_table(session: Session, folder: str | Path) -> Path:
    """Write a session as a table; nothing half-written is left if it fails.

    Args:
        session: any session.
        folder: created if needed; its session.yaml, samples.csv and robot.urdf are replaced.

    Raises:
        SessionError: one of them can't be written.
    """
    folder = Path(folder)
    header = {"format": "irec-session/1", **session.meta}
    header["robot"] = {**header.get("robot", {}), "urdf": "robot.urdf", "serial": session.serial}
    header.update(name=session.name, kind=session.kind)
    names, columns = columns_of(session)
    lines = [",".join(names)] + [",".join(row) for row in zip(*columns, strict=True)]
    with all_or_none():
        write_file(folder / "robot.urdf", session.robot.urdf_text, error=SessionError)
        write_file(folder / "session.yaml", yaml.safe_dump(header, sort_keys=False, allow_unicode=True), error=SessionError)
        write_file(folder / "samples.csv", "\n".join(lines) + "\n", error=SessionError)
    return folder


def columns_of(s: Session) -> tuple[list[str], list[list[str]]]:
    table: dict[str, list[str]] = {}

    def put(name: str, values: Array | IntArray) -> None:
        table[name] = ["" if isinstance(v, float) and math.isnan(v) else repr(v) for v in values.tolist()]

    put("pose", s.pose)
    put("load_case", s.load_case)
    put("repeat", s.repeat)
    put("stamp", s.stamp)
    for i in range(s.robot.n_joints):
        put(f"joint_{i + 1}", s.q[:, i])
    if s.q_target is not None:
        for i in range(s.robot.n_joints):
            put(f"target_{i + 1}", s.q_target[:, i])
    for name, value in s.ext.items():
        put(f"ext_{name}", value)
    blocks = {"marker": s.p_marker_in_station, "force": s.force_in_tool}
    if s.has_tcp:
        blocks = {"tcp": s.p_tcp_in_base, **blocks}
    if s.has_torque:
        blocks["torque"] = s.torque_in_tool
    for prefix, block in blocks.items():
        for a, axis in enumerate(XYZ):
            put(f"{prefix}_{axis}", block[:, a])
    nobody = s.meta.get("without_tracker") is True  # no station measured
    table["station"] = ["" if nobody else s.stations[i].name for i in s.station]
    if len(s.markers) > 1 or "markers" in s.meta:
        table["marker"] = [s.markers[i].name for i in s.marker]
    for name, value in s.temperature.items():
        put(f"temp_{name}", value)
    return list(table), list(table.values())
