# SPDX-License-Identifier: Apache-2.0
"""`session.yaml`: what is known about a session besides its rows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import RobotError, SessionError
from ..files.document import Document, check_data, check_text, read_document
from ..files.schema import schema_of
from ..robot import Payload, Robot
from ..typing import Json
from .data import ExternalAxis, Marker, Noise, Station

FORMAT = "irec-session/1"
WHAT = "session header"
KNOWN = frozenset(schema_of(FORMAT)["properties"])


@dataclass(frozen=True)
class Header:
    """Checked content of session.yaml; units and frames as in `Session`."""

    name: str
    kind: str
    urdf_path: Path
    serial: str
    stations: tuple[Station, ...]
    markers: tuple[Marker, ...]
    noise: Noise
    ext_axes: tuple[ExternalAxis, ...]
    load_cases: dict[int, tuple[float, float, float]]
    load_case_names: dict[int, str]
    gravity_in_base: tuple[float, float, float]
    payload: Payload | None
    passive: dict[str, str]
    clock: str
    inertials: str
    joint_names: tuple[str, ...]
    meta: Json
    notes: tuple[str, ...]


def read_header(path: Path) -> Header:
    """Read and check session.yaml.

    Raises:
        SessionError: what is wrong, with file, line and key.
    """
    return _header(read_document(path, FORMAT, WHAT, SessionError, rules=RULES), path.parent)


def parse_header(data: Any, where: str, folder: Path) -> Header:
    """Check the content of a session.yaml that was read already or stands in a profile; its paths are relative to `folder`."""
    document = check_data(data, where, FORMAT, WHAT, SessionError, rules=RULES)
    document.finish(SessionError)
    return _header(document, folder)


def parse_header_text(text: str, where: str, folder: Path) -> Header:
    """The same for the text of a session.yaml that is attached to a recording."""
    document = check_text(text, where, FORMAT, WHAT, SessionError, rules=RULES)
    document.finish(SessionError)
    return _header(document, folder)


def described(urdf: Path, by: Path) -> Robot:
    """The robot that a file names as its `robot.urdf`. Raises RobotError: it can't be used; names both files."""
    try:
        return Robot.from_urdf(urdf)
    except RobotError as error:
        raise RobotError(f"{by}: robot.urdf: {error}") from error


def _header(document: Document, folder: Path) -> Header:
    data: Json = document.data
    kind = data.get("kind", "loaded")
    noise = data["noise"]
    payload = data.get("payload")
    unknown = [str(k) for k in data if k not in KNOWN]
    notes = [f"keys of session.yaml ignored: {', '.join(unknown)}"] if unknown else []
    if data.get("without_tracker", False):
        notes.append("recorded without a tracker: the marker columns are empty")
    return Header(
        name=str(data.get("name", folder.name)),
        kind=kind,
        urdf_path=folder / data["robot"]["urdf"],
        serial=str(data["robot"].get("serial", "")),
        stations=_stations(data, kind),
        markers=_markers(data, kind),
        noise=Noise(
            tracker_m=float(noise["tracker_m"]),
            **{k: float(noise.get(k, 0.0)) for k in ("tracker_m_per_m", "force_n", "settling_m", "robot_m", "robot_rad")},
        ),
        ext_axes=tuple(
            ExternalAxis(str(name), item.get("kind", "prismatic"), _vector(item["axis"]))  # type: ignore[arg-type]
            for name, item in (data.get("ext_axes") or {}).items()
        ),
        load_cases={int(k): _vector(v) for k, v in (data.get("load_cases") or {}).items()},  # type: ignore[misc]
        load_case_names={int(k): str(v) for k, v in (data.get("load_case_names") or {}).items()},
        gravity_in_base=_vector(data.get("gravity", (0.0, 0.0, -9.81))),  # type: ignore[arg-type]
        payload=Payload(float(payload["mass"]), _vector(payload.get("com", (0, 0, 0)))) if payload else None,  # type: ignore[arg-type]
        passive={str(k): v["passive"] for k, v in (data.get("joints") or {}).items() if "passive" in v},
        clock=data.get("clock", "time"),
        inertials=data.get("inertials", "cad"),
        joint_names=tuple(data["robot"].get("joint_names", ())),
        meta=dict(data),
        notes=tuple(notes),
    )


def _vector(values: Any) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _stations(data: Json, kind: str) -> tuple[Station, ...]:
    given = data.get("stations")
    if given is None:
        return (Station("station", known=False, stated=False),)
    stations = []
    for i, item in enumerate(given):
        s: Json = {"name": item} if isinstance(item, str) else item
        stations.append(
            Station(
                s.get("name", f"station_{i}"),
                _vector(s.get("xyz", (0, 0, 0))),  # type: ignore[arg-type]
                _vector(s.get("quat_xyzw", (0, 0, 0, 1))),  # type: ignore[arg-type]
                known=s.get("known", kind == "loaded"),
                stated="xyz" in s,
                level=s.get("level", False),
            )
        )
    return tuple(stations)


def _markers(data: Json, kind: str) -> tuple[Marker, ...]:
    if data.get("markers"):
        return tuple(
            Marker(
                m.get("name", f"marker_{i}"),
                m.get("link", "tool0"),
                _vector(m.get("xyz", (0, 0, 0))),  # type: ignore[arg-type]
                m.get("known", kind == "loaded"),
            )
            for i, m in enumerate(data["markers"])
        )
    single = data.get("marker_in_tool0")
    if single is None:
        return (Marker("marker", known=False),)
    if isinstance(single, dict):
        return (Marker("marker", "tool0", _vector(single["xyz"]), single.get("known", kind == "loaded")),)  # type: ignore[arg-type]
    return (Marker("marker", "tool0", _vector(single), kind == "loaded"),)  # type: ignore[arg-type]


def _needed_when_loaded(document: Document) -> None:
    data = document.data
    if data.get("kind", "loaded") != "loaded":
        return
    if "stations" not in data:
        document.wrong(("stations",), "is missing: a loaded session needs each tracker station with its pose in base_link")
    if "markers" not in data and "marker_in_tool0" not in data:
        document.wrong(("marker_in_tool0",), "is missing: marker position in tool0, m")
    for i, station in enumerate(data["stations"] if document.sound("stations") else ()):
        if isinstance(station, str) or "xyz" not in station:
            document.wrong(("stations", i, "xyz"), "is missing; a loaded session needs the station's pose in base_link")


def _stations_and_markers(document: Document) -> None:
    for key in ("stations", "markers"):
        seen: set[str] = set()
        for i, item in enumerate(document.data[key] if document.sound(key) else ()):
            name = item if isinstance(item, str) else item.get("name", f"{key}_{i}")
            if name in seen:
                document.wrong((key, i, "name"), f"is {name!r} again; each has a name of its own")
            seen.add(name)
            quaternion = item.get("quat_xyzw") if isinstance(item, dict) else None
            if quaternion is not None:
                length = math.sqrt(sum(c * c for c in quaternion))
                if abs(length - 1.0) > 1e-3:
                    document.wrong((key, i, "quat_xyzw"), f"has length {length:.4f}, must have length 1 (x, y, z, w)")


def _directions(document: Document) -> None:
    for name in document.data["ext_axes"] if document.sound("ext_axes") else ():
        if not any(document.data["ext_axes"][name]["axis"]):
            document.wrong(("ext_axes", str(name), "axis"), "is 0, a direction is needed")


RULES = (_needed_when_loaded, _stations_and_markers, _directions)
