# SPDX-License-Identifier: Apache-2.0
"""Several sessions of one robot as one: poses that were measured later, to tell what the first ones left open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any, TypeVar

import numpy as np

from ..errors import SessionError
from ..typing import Array, IntArray, Json
from .data import Marker, Noise, Session, Station

Named = TypeVar("Named", Station, Marker)
GAP_S = 600.0  # between the end of one session and the begin of the next, where nobody says
ROUND = 100  # poses of each further session are counted from a multiple of this
SAME_N = 0.5  # by which nominal forces of one load case may differ, N


def joined(sessions: Sequence[Session], name: str = "", gap: float = GAP_S) -> Session:
    """One session with the rows of all, in their order.

    Poses of the second session and of those after it are counted on from the next hundred, their stamps from `gap` after the end
    of the one before. A station or marker is the same one where name and stated values are, a load case where its nominal force
    is; where only the name is, it gets a name of its own (`A (2)`). In an absolute session a station whose pose is unknown is
    another one each time. Noise that is stated differently becomes its root mean square over rows.

    Args:
        sessions: two or more, of one kind and robot.
        name: of the result; the names of all where empty.
        gap: s.

    Raises:
        SessionError: fewer than two, one of them twice, or something that they can't share, with both values.
    """
    if len(sessions) < 2:
        raise SessionError(f"{len(sessions)} session(s) given: at least two are needed to join")
    if not np.isfinite(gap) or gap < 0.0:
        raise SessionError(f"gap is {gap:g} s between sessions: 0 or more is needed")
    first = sessions[0]
    for n, other in enumerate(sessions[1:], start=1):
        _check_shared(first, other)
        for before in sessions[:n]:
            if len(before) == len(other) and np.array_equal(before.q, other.q) and np.array_equal(before.stamp, other.stamp):
                raise SessionError(f"{_of(other)}: has the same rows as {_of(before)}; its noise would count twice as small")
    stations, station = _pooled([s.stations for s in sessions], lambda s: s.known)  # an unknown pose may be a new one
    markers, marker = _pooled([s.markers for s in sessions], lambda _: True)
    cases, case_names, case = _load_cases(sessions)
    pose, stamp = _counted_on(sessions, gap)
    noise, notes = _noise(sessions)
    meta = _meta(first, stations, markers, cases, case_names, noise)
    clock = next((c for c in ("none", "order") if any(s.clock == c for s in sessions)), "time")
    meta["clock"] = clock
    return replace(
        first,
        name=name or " + ".join(s.name for s in sessions),
        pose=pose, stamp=stamp,
        load_case=np.concatenate([m[s.load_case] for s, m in zip(sessions, case, strict=True)]),
        repeat=_rows(sessions, "repeat"), q=_rows(sessions, "q"),
        p_tcp_in_base=_rows(sessions, "p_tcp_in_base"), p_marker_in_station=_rows(sessions, "p_marker_in_station"),
        station=np.concatenate([m[s.station] for s, m in zip(sessions, station, strict=True)]), stations=stations,
        marker=np.concatenate([m[s.marker] for s, m in zip(sessions, marker, strict=True)]), markers=markers,
        force_in_tool=_rows(sessions, "force_in_tool"), torque_in_tool=_rows(sessions, "torque_in_tool"),
        q_target=_targets(sessions),
        ext={n: np.concatenate([s.ext[n] for s in sessions]) for n in first.ext},
        temperature=_temperatures(sessions), load_cases=cases, load_case_names=case_names, noise=noise, clock=clock,
        has_torque=any(s.has_torque for s in sessions), has_tcp=all(s.has_tcp for s in sessions),
        is_whole=all(s.is_whole for s in sessions), meta=meta,
        notes=(*(n for s in sessions for n in s.notes), *notes), path=None,
    )  # fmt: skip


def _of(session: Session) -> str:
    return str(session.path or session.name)


def _check_shared(first: Session, other: Session) -> None:
    """Refuse what one session can't hold."""
    same = (
        ("kind", first.kind, other.kind),
        ("serial of the robot", first.serial, other.serial),
        ("robot description (SHA-256)", first.robot.sha256[:12], other.robot.sha256[:12]),
        ("gravity", tuple(first.gravity_in_base), tuple(other.gravity_in_base)),
        ("payload", _payload(first), _payload(other)),
        ("coupled joints", first.passive, other.passive),
        ("external axes", sorted(first.ext), sorted(other.ext)),
        ("inertials", first.inertials, other.inertials),
        (
            "mounting axis of the force sensor",
            *(tuple(s.meta.get("sensor_axis_in_tool", (0.0, 0.0, 1.0))) for s in (first, other)),
        ),
        ("a tracker", *(s.meta.get("without_tracker") is not True for s in (first, other))),
    )
    for what, one, two in same:
        if one != two:
            raise SessionError(f"{_of(other)}: {what} is {two}, of {_of(first)} {one}; sessions that are joined share it")


def _payload(session: Session) -> tuple[float, ...] | None:
    p = session.payload
    return None if p is None else (float(p.mass), *(float(x) for x in p.com))


def _rows(sessions: Sequence[Session], what: str) -> Any:
    return np.concatenate([getattr(s, what) for s in sessions])


