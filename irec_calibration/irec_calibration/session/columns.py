# SPDX-License-Identifier: Apache-2.0
"""The columns of a table as text and as numbers; what is wrong in them is said with file, line and column, and what was meant."""

from __future__ import annotations

import csv
import io
import math
import re
from pathlib import Path

import numpy as np

from ..errors import SessionError
from ..files.regular import TABLE_LIMIT, read_text
from ..typing import Array, IntArray

XYZ = ("x", "y", "z")
INVISIBLE = "\ufeff\u200b\u200c\u200d\u2060\u00a0"  # before or after a name, or a number, by editors and web pages
SEPARATORS = {";": "';'", "\t": "tabulators", "|": "'|'", " ": "spaces"}
COMMENTS = ("#", "%", "//", "!")
LARGEST = 1e12  # of any quantity in SI units; larger ones stand for "no value" in some programs (FLT_MAX, DBL_MAX)
LARGEST_STAMP = 1e21  # ns since 1970 are 2e18
LARGEST_INDEX = 10**9
OTHER_MINUS = "\u2212\u2012\u2013\u2014"
SEP_LINE = re.compile(r"\"?sep=.?.?\"?,*", re.IGNORECASE)  # by which spreadsheets tell each other the separator
LONGEST_SHOWN = 60  # characters of a field or name in a message
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")


