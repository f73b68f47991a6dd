# SPDX-License-Identifier: Apache-2.0
"""`session.yaml`: what is known about a session besides its rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ..errors import SessionError
from ..robot import Payload
from ..typing import Json
from .data import ExternalAxis, Marker, Noise, Station

FORMAT = "irec-session/1"
KNOWN = {
    "format", "name", "kind", "robot", "marker_in_tool0", "stations", "noise", "load_cases", "load_case_names", "ext_axes",
    "markers", "gravity", "payload", "joints", "clock", "inertials", "sensor_axis_in_tool",
}  # fmt: skip


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
    meta: Json
    notes: tuple[str, ...]


class _Reader:
    """Typed access to a mapping with errors that name file and key."""

    def __init__(self, data: Any, where: str) -> None:
        if not isinstance(data, dict):
            raise SessionError(f"{where}: a mapping is needed, found {type(data).__name__}")
        self.data, self.where = data, where

    def number(self, key: str, default: float | None = None, minimum: float | None = None) -> float:
        value = self.data.get(key, default)
        if isinstance(value, str):  # YAML 1.1 reads 7.5e-6 as text when it is written without a dot
            try:
                value = float(value)
            except ValueError:
                pass
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise SessionError(f"{self.where}: '{key}' is {value!r}, a number is needed")
        if value != value or value in (float("inf"), float("-inf")) or (minimum is not None and value < minimum):
            raise SessionError(f"{self.where}: '{key}' is {value}, a finite number of at least {minimum} is needed")
        return float(value)

    def vector(self, key: str, length: int, default: Any = None) -> tuple[float, ...]:
        value = self.data.get(key, default)
        if not isinstance(value, (list, tuple)) or len(value) != length:
            raise SessionError(f"{self.where}: '{key}' is {value!r}, a list of {length} numbers is needed")
        items = _Reader(dict(enumerate(value)), f"{self.where}: '{key}'")
        return tuple(items.number(i) for i in range(length))  # type: ignore[arg-type]

    def choice(self, key: str, allowed: tuple[str, ...], default: str) -> str:
        value = self.data.get(key, default)
        if value not in allowed:
            raise SessionError(f"{self.where}: '{key}' is {value!r}, one of {', '.join(allowed)} is needed")
        return str(value)


def read_header(path: Path) -> Header:
    """Read and check session.yaml.

    Raises:
        SessionError: what is wrong, with file and key.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise SessionError(f"{path}: can't read: {error}") from error
    return parse_header(data, str(path), path.parent)


def parse_header(data: Any, where: str, folder: Path) -> Header:
    """Check the content of a session.yaml; paths in it are relative to `folder`."""
    top = _Reader(data, where)
    if str(top.data.get("format", "")).split("/")[:2] != FORMAT.split("/"):
        raise SessionError(f"{where}: format is {top.data.get('format')!r}, this program reads {FORMAT}")
    kind = top.choice("kind", ("loaded", "absolute"), "loaded")
    robot = _Reader(top.data.get("robot"), f"{where}: robot")
    if not isinstance(robot.data.get("urdf"), str):
        raise SessionError(f"{where}: robot: 'urdf' is {robot.data.get('urdf')!r}, a path to the robot description is needed")
    noise = _Reader(top.data.get("noise"), f"{where}: noise")
    payload = None
    if top.data.get("payload") is not None:
        p = _Reader(top.data["payload"], f"{where}: payload")
        payload = Payload(p.number("mass", minimum=0.0), p.vector("com", 3, (0.0, 0.0, 0.0)))  # type: ignore[arg-type]
    unknown = [str(k) for k in top.data if k not in KNOWN]
    return Header(
        name=str(top.data.get("name", folder.name)),
        kind=kind,
        urdf_path=folder / robot.data["urdf"],
        serial=str(robot.data.get("serial", "")),
        stations=_stations(top, kind),
        markers=_markers(top, kind),
        noise=Noise(
            tracker_m=noise.number("tracker_m", minimum=0.0),
            **{
                k: noise.number(k, 0.0, minimum=0.0)
                for k in ("tracker_m_per_m", "force_n", "settling_m", "robot_m", "robot_rad")
            },
        ),
        ext_axes=_ext_axes(top),
        load_cases={int(k): tuple(float(x) for x in v) for k, v in (top.data.get("load_cases") or {}).items()},  # type: ignore[misc]
        load_case_names={int(k): str(v) for k, v in (top.data.get("load_case_names") or {}).items()},
        gravity_in_base=top.vector("gravity", 3, (0.0, 0.0, -9.81)),  # type: ignore[arg-type]
        payload=payload,
        passive={
            str(k): str(v["passive"])
            for k, v in (top.data.get("joints") or {}).items()
            if isinstance(v, dict) and "passive" in v
        },
        clock=top.choice("clock", ("time", "order", "none"), "time"),
        inertials=top.choice("inertials", ("manufacturer", "cad", "guess"), "cad"),
        meta={k: v for k, v in top.data.items()},
        notes=(f"keys of session.yaml ignored: {', '.join(unknown)}",) if unknown else (),
    )


