# SPDX-License-Identifier: Apache-2.0
"""YAML as data: the parser of PyYAML, and a strict construction from its events.

Differences from `yaml.safe_load`: numbers are those of YAML 1.2 (7e-6 is a number, 1:30 and 2024-03-01 are text); a key that
occurs twice, an unknown tag, deep nesting, and aliases that expand to more than a file of
this size could hold by itself are refused; each value knows its line.
"""

from __future__ import annotations

import math
import re
from typing import Any

import yaml
from yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
)

DEEPEST = 32
MOST_NODES = 200_000
_LONGEST_NUMBER = 40
_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS = {"null": None, "Null": None, "NULL": None, "~": None, "": None, "true": True, "True": True, "TRUE": True}
_WORDS |= {"false": False, "False": False, "FALSE": False}
_TAGS = {f"tag:yaml.org,2002:{name}" for name in ("str", "int", "float", "bool", "null", "map", "seq")}
Path_ = tuple[str | int, ...]


class YamlProblem(Exception):
    """One thing that keeps a text from being read: line (0 where unknown) and what it is."""

    def __init__(self, line: int, text: str) -> None:
        super().__init__(text)
        self.line, self.text = line, text


class _Open:
    """A list or mapping that is being filled."""

    def __init__(self, value: list[Any] | dict[Any, Any], path: Path_, anchor: str | None, at: int) -> None:
        self.value, self.path, self.anchor, self.at = value, path, anchor, at
        self.key: Any = None
        self.has_key = False
        self.keys: set[str] = set()


def parse_yaml(text: str) -> tuple[Any, dict[Path_, int]]:
    """The content of a YAML text with one document, and the line (from 1) of each value by its path of keys and indices.

    Raises:
        YamlProblem: syntax, or one of the refusals named above.
    """
    lines: dict[Path_, int] = {}
    anchors: dict[str, tuple[Any, int]] = {}  # value, nodes
    open_: list[_Open] = []
    root: Any = None
    nodes = documents = 0

    def put(value: Any, line: int) -> Path_:
        nonlocal root
        if not open_:
            root = value
            lines[()] = line
            return ()
        top = open_[-1]
        if isinstance(top.value, list):
            path: Path_ = (*top.path, len(top.value))
            top.value.append(value)
        else:
            path = (*top.path, str(top.key))
            top.value[top.key] = value
            top.has_key = False
        lines[path] = line
        return path

    def expects_key() -> bool:
        return bool(open_) and isinstance(open_[-1].value, dict) and not open_[-1].has_key

    def take_key(key: Any, line: int) -> None:
        top = open_[-1]
        if key == "<<":
            raise YamlProblem(line, "merge keys (<<) are not read; write the values out")
        if str(key) in top.keys:
            raise YamlProblem(line, f"key {key!r} occurs twice in one mapping; remove one")
        top.keys.add(str(key))
        top.key, top.has_key = key, True

    for event in _events(text):
        line = event.start_mark.line + 1
        if isinstance(event, DocumentStartEvent):
            documents += 1
            if documents > 1:
                raise YamlProblem(line, "a second document begins here (---); one file holds one")
            continue
        if isinstance(event, ScalarEvent | SequenceStartEvent | MappingStartEvent):
            nodes += 1
            if event.tag not in (None, "!") and event.tag not in _TAGS:
                raise YamlProblem(line, f"tag {event.tag!r} is not read; write plain text, numbers, lists and mappings")
        if isinstance(event, ScalarEvent):
            if expects_key():
                take_key(int(event.value) if _is_index(event) else event.value, line)
                continue
            value = _scalar(event, line)
            put(value, line)
            if event.anchor:
                anchors[event.anchor] = (value, 1)
        elif isinstance(event, SequenceStartEvent | MappingStartEvent):
            if expects_key():
                raise YamlProblem(line, "a list or mapping can't be a key; write text")
            if len(open_) >= DEEPEST:
                raise YamlProblem(line, f"nested deeper than {DEEPEST} levels")
            new: list[Any] | dict[Any, Any] = [] if isinstance(event, SequenceStartEvent) else {}
            open_.append(_Open(new, put(new, line), event.anchor, nodes))
        elif isinstance(event, SequenceEndEvent | MappingEndEvent):
            done = open_.pop()
            if done.anchor:
                anchors[done.anchor] = (done.value, nodes - done.at + 1)
        elif isinstance(event, AliasEvent):
            if expects_key():
                raise YamlProblem(line, f"alias *{event.anchor} can't be a key; write text")
            if event.anchor not in anchors:
                raise YamlProblem(line, f"alias *{event.anchor} names nothing that is complete above it")
            value, size = anchors[event.anchor]
            nodes += size
            put(value, line)
        if nodes > MOST_NODES:
            raise YamlProblem(line, f"more than {MOST_NODES} values (aliases expanded); is it the right file?")
    return root, lines


def _events(text: str) -> Any:
    try:
        # the parser written in C is some ten times faster; libyaml is missing only from unusual builds of PyYAML
        yield from yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f" at column {mark.column + 1}" if mark else ""
        words = f"{error.problem or error.context}{place}".replace("\n", " ")
        raise YamlProblem(mark.line + 1 if mark else 0, f"not YAML: {words}") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1 if isinstance(error.position, int) else 0
        raise YamlProblem(line, "not YAML: a control character that text can't hold") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise YamlProblem(0, f"not YAML: {' '.join(str(error).split())[:200]}") from None


def _is_index(event: ScalarEvent) -> bool:
    return bool(event.style in (None, "") and len(event.value) < 10 and re.fullmatch(r"0|[1-9][0-9]*", event.value))


def _scalar(event: ScalarEvent, line: int) -> Any:
    text: str = event.value
    if event.style not in (None, "") or event.tag == "tag:yaml.org,2002:str":
        if event.tag in (None, "!", "tag:yaml.org,2002:str"):
            return text
    return scalar_value(text, line)


def scalar_value(text: str, line: int = 0) -> Any:
    """A plain word as YAML 1.2 reads it: nothing, true or false, a number, or text. YamlProblem: a number that can't be held."""
    if text in _WORDS:
        return _WORDS[text]
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", "").lower())  # refused by whoever checks the content, with its place
    if not _FLOAT.fullmatch(text):
        return text
    if len(text) > _LONGEST_NUMBER:
        raise YamlProblem(line, f"a number of {len(text)} characters; at most {_LONGEST_NUMBER} are read")
    if _INT.fullmatch(text):
        number = int(text)
        return number if abs(number) < 2**63 else float(number)
    value = float(text)
    if not math.isfinite(value):
        raise YamlProblem(line, f"{text} is too large for a number")
    return value