class Columns:
    """The columns of samples.csv as text, with errors that name file, line and column."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = read_text(path, "table of samples", SessionError, TABLE_LIMIT)
        try:
            reader = csv.reader(io.StringIO(text, newline=""))
            # a spreadsheet writes its empty lines as separators alone
            rows = [(reader.line_num, row) for row in reader if any(row) and any(field.strip() for field in row)]
        except csv.Error as error:
            raise SessionError(f"{path}: can't read the table: {error}") from error
        if not rows:
            raise SessionError(f"{path}: the file is empty; a header line with column names is needed")
        self.names = [name.strip().strip(INVISIBLE).strip() for name in rows[0][1]]
        if unread := _no_header(text, rows[0][0], self.names):
            raise SessionError(f"{path}:{rows[0][0]}: {unread}")
        doubled = {n for n in self.names if n and self.names.count(n) > 1}
        if doubled:
            raise SessionError(f"{path}:1: column '{in_short(sorted(doubled)[0])}' appears more than once")
        self.lines = [line for line, _ in rows[1:]]
        if not self.lines:
            raise SessionError(f"{path}: no samples, only a header line")
        for line, row in rows[1:]:
            if len(row) != len(self.names):
                why = _other_length(row, len(self.names), line == self.lines[-1])
                raise SessionError(f"{path}:{line}: {len(row)} fields, the header has {len(self.names)}{why}")
        if not any(NUMBER.fullmatch(field.strip()) for field in rows[1][1]):
            raise SessionError(f"{path}:{rows[1][0]}: no number in the whole line (a line of units?); leave the line out")
        self._text = {name: [row[i].strip() for _, row in rows[1:]] for i, name in enumerate(self.names) if name}
        self.names = [name for name in self.names if name]  # a separator at the end of each line makes a column without a name
        self.used: set[str] = set()

    def __contains__(self, name: str) -> bool:
        return name in self._text

    def __len__(self) -> int:
        return len(self.lines)

    def where(self, row: int, name: str) -> str:
        return f"{self.path}:{self.lines[row]}: column '{in_short(name)}'"

    def text(self, name: str) -> list[str]:
        self.used.add(name)
        return self._text[name]

    def missing(self, name: str) -> SessionError:
        """The error of a required column that is not there, with the column that may be meant."""
        return SessionError(f"{self.path}:1: required column '{name}' is missing{_meant(name, self.names)}")

    def numbers(self, name: str, *, required: bool = True, absent: float | None = None) -> Array:
        """One column as floats; NaN for an empty optional field, `absent` where the whole column is missing."""
        if name not in self:
            if absent is not None:
                return np.full(len(self), absent)
            raise self.missing(name)
        out = np.empty(len(self))
        largest = LARGEST_STAMP if name == "stamp" else LARGEST
        for i, text in enumerate(self.text(name)):
            if text == "":
                if required:
                    raise SessionError(f"{self.where(i, name)} is empty; it must be measured in every row")
                out[i] = math.nan
                continue
            try:
                out[i] = float(text)
            except ValueError:
                raise SessionError(f"{self.where(i, name)}: '{in_short(text)}' is not a number{_no_number(text)}") from None
            if "_" in text:  # Python's own way to write thousands
                raise SessionError(f"{self.where(i, name)}: '{in_short(text)}' is not a number (digits are not separated)")
            if not math.isfinite(out[i]):
                raise SessionError(
                    f"{self.where(i, name)}: {in_short(text)} is not a finite number; leave it empty if not measured"
                )
            if abs(out[i]) > largest:
                raise SessionError(
                    f"{self.where(i, name)}: {in_short(text)} is no measured value, at most {largest:g} is expected; leave it "
                    "empty if not measured"
                )
        return out

    def integers(self, name: str, *, absent: int | None = None, minimum: int = 0) -> IntArray:
        values = self.numbers(name, required=absent is None, absent=None if absent is None else float(absent))
        if absent is not None:
            values = np.where(np.isnan(values), float(absent), values)
        for i in np.flatnonzero((values != np.floor(values)) | (values < minimum) | (values > LARGEST_INDEX)):
            raise SessionError(
                f"{self.where(int(i), name)}: {values[i]:g} is not an integer of at least {minimum} and at most {LARGEST_INDEX}"
            )
        return values.astype(np.int64)

    def vectors(self, prefix: str, *, required: bool, absent: float | None = None) -> Array:
        """`prefix_x, _y, _z` as (n, 3): all three or none of them measured in a row."""
        out = np.stack([self.numbers(f"{prefix}_{a}", required=required, absent=absent) for a in XYZ], axis=1)
        missing = np.isnan(out)
        for i in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1)):
            raise SessionError(f"{self.where(int(i), prefix + '_*')}: some of x, y, z are empty; give all three or none")
        return out


def in_short(text: str) -> str:
    """A field or name of a table as it can stand in a message: one that is long by its beginning and its length."""
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN // 2]}... ({len(text)} characters)"


def _no_header(text: str, line: int, names: list[str]) -> str:
    """Why the first line with content is no header of ours, in words, or empty."""
    if "pose" in names:
        return ""
    first = text.splitlines()[line - 1].strip().strip(INVISIBLE).strip() if line <= len(text.splitlines()) else ""
    if SEP_LINE.fullmatch(first):
        return f"is a line for spreadsheets; leave out the line {first}: the first line holds the column names"
    if first.startswith(COMMENTS):
        return "is a comment; leave it out: the first line holds the column names"
    for separator, called in SEPARATORS.items():
        if separator in first and "pose" in [_plain(n) for n in first.split(separator)]:
            return f"fields are separated by {called}; save the table with commas between fields and '.' decimals"
    if names and NUMBER.fullmatch(names[0]):
        return "holds numbers; a header line with column names is needed"
    return ""


def _other_length(row: list[str], wanted: int, last: bool) -> str:
    """Why a row may have another number of fields than the header, in words."""
    if len(row) == wanted + 1 and not row[-1].strip():
        return "; is there a comma at the end of the line?"
    if len(row) > wanted:
        return "; are commas used as decimal marks or between thousands? '.' decimals are needed"
    return "; does the file end within the line?" if last else ""


def _no_number(text: str) -> str:
    if any(c in text for c in OTHER_MINUS):
        meant = in_short(_with_minus(text))
        return f" (its minus is another character; write '-'): '.' decimals and digits are needed, as in {meant}"
    if re.fullmatch(r"[+-]?\d*,\d+([eE][+-]?\d+)?", text):
        return " (a decimal comma); '.' decimals are needed"
    return " ('.' decimals are needed)"


def _with_minus(text: str) -> str:
    return "".join("-" if c in OTHER_MINUS else c for c in text)


def _plain(name: str) -> str:
    """A column name without case, units in brackets, quotes and separators."""
    name = re.sub(r"[\[(].*", "", name.strip().strip("\"'").strip(INVISIBLE).lower())
    return re.sub(r"[\s\-.]+", "_", name.strip()).strip("_")


def _meant(name: str, names: list[str]) -> str:
    """Which column may be meant by a name that is missing, in words."""
    near = next((n for n in names if _plain(n) == name), None)
    if near is None and (joint := re.fullmatch(r"joint_(\d+)", name)):
        near = next((n for n in names if re.fullmatch(rf"(a|j|q|axis|joint)[\s_.-]*{joint[1]}", n.lower())), None)
    if near is None:
        return ""
    return f"; '{in_short(near)}' is there: write {name}, in lower case and without a unit"
