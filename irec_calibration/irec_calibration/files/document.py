# SPDX-License-Identifier: Apache-2.0
"""A YAML or JSON file that is checked against the JSON Schema of its format; everything that is wrong in it is said at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import IrecError, one_line
from .regular import TEXT_LIMIT, one_line_path, read_text
from .schema import MOST, violations
from .yaml_text import Path_, YamlProblem, parse_yaml


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong in a file: line (0 where unknown), key path, and what is wrong with it and what to do."""

    file: str
    line: int
    key: str
    text: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        return one_line(f"{place}: {self.key + ' ' if self.key else ''}{self.text}")

    def as_dict(self) -> dict[str, Any]:
        return {"file": self.file, "line": self.line, "key": self.key, "problem": self.text}


@dataclass
class Document:
    """The content of a checked file.

    Attributes:
        path: of the file, or the name by which messages call the text.
        data: its content; keys that are whole numbers are int, all others str.
        lines: line of each value by its path of keys (text) and indices.
        problems: what has been found wrong so far.
        text: of which all this was made; empty where it was no text.
    """

    path: str
    data: Any
    lines: dict[Path_, int] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    text: str = ""
    _broken: set[Path_] = field(default_factory=set)

    def wrong(self, key: Path_, text: str) -> None:
        """Note a problem at a key path."""
        line = 0
        for n in range(len(key), -1, -1):  # the nearest thing around it that is there
            if key[:n] in self.lines:
                line = self.lines[key[:n]]
                break
        self._broken.add(key)
        self.problems.append(Problem(self.path, line, key_text(key), text))

    def sound(self, *key: str | int) -> bool:
        """Whether a key is there and nothing in it or around it has been found wrong."""
        if len(self._broken) >= MOST:  # the schema said no more than that
            return False
        at = self.data
        for step in key:
            try:
                at = at[step]
            except (KeyError, IndexError, TypeError):
                return False
        steps = tuple(str(k) if not isinstance(at, list) and isinstance(k, int) else k for k in key)
        return not any(_within(broken, steps) for broken in self._broken)

    def finish(self, error: type[IrecError]) -> None:
        """Raise `error` if anything is wrong; its `problems` holds a line for each."""
        if self.problems:
            fail(error, [str(p) for p in self.problems])


def fail(error: type[IrecError], problems: list[str]) -> None:
    """Raise an error whose message is one line: the first problem, and how many more there are."""
    more = len(problems) - 1
    text = problems[0] + (f" (and {more} more: irec check says all)" if more else "")
    raised = error(text)
    raised.problems = tuple(problems)
    raise raised


Rules = Iterable[Callable[["Document"], None]]


def read_document(
    path: str | Path, format_: str | tuple[str, ...], what: str, error: type[IrecError], *, rules: Rules = ()
) -> Document:
    """Read a file; see open_document. Whatever is wrong in it is raised.

    Raises:
        error: in one line with file, line, key, value and what is allowed; `problems` has one line for each.
    """
    document = open_document(path, format_, what, error, rules=rules)
    document.finish(error)
    return document


def open_document(
    path: str | Path,
    format_: str | tuple[str, ...],
    what: str,
    error: type[IrecError],
    *,
    rules: Rules = (),
    limit: int = TEXT_LIMIT,
) -> Document:
    """Read a file and check it against the schema of its format, then by rules that a schema can't express.

    Args:
        path: YAML (or JSON, which is YAML) file.
        format_: what its key `format` has to be, or several of which it may be one.
        what: the kind of file, for messages.
        error: class of the error to raise.
        rules: functions that note problems in the document; they see sound parts only if they ask `sound`.

    Returns:
        the document with everything that is wrong in it in `problems`.

    Raises:
        error: not a file of this format at all.
    """
    return check_text(read_text(path, what, error, limit), one_line_path(path), format_, what, error, rules=rules)


def check_text(
    text: str,
    name: str,
    format_: str | tuple[str, ...],
    what: str,
    error: type[IrecError],
    *,
    rules: Rules = (),
) -> Document:
    """The same for a text that is no file of its own (an attachment of a recording); `name` stands for it in messages."""
    try:
        data, lines = parse_yaml(text)
    except YamlProblem as problem:
        place = f"{name}:{problem.line}" if problem.line else name
        raise error(one_line(f"{place}: {problem.text}")) from None
    document = check_data(data, name, format_, what, error, rules=rules, lines=lines)
    document.text = text
    return document


def check_data(
    data: Any,
    name: str,
    format_: str | tuple[str, ...],
    what: str,
    error: type[IrecError],
    *,
    rules: Rules = (),
    lines: dict[Path_, int] | None = None,
) -> Document:
    """The same for content that was read already."""
    allowed = (format_,) if isinstance(format_, str) else format_
    if not isinstance(data, dict):
        raise error(f"{name}: the {what} must be a mapping that begins with format: {allowed[0]}, is {kind_of(data)}")
    found = data.get("format")
    stated = next((f for f in allowed if f == found or (isinstance(found, str) and found.startswith(f + "."))), None)
    if stated is None:
        names = " or ".join(allowed)
        raise error(one_line(f"{name}: format is {short(found)}, this program reads {names}; is it the right file?"))
    document = Document(name, data, lines or {})
    for key, words in violations(stated, data):
        document.wrong(key, words)
    for rule in rules:
        rule(document)
    return document


def _within(broken: Path_, key: Path_) -> bool:
    """Whether one of two key paths is a part of the other."""
    n = min(len(broken), len(key))
    return tuple(map(str, broken[:n])) == tuple(map(str, key[:n]))


def key_text(key: Path_) -> str:
    """`stations[0].xyz`"""
    out = ""
    for step in key:
        out += f"[{step}]" if isinstance(step, int) else f"{'.' if out else ''}{step}"
    return out


def kind_of(value: Any) -> str:
    """What a value is, in words."""
    if value is None:
        return "empty"
    names = {bool: "true or false", int: "a number", float: "a number", str: "text", list: "a list", dict: "a mapping"}
    return names.get(type(value), type(value).__name__)


def short(value: Any, limit: int = 60) -> str:
    """A value as it can stand in a message: one line, not long."""
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list | dict) and len(value) > 12:
        return f"{kind_of(value)} of {len(value)}"
    try:
        text = repr(value)
    except RecursionError:
        return kind_of(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."
