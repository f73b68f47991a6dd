# SPDX-License-Identifier: Apache-2.0
"""Foreign tables to sessions by a mapping file (`irec-import/1`), instead of one program per source.

```yaml
format: irec-import/1
table: {delimiter: ";", decimal: ",", encoding: utf-8, skip_lines: 0}    # all optional; `names: [...]` where there is no
    header line
session: {name: ..., kind: absolute, robot: {urdf: ur10.urdf}, noise: {...}, ...}   # session.yaml; paths relative to this file
columns:                                       # column of the session -> where it comes from
  joint_1: {column: "shoulder_pan_joint", unit: rad}
  joint_2: {column: q2, unit: deg, sign: -1, offset: 90}     # sign * value + offset, then the unit
  marker_x: {column: x_t, minus: x_dif, unit: mm}            # `plus` / `minus`: further columns
  stamp: {column: Timestamp, time: "%Y%m%d%H%M%S"}           # or a number with `unit: ms`
  station: {constant: A}
missing: {text: ["NaN"], marker: [0, 0, 0]}    # what stands for "not measured"
order_by: stamp                                # sort rows; poses are counted in that order unless `pose` is mapped
drop_incomplete: true                          # leave rows without joints out instead of refusing them
```
"""

from __future__ import annotations

import csv
import datetime
import io
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from ..errors import SessionError
from ..files import all_or_none, read_document, write_file
from ..files.regular import TABLE_LIMIT, URDF_LIMIT, is_there, read_bytes
from ..typing import Json
from .columns import SEP_LINE, in_short
from .data import Session
from .header import FORMAT as SESSION_FORMAT
from .table import read_table

FORMAT = "irec-import/1"
UNITS = {
    "m": 1.0, "mm": 1e-3, "um": 1e-6, "cm": 1e-2, "in": 0.0254, "rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "s": 1.0,
    "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "N": 1.0, "kN": 1e3, "Nm": 1.0, "kNm": 1e3, "Nmm": 1e-3,
    "degC": 1.0, "1": 1.0,
}  # fmt: skip
KEYS = {"format", "table", "session", "columns", "missing", "order_by", "drop_incomplete"}
COLUMN_KEYS = {"column", "plus", "minus", "unit", "sign", "scale", "offset", "time", "constant"}
TEXT = ("station", "marker")
MARKER = ("marker_x", "marker_y", "marker_z")
INTEGER = ("pose", "load_case", "repeat")


