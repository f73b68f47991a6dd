# SPDX-License-Identifier: Apache-2.0
"""Messages from YAML as it is typed on a command line, and back."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

SEQUENCE = re.compile(r"sequence<(.+?)(?:, *(\d+))?>$|(.+)\[(\d+)\]$")
NUMBERS = {"float": float, "double": float}


class FieldError(ValueError):
    """What was typed does not fit a message; says which field, and what it takes."""


def interface(name: str, kind: str) -> Any:
    """Class of e.g. `irec_msgs/action/RunProcedure`. Raises FieldError: there is none of this kind ("msg", "srv", "action")."""
    parts = name.split("/")
    if len(parts) == 2:
        parts.insert(1, kind)
    try:
        if len(parts) != 3 or parts[1] != kind:
            raise ImportError(f"a name like package/{kind}/Type is needed")
        return getattr(import_module(f"{parts[0]}.{kind}"), parts[2])
    except (ImportError, AttributeError) as error:
        raise FieldError(f"'{name}' is no {kind} that is known here: {error}") from error


def fill(message: Any, given: Any, where: str = "") -> Any:
    """The message with what is given; what is not given keeps its default. Raises FieldError."""
    kinds = message.get_fields_and_field_types()
    if not isinstance(given, dict):
        raise FieldError(f"{where or type(message).__name__} takes {{{', '.join(kinds)}}}, not {given!r}")
    for key, value in given.items():
        if key not in kinds:
            raise FieldError(f"{type(message).__name__} has no field '{key}'; it has {', '.join(kinds)}")
        setattr(message, key, _value(kinds[key], value, f"{where}.{key}" if where else str(key)))
    return message


def _value(kind: str, value: Any, where: str) -> Any:
    many = SEQUENCE.match(kind)
    if many is not None:
        one, length = many[1] or many[3], many[4]
        if not isinstance(value, list) or (length and len(value) != int(length)):
            raise FieldError(f"{where} takes a list{f' of {length}' if length else ''}, not {value!r}")
        return [_value(one, v, f"{where}[{k}]") for k, v in enumerate(value)]
    if "/" in kind:
        return fill(interface(kind, "msg")(), value, where)
    wanted: Any = NUMBERS.get(kind)
    if wanted is None:
        wanted = bool if kind == "boolean" else str if "string" in kind else int
    fits = isinstance(value, int | float) if wanted is float else isinstance(value, wanted)
    if not fits or (isinstance(value, bool) and wanted is not bool):
        raise FieldError(f"{where} takes a {kind}, not {value!r}")
    return wanted(value)


def plain(value: Any) -> Any:
    """A message as what YAML can write."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, str | bytes | bool | int | float):
        return value
    if hasattr(value, "tolist"):  # arrays
        return value.tolist()
    return [plain(v) for v in value]
