# SPDX-License-Identifier: Apache-2.0
"""Recordings of motor encoder, link encoder and motor torque: MATLAB files and tables, by a mapping file (`irec-joints/1`).

```yaml
format: irec-joints/1
step: 0.004                                   # s; or time: {field: rec.time_cont} / time: {column: t, unit: ms}
motor: {field: rec.act_pos_mot_deg, unit: deg}    # in a .mat file: (axes, samples); struct fields with dots
link: {field: rec.act_pos_se_deg, unit: deg}
torque: {field: rec.act_torque_abs_nm, gear: para.u}   # gear: ratios as a list or a field; torque is multiplied by them
# in a table: motor: {columns: [m1, m2, m3], unit: deg} ...; table: {delimiter: ";", decimal: ","}
```
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SessionError
from ..files import read_document, read_text
from ..files.regular import TABLE_LIMIT
from ..session.foreign import UNITS
from ..typing import Array, Json
from .joint_stiffness import Trajectory

FORMAT = "irec-joints/1"


def read_recordings(data: str | Path, profile: str | Path | None = None) -> list[Trajectory]:
    """Read all recordings of a folder, or one file.

    Args:
        data: .mat or .csv file, or a folder of them.
        profile: mapping file; without one a table needs the columns `time`, `motor_k`, `link_k`, `torque_k` (s, rad, N m).

    Raises:
        SessionError: nothing there, or a field is missing; names file and field.
    """
    data = Path(data)
    files = sorted(f for f in data.iterdir() if f.suffix in (".mat", ".csv")) if data.is_dir() else [data]
    if not files or not files[0].exists():
        raise SessionError(f"{data}: no .mat or .csv recording there")
    mapping: Json | None = None
    if profile is not None:
        mapping = read_document(profile, FORMAT, "profile", SessionError).data
    return [_read(f, mapping) for f in files]


def _read(path: Path, mapping: Json | None) -> Trajectory:
    source: _Mat | _Table
    if path.suffix == ".mat":
        if mapping is None:
            raise SessionError(f"{path}: a MATLAB file needs --profile: which field is which channel")
        source = _Mat(path)
    else:
        source = _Table(path, mapping)
        mapping = mapping or source.default()
    channel = {key: source.channel(mapping[key]) for key in ("motor", "link", "torque")}
    shapes = {c.shape for c in channel.values()}
    if len(shapes) != 1:
        raise SessionError(f"{path}: motor, link and torque have different shapes: {', '.join(map(str, shapes))}")
    if "step" in mapping:
        try:
            step = float(mapping["step"])
        except (TypeError, ValueError) as error:
            raise SessionError(f"profile: step is {mapping['step']!r}; the time between samples in s is needed") from error
        if not (np.isfinite(step) and step > 0.0):
            raise SessionError(f"profile: step is {step:g} s; above 0 is needed")
    elif "time" in mapping:
        time = source.channel(mapping["time"])[:, 0]
        step = float(np.median(np.diff(time)))
        worst = float(np.abs(np.diff(time) - step).max()) if len(time) > 1 else 0.0
        if step <= 0.0 or worst > 0.5 * step:
            raise SessionError(f"{path}: samples are not at equal steps (step {step:g} s, largest deviation {worst:g} s)")
    else:
        raise SessionError(f"{path}: neither 'step' nor 'time' is given")
    for name, c in channel.items():
        if not np.isfinite(c).all():
            raise SessionError(f"{path}: {name} holds values that are not finite numbers")
    return Trajectory(path.stem, step, channel["motor"], channel["link"], channel["torque"])


class _Mat:
    def __init__(self, path: Path) -> None:
        from scipy.io import loadmat

        self.path = path
        try:
            self.content = loadmat(str(path), squeeze_me=True, struct_as_record=False)
        except Exception as error:  # scipy raises whatever the bytes make it stumble over
            raise SessionError(f"{path}: not a MATLAB file that can be read: {error}") from error

    def field(self, name: str) -> Array:
        value: Any = self.content
        for part in str(name).split("."):
            value = value.get(part) if isinstance(value, dict) else getattr(value, part, None)
            if value is None:
                raise SessionError(f"{self.path}: there is no field '{name}'")
        return np.asarray(value, dtype=float)

    def channel(self, spec: Json) -> Array:
        if "field" not in spec:
            raise SessionError(f"{self.path}: the profile names no 'field' for a channel of a MATLAB file, only {spec}")
        values = np.atleast_2d(self.field(spec["field"]))
        values = values.T if values.shape[0] < values.shape[1] else values
        return values * _factor(spec, self.field)


class _Table:
    def __init__(self, path: Path, mapping: Json | None) -> None:
        options = (mapping or {}).get("table") or {}
        decimal = str(options.get("decimal", "."))
        self.path = path
        try:
            file = io.StringIO(read_text(path, "table", SessionError, TABLE_LIMIT), newline="")
            rows = [r for r in csv.reader(file, delimiter=str(options.get("delimiter", ","))) if r]
            self.names = [n.strip() for n in rows[0]]
            body = [[float(f.replace(decimal, ".")) for f in r[: len(self.names)]] for r in rows[1:]]
            short = next((i for i, r in enumerate(body, 2) if len(r) < len(self.names)), 0)
            if short:
                raise SessionError(f"{path}:{short}: {len(body[short - 2])} fields, the header has {len(self.names)}")
            if not body:
                raise SessionError(f"{path}: there is no row below the header")
        except (csv.Error, ValueError, IndexError, TypeError) as error:
            raise SessionError(f"{path}: can't read the table: {error}") from error
        self.values = np.array(body)

    def default(self) -> Json:
        k = sum(n.startswith("motor_") for n in self.names)
        if not k:
            raise SessionError(f"{self.path}: no columns motor_1 ..; name the columns in a profile")
        return {"time": {"columns": ["time"]}} | {
            key: {"columns": [f"{key}_{a + 1}" for a in range(k)]} for key in ("motor", "link", "torque")
        }

    def channel(self, spec: Json) -> Array:
        wanted = spec.get("columns", [spec["column"]] if "column" in spec else [])
        missing = [n for n in wanted if n not in self.names]
        if missing or not wanted:
            raise SessionError(
                f"{self.path}: there is no column '{missing[0] if missing else '?'}'; there are {', '.join(self.names)}"
            )
        return self.values[:, [self.names.index(n) for n in wanted]] * _factor(spec, None)


def _factor(spec: Json, field: Any) -> Array:
    unit = str(spec.get("unit", "1"))
    if unit not in UNITS:
        raise SessionError(f"profile: unit '{unit}' is not known; there are {', '.join(UNITS)}")
    gear = spec.get("gear", 1.0)
    ratios = field(gear) if isinstance(gear, str) else np.asarray(gear, dtype=float)
    return UNITS[unit] * float(spec.get("sign", 1)) * ratios