def _stations(top: _Reader, kind: str) -> tuple[Station, ...]:
    given = top.data.get("stations")
    if given is None and kind == "absolute":
        return (Station("station", known=False, stated=False),)
    if not isinstance(given, list) or not given:
        raise SessionError(f"{top.where}: 'stations' must list at least one tracker station with its pose in base_link")
    stations = []
    for i, item in enumerate(given):
        s = _Reader({"name": item} if isinstance(item, str) else item, f"{top.where}: stations[{i}]")
        stated = "xyz" in s.data
        if kind == "loaded" and not stated:
            raise SessionError(f"{s.where}: 'xyz' is missing; a loaded session needs the station's pose in base_link")
        quat = s.vector("quat_xyzw", 4, (0.0, 0.0, 0.0, 1.0))
        if abs(sum(c * c for c in quat) - 1.0) > 1e-3:
            raise SessionError(f"{s.where}: 'quat_xyzw' has length {sum(c * c for c in quat) ** 0.5:.4f}, 1 is needed")
        stations.append(
            Station(
                str(s.data.get("name", f"station_{i}")),
                s.vector("xyz", 3, (0.0, 0.0, 0.0)),  # type: ignore[arg-type]
                quat,  # type: ignore[arg-type]
                known=bool(s.data.get("known", kind == "loaded")),
                stated=stated,
                level=bool(s.data.get("level", False)),
            )
        )
    return tuple(stations)


def _markers(top: _Reader, kind: str) -> tuple[Marker, ...]:
    given = top.data.get("markers")
    if given:
        markers = []
        for i, item in enumerate(given):
            m = _Reader(item, f"{top.where}: markers[{i}]")
            link = m.choice("link", ("tool0", "base_link"), "tool0")
            xyz = m.vector("xyz", 3, (0.0, 0.0, 0.0))
            markers.append(
                Marker(str(m.data.get("name", f"marker_{i}")), link, xyz, bool(m.data.get("known", kind == "loaded")))  # type: ignore[arg-type]
            )
        return tuple(markers)
    single = top.data.get("marker_in_tool0")
    if single is None:
        if kind == "loaded":
            raise SessionError(f"{top.where}: 'marker_in_tool0' is missing (marker position in tool0, m)")
        return (Marker("marker", known=False),)
    if isinstance(single, dict):
        m = _Reader(single, f"{top.where}: marker_in_tool0")
        return (Marker("marker", "tool0", m.vector("xyz", 3), bool(single.get("known", kind == "loaded"))),)  # type: ignore[arg-type]
    return (Marker("marker", "tool0", top.vector("marker_in_tool0", 3), kind == "loaded"),)  # type: ignore[arg-type]


def _ext_axes(top: _Reader) -> tuple[ExternalAxis, ...]:
    axes = []
    for name, item in (top.data.get("ext_axes") or {}).items():
        e = _Reader(item, f"{top.where}: ext_axes: {name}")
        kind = e.choice("kind", ("prismatic", "revolute"), "prismatic")
        axes.append(ExternalAxis(str(name), kind, e.vector("axis", 3)))  # type: ignore[arg-type]
    return tuple(axes)
