# SPDX-License-Identifier: Apache-2.0
"""Files that the simulator reads: regular, of bounded size, YAML whose aliases do not explode, checked by a JSON Schema."""

from __future__ import annotations

import json
import math
import os
import re
import stat
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from .errors import SimError

TEXT_LIMIT = 16_000_000  # bytes
MOST_NODES = 200_000
DEEPEST = 32


def read_text(path: str | Path, what: str) -> str:
    """UTF-8 text of a regular file. SimError: not there, a device or a pipe, too large, or no text."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise SimError(f"{path}: the {what} is no regular file")
            data = file.read(TEXT_LIMIT + 1)
    except (OSError, ValueError) as error:
        raise SimError(f"{path}: can't read the {what}: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > TEXT_LIMIT:
        raise SimError(f"{path}: the {what} has more than {TEXT_LIMIT} bytes; is it the right file?")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SimError(f"{path}: the {what} is no UTF-8 text (byte {error.start})") from None


def read_yaml(path: str | Path, what: str) -> Any:
    """Content of a YAML file. SimError: not read, not YAML, or larger than a file of its size could be (aliases)."""
    text = read_text(path, what)
    try:
        _check_size(text, str(path))
        return yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError, RecursionError, TypeError) as error:
        raise SimError(f"{path}: not YAML: {' '.join(str(error).split())[:300]}") from None


def check(format_: str, data: Any, where: str) -> list[str]:
    """What differs from the schema of a format of the simulator's, one line each."""
    from jsonschema import Draft202012Validator

    errors = Draft202012Validator(schema_of(format_)).iter_errors(data)
    found = [f"{where}: {'.'.join(map(str, e.absolute_path)) or 'the file'}: {' '.join(e.message.split())[:200]}" for e in errors]
    return found + [f"{where}: {place}: {value} is not a finite number" for place, value in _not_finite(data, "")]


@cache
def schema_of(format_: str) -> dict[str, Any]:
    """JSON Schema of a format, e.g. irec-truth/1."""
    file = resources.files(__package__).joinpath("schemas", f"{format_.replace('/', '-')}.json")
    loaded: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return loaded


class _Loader(yaml.SafeLoader):
    """Numbers such as 7e-6, which YAML 1.1 takes for text, are numbers; dates are text."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, expression) for tag, expression in pairs if not tag.endswith((":timestamp", ":merge"))]
    for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def _check_size(text: str, path: str) -> None:
    """Count the values that a text stands for, each alias as all that it names."""
    nodes = depth = 0
    begun: list[tuple[str | None, int]] = []
    sizes: dict[str, int] = {}
    for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                raise SimError(f"{path}: alias *{event.anchor} names nothing complete above it")
            nodes += sizes[event.anchor]
        elif isinstance(event, yaml.ScalarEvent):
            nodes += 1
            if event.anchor:
                sizes[event.anchor] = 1
        elif isinstance(event, yaml.CollectionStartEvent):
            nodes += 1
            depth += 1
            begun.append((event.anchor, nodes))
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
            anchor, first = begun.pop()
            if anchor:
                sizes[anchor] = nodes - first + 1
        if nodes > MOST_NODES or depth > DEEPEST:
            line = event.start_mark.line + 1 if event.start_mark else 0
            raise SimError(f"{path}:{line}: more than {MOST_NODES} values or {DEEPEST} levels; is it the right file?")


def _not_finite(value: Any, place: str) -> list[tuple[str, Any]]:
    if isinstance(value, float) and not math.isfinite(value):
        return [(place or "the file", value)]
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [found for k, v in items for found in _not_finite(v, f"{place}.{k}" if place else str(k))]