def _targets(sessions: Sequence[Session]) -> Array | None:
    """Commanded joint angles; NaN in the rows of a session that has none."""
    if all(s.q_target is None for s in sessions):
        return None
    return np.concatenate([np.full_like(s.q, np.nan) if s.q_target is None else s.q_target for s in sessions])


def _temperatures(sessions: Sequence[Session]) -> dict[str, Array]:
    """All columns; NaN in the rows of a session that lacks one."""
    names = dict.fromkeys(n for s in sessions for n in s.temperature)
    return {n: np.concatenate([s.temperature.get(n, np.full(len(s), np.nan)) for s in sessions]) for n in names}


def _counted_on(sessions: Sequence[Session], gap: float) -> tuple[IntArray, Array]:
    """Poses and stamps of all rows."""
    pose, stamp = [sessions[0].pose], [sessions[0].stamp]
    for s in sessions[1:]:
        pose.append(s.pose + ROUND * (int(pose[-1].max()) // ROUND + 1))
        stamp.append(s.stamp - s.stamp.min() + stamp[-1].max() + gap)
    return np.concatenate(pose), np.concatenate(stamp)


def _pooled(every: Sequence[Sequence[Named]], lasts: Callable[[Named], bool]) -> tuple[tuple[Named, ...], list[IntArray]]:
    """All stations or markers, and of each session which of them its own are.

    Args:
        every: those of each session. lasts: whether one that is stated alike in a later session is the same one.
    """
    found: list[Named] = []
    index = []
    for n, own in enumerate(every, start=1):
        mine = []
        for one in own:
            if one not in found or not lasts(one):
                found.append(replace(one, name=_new_name(one.name, n, [f.name for f in found])))
                mine.append(len(found) - 1)
            else:
                mine.append(found.index(one))
        index.append(np.array(mine, dtype=np.int64))
    return tuple(found), index


def _new_name(name: str, session: int, taken: Sequence[str]) -> str:
    while name in taken:
        name = f"{name} ({session})"
    return name


def _load_cases(
    sessions: Sequence[Session],
) -> tuple[dict[int, tuple[float, float, float]], dict[int, str], list[IntArray]]:
    """Nominal forces and names of all load cases, and of each session the new number of each of its own, by the old one."""
    forces: dict[int, tuple[float, float, float]] = dict(sessions[0].load_cases)
    names: dict[int, str] = dict(sessions[0].load_case_names)
    highest = max(j for s in sessions for j in (int(s.load_case.max()), *s.load_cases))
    tables = [np.arange(int(sessions[0].load_case.max()) + 1)]
    for n, s in enumerate(sessions[1:], start=2):
        table = np.arange(int(s.load_case.max()) + 1)
        taken: set[int] = set()
        for j in np.unique(s.load_case[s.load_case > 0]).tolist():
            mine = s.load_cases.get(j)
            known = [i for i in (j, *forces) if i not in taken and _alike(forces.get(i), mine)]
            if known:
                table[j] = known[0]
                taken.add(known[0])
                continue
            highest += 1
            table[j] = highest
            names[highest] = _new_name(s.case_name(j), n, list(names.values()))
            if j in s.load_cases:
                forces[highest] = s.load_cases[j]
        tables.append(table)
    return forces, names, tables


def _alike(one: tuple[float, ...] | None, other: tuple[float, ...] | None) -> bool:
    """Whether nominal forces are the same, or neither is stated."""
    if one is None or other is None:
        return one is other
    return float(np.abs(np.subtract(one, other)).max()) <= SAME_N


def _noise(sessions: Sequence[Session]) -> tuple[Noise, list[str]]:
    """Root mean square over rows of what is stated, and a note where that differs."""
    stated = [asdict(s.noise) for s in sessions]
    weight = [len(s) for s in sessions]
    value = {k: float(np.sqrt(np.average([one[k] ** 2 for one in stated], weights=weight))) for k in stated[0]}
    differ = [k for k in value if len({one[k] for one in stated}) > 1]
    notes = [
        f"the sessions state another {k}: {', '.join(f'{one[k]:.3g}' for one in stated)}; taken as {value[k]:.3g}" for k in differ
    ]
    return (Noise(**value) if differ else sessions[0].noise), notes


def _meta(
    first: Session, stations: Sequence[Station], markers: Sequence[Marker], cases: dict[int, tuple[float, float, float]],
    case_names: dict[int, str], noise: Noise,
) -> Json:  # fmt: skip
    """The header of all."""
    meta = dict(first.meta)
    if len(stations) > len(first.stations):
        meta["stations"] = [_station(s) for s in stations]
    if len(markers) > len(first.markers):
        meta.pop("marker_in_tool0", None)
        meta["markers"] = [{"name": m.name, "link": m.link, "xyz": list(m.xyz), "known": m.known} for m in markers]
    if cases:
        meta["load_cases"] = {j: list(f) for j, f in cases.items()}
    if case_names:
        meta["load_case_names"] = dict(case_names)
    meta["noise"] = {**meta.get("noise", {}), **{k: v for k, v in asdict(noise).items() if v}}
    return meta


def _station(s: Station) -> Json:
    pose = {"xyz": list(s.xyz), "quat_xyzw": list(s.quat_xyzw)} if s.stated else {}
    return {"name": s.name, **pose, "known": s.known, "level": s.level}