class Profile:
    """A checked mapping file. Raises SessionError naming file and key."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        data = _load(self.path)
        if data.get("format") != FORMAT:
            raise SessionError(f"{self.path}: format is {data.get('format')!r}, this program reads {FORMAT}")
        for key in data:
            if key not in KEYS:
                raise SessionError(f"{self.path}: '{key}' is not a key of a profile; there are {', '.join(sorted(KEYS))}")
        self.table: Json = _mapping(data.get("table") or {}, f"{self.path}: table")
        self.session: Json = dict(_mapping(data.get("session"), f"{self.path}: session"))
        columns = _mapping(data.get("columns"), f"{self.path}: columns")
        self.columns = {str(name): self._column(str(name), given) for name, given in columns.items()}
        missing = _mapping(data.get("missing") or {}, f"{self.path}: missing")
        self.missing_text = {"", *map(str, missing.get("text", ()))}
        self.missing_marker = [float(v) for v in missing["marker"]] if "marker" in missing else None
        self.order_by = data.get("order_by")
        if self.order_by is not None and self.order_by not in self.columns:
            raise SessionError(f"{self.path}: order_by: '{self.order_by}' is not among the columns")
        self.drop_incomplete = bool(data.get("drop_incomplete", False))

    def _column(self, name: str, given: Any) -> Json:
        where = f"{self.path}: columns: {name}"
        spec: Json = {"column": given} if isinstance(given, str) else dict(_mapping(given, where))
        for key in spec:
            if key not in COLUMN_KEYS:
                raise SessionError(f"{where}: '{key}' is not known; there are {', '.join(sorted(COLUMN_KEYS))}")
        if "column" not in spec and "constant" not in spec:
            raise SessionError(f"{where}: give the 'column' of the table that it comes from, or a 'constant'")
        unit = spec.get("unit", "1")
        if str(unit) not in UNITS:
            raise SessionError(f"{where}: unit '{unit}' is not known; there are {', '.join(UNITS)}")
        for key in ("plus", "minus"):
            value = spec.get(key, [])
            spec[key] = [value] if isinstance(value, str) else list(value)
        return spec


def import_table(profile_path: str | Path, table: str | Path, folder: str | Path, name: str | None = None) -> Session:
    """Turn a foreign table into a session folder and read it back (which checks it).

    Args:
        profile_path: mapping file.
        table: file to read.
        folder: session.yaml, samples.csv and robot.urdf are written there.
        name: session name; the profile's where None.

    Raises:
        SessionError: profile or table can't be used; names file, line and column.
    """
    profile = Profile(profile_path)
    rows, notes = _rows(profile, Path(table))
    folder = Path(folder)
    header = {"format": SESSION_FORMAT, **profile.session}
    if name:
        header["name"] = name
    robot = dict(_mapping(header.get("robot"), f"{profile.path}: session: robot"))
    urdf = profile.path.parent / str(robot.get("urdf", ""))
    if not (is_there(urdf) and urdf.is_file()):
        raise SessionError(f"{profile.path}: session: robot: urdf: {urdf} is not there")
    header["robot"] = {**robot, "urdf": "robot.urdf"}
    names = list(dict.fromkeys(n for row in rows for n in row))
    lines = [",".join(names)] + [",".join(row[n] for n in names) for row in rows]
    described = read_bytes(urdf, "robot description", SessionError, URDF_LIMIT)
    with all_or_none():  # a table that can't be read back leaves nothing either
        write_file(folder / "robot.urdf", described, error=SessionError)
        write_file(folder / "session.yaml", yaml.safe_dump(header, sort_keys=False, allow_unicode=True), error=SessionError)
        write_file(folder / "samples.csv", "\n".join(lines) + "\n", error=SessionError)
        session = read_table(folder)
    return replace(session, notes=(*notes, *session.notes))


def _rows(profile: Profile, table: Path) -> tuple[list[dict[str, str]], list[str]]:
    """Rows of samples.csv, and what the user should know about how they came about."""
    names, lines = _read(profile, table)
    index = {n: i for i, n in enumerate(names)}
    for target, spec in profile.columns.items():
        for column in [spec.get("column"), *spec["plus"], *spec["minus"]]:
            if column is not None and column not in index:
                raise SessionError(
                    f"{profile.path}: columns: {target}: {table} has no column '{column}'; it has "
                    f"{', '.join(map(in_short, names))}"
                )
    notes, kept, dropped = [], [], 0
    for line, fields in lines:
        row: dict[str, Any] = {}
        for target, spec in profile.columns.items():
            row[target] = _value(profile, table, line, fields, index, target, spec)
        needed = [n for n in row if n.startswith("joint_") or n == "stamp"]
        empty = [n for n in needed if row[n] == ""]
        if empty and profile.drop_incomplete:
            dropped += 1
            continue
        if empty:
            raise SessionError(f"{table}:{line}: {empty[0]} is empty (drop_incomplete: true in the profile leaves such rows out)")
        kept.append((line, row))
    if dropped:
        notes.append(f"{dropped} rows without joint angles or time left out")
    if not kept:
        raise SessionError(f"{table}: no row is left to import")
    unseen = sum(_hide_missing_marker(profile, row) for _, row in kept)
    if unseen:
        notes.append(f"the marker was not seen in {unseen} of {len(kept)} rows")
    by = profile.order_by
    if by is not None:
        order = [row[by] for _, row in kept]
        if order != sorted(order):
            notes.append(f"rows sorted by {by}: the table is not in that order")
        kept.sort(key=lambda item: item[1][by])
    rows = [row for _, row in kept]
    if "stamp" in profile.columns:
        start = min(row["stamp"] for row in rows)
        for row in rows:
            row["stamp"] -= start
    elif profile.session.get("clock", "time") != "none":
        raise SessionError(
            f"{profile.path}: columns: no 'stamp'; map a time column, a row number (clock: order), or state clock: none"
        )
    for i, row in enumerate(rows):
        row.setdefault("pose", i + 1)
    return [{n: v if isinstance(v, str) else repr(v) for n, v in row.items()} for row in rows], notes


def _hide_missing_marker(profile: Profile, row: dict[str, Any]) -> bool:
    """Empty the marker fields of a row in which the instrument wrote its code for nothing seen, or only some coordinates."""
    values = [row.get(n, "") for n in MARKER]
    coded = profile.missing_marker is not None and values == profile.missing_marker
    if coded or "" in values:
        row.update(dict.fromkeys((n for n in MARKER if n in row), ""))
        return True
    return False


def _read(profile: Profile, table: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    options = profile.table
    skip = int(options.get("skip_lines", 0))
    try:
        text = read_bytes(table, "table", SessionError, TABLE_LIMIT).decode(str(options.get("encoding", "utf-8-sig")))
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=str(options.get("delimiter", ",")), skipinitialspace=True)
        lines = [(reader.line_num, [f.strip() for f in row]) for row in reader if any(f.strip() for f in row)]
    except (ValueError, LookupError, csv.Error, TypeError) as error:
        raise SessionError(f"{table}: can't read the table: {error}") from error
    lines = [item for item in lines if item[0] > skip]
    if options.get("names"):
        names = [str(n) for n in options["names"]]
    elif lines:
        first, names = lines.pop(0)
        if SEP_LINE.fullmatch(",".join(names)):
            raise SessionError(
                f"{table}:{first}: is a line for spreadsheets (sep=); leave it out, or state table: skip_lines: {first} in the "
                "profile"
            )
    else:
        raise SessionError(f"{table}: the file is empty")
    if names and names[-1] == "":
        names = names[:-1]
    for line, fields in lines:
        if len(fields) < len(names):
            raise SessionError(
                f"{table}:{line}: {len(fields)} fields, {len(names)} columns are named "
                f"(delimiter {options.get('delimiter', ',')!r})"
            )
    return names, lines


def _value(
    profile: Profile, table: Path, line: int, fields: list[str], index: dict[str, int], target: str, spec: Json
) -> float | int | str:
    if "column" not in spec:
        constant = spec["constant"]
        return str(constant) if target in TEXT else int(constant) if target in INTEGER else float(constant)
    where = f"{table}:{line}: column '{spec['column']}'"
    text = fields[index[spec["column"]]]
    if text in profile.missing_text:
        return ""
    if target in TEXT:
        return text
    if "time" in spec:
        return _time(text, str(spec["time"]), where)
    decimal = str(profile.table.get("decimal", "."))
    total = _number(text, decimal, where)
    for sign, names in ((1.0, spec["plus"]), (-1.0, spec["minus"])):
        for name in names:
            extra = fields[index[name]]
            if extra in profile.missing_text:
                return ""
            total += sign * _number(extra, decimal, f"{table}:{line}: column '{name}'")
    total = total * float(spec.get("sign", 1)) * float(spec.get("scale", 1)) + float(spec.get("offset", 0))
    if target in INTEGER:
        return int(total)
    return total * UNITS[str(spec.get("unit", "1"))]


def _number(text: str, decimal: str, where: str) -> float:
    try:
        value = float(text.replace(decimal, ".") if decimal != "." else text)
    except ValueError:
        raise SessionError(f"{where}: '{in_short(text)}' is not a number with decimal '{decimal}'") from None
    if not math.isfinite(value):
        raise SessionError(f"{where}: {in_short(text)} is not a finite number; name it under missing: text")
    return value


def _time(text: str, form: str, where: str) -> float:
    try:
        when = datetime.datetime.fromisoformat(text) if form == "iso" else datetime.datetime.strptime(text, form)
    except ValueError:
        raise SessionError(f"{where}: '{in_short(text)}' is not a time of the form '{form}'") from None
    if when.tzinfo is None:
        when = when.replace(tzinfo=datetime.UTC)
    return when.timestamp()


def _load(path: Path) -> Json:
    return _mapping(read_document(path, FORMAT, "profile", SessionError).data, str(path))


def _mapping(data: Any, where: str) -> Json:
    if not isinstance(data, dict):
        raise SessionError(f"{where}: a mapping is needed, found {type(data).__name__}")
    return data
