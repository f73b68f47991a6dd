# SPDX-License-Identifier: Apache-2.0
"""JSON Schemas of our formats, and what the library `jsonschema` finds against them in our words.

A schema may add to a value: `unit` (what its number counts in), `advice` (what to do when it is wrong), `for_people` (no
program reads it, and its numbers need not be finite). These are annotations that other validators and editors ignore.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterator
from functools import cache
from importlib import resources
from itertools import islice
from typing import Any

_UNKNOWN = "is not known here"
MOST = 100  # problems of one file that are said
TYPES = {
    "number": "a number", "integer": "a whole number", "string": "text", "boolean": "true or false", "array": "a list",
    "object": "a mapping", "null": "empty",
}  # fmt: skip


def format_names() -> list[str]:
    """The formats that have a schema, e.g. irec-cell/1."""
    files = resources.files(__package__).joinpath("schemas").iterdir()
    return sorted(f"{f.name[:-7]}/{f.name[-6]}" for f in files if f.name.endswith(".json"))


@cache
def schema_of(format_: str) -> dict[str, Any]:
    """JSON Schema of a format. KeyError: there is none."""
    name, _, version = format_.partition("/")
    file = resources.files(__package__).joinpath("schemas", f"{name}-{version}.json")
    if not file.is_file():
        raise KeyError(format_)
    loaded: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return loaded


@cache
def _validator(format_: str) -> Any:
    from jsonschema import Draft202012Validator  # only who reads a file pays for it

    return Draft202012Validator(schema_of(format_))


def violations(format_: str, data: Any) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Key path and words for everything in which data differ from the schema of a format, in the order of the file."""
    checked = schema_of(format_)["properties"]
    infinite = [path for path in _not_finite(data, ()) if not checked.get(path[0], {}).get("for_people")]
    yield from ((path, "is not a finite number; leave the key out where nothing is known") for path in infinite[:MOST])
    said: dict[tuple[tuple[str | int, ...], str], None] = {}  # the library says each missing key in an error of its own
    for error in islice(_validator(format_).iter_errors(_with_text_keys(data)), MOST):
        said.update(dict.fromkeys(_in_words(error)))
    misspelt = {(*key[:-1], words.rpartition(" ")[2]) for key, words in said if words.startswith(_UNKNOWN)}
    for key, words in said:
        if key in infinite:
            continue
        if not (key in misspelt and words.startswith("is missing")):  # said once is enough
            yield key, words


def _not_finite(value: Any, path: tuple[str | int, ...]) -> Iterator[tuple[str | int, ...]]:
    if isinstance(value, float) and not math.isfinite(value):
        yield path
    elif isinstance(value, dict):
        for k, v in value.items():
            yield from _not_finite(v, (*path, str(k)))
    elif isinstance(value, list):
        for i, v in enumerate(value):
            yield from _not_finite(v, (*path, i))


def _with_text_keys(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _with_text_keys(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_with_text_keys(v) for v in value]
    return value


def _in_words(error: Any) -> Iterator[tuple[tuple[str | int, ...], str]]:
    from .document import kind_of, short

    key = tuple(error.absolute_path)
    schema, value, kind = error.schema, error.instance, error.validator
    if kind == "required":
        for name in error.validator_value:
            if name not in value:
                about = schema.get("properties", {}).get(name, {}).get("description", "")
                yield (*key, name), f"is missing{': ' + about if about else ''}"
        return
    if kind == "additionalProperties":
        known = list(schema.get("properties", {}))
        for name in value:
            if name not in known:
                near = difflib.get_close_matches(str(name), known, 1)
                yield (*key, name), f"{_UNKNOWN}; {f'write {near[0]}' if near else 'remove it'}"
        return
    advice = f"; {schema['advice']}" if "advice" in schema else ""
    unit = f" {schema['unit']}" if "unit" in schema else ""
    if kind == "type":
        wanted = error.validator_value
        words = " or ".join(TYPES[w] for w in ([wanted] if isinstance(wanted, str) else wanted))
        is_ = kind_of(value) if isinstance(value, dict | list) or value is None else short(value)
        yield key, f"is {is_}, must be {words}{' in' + unit if unit else ''}{'' if advice.endswith('?') else advice}"
    elif kind in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"):
        # a question about the unit is one about size: a negative distance is none in another unit
        asked = advice.endswith("?") and abs(value) <= abs(schema.get("maximum", schema.get("exclusiveMaximum", 0.0)))
        yield key, f"is {short(value)}{unit}, must {_range(schema)}{unit}{'' if asked else advice}"
    elif kind in ("minItems", "maxItems"):
        low, high = schema.get("minItems", 0), schema.get("maxItems")
        words = f"{low}" if low == high else f"at least {low}" if high is None else f"{low} to {high}"
        yield key, f"has {len(value)} values, must have {words}{advice}"
    elif kind in ("minProperties", "minLength"):
        yield key, f"is empty{advice}"
    elif kind == "maxLength":
        yield key, f"has {len(value)} characters, at most {error.validator_value} are allowed{advice}"
    elif kind == "enum":
        near = difflib.get_close_matches(str(value), [str(v) for v in error.validator_value], 1)
        write = f"; write {near[0]}" if near and not advice else ""
        yield key, f"is {short(value)}, must be one of {', '.join(map(str, error.validator_value))}{write}{advice}"
    elif kind == "const":
        yield key, f"is {short(value)}, must be {short(error.validator_value)}{advice}"
    elif kind == "uniqueItems":
        yield key, f"lists something twice: {short(value)}{advice}"
    elif kind == "pattern":
        yield key, f"is {short(value)}, must be {schema.get('form', 'of the form ' + error.validator_value)}{advice}"
    elif kind in ("patternProperties", "propertyNames"):
        yield key, f"has a key that is not allowed: {short(value)}{advice}"
    else:
        yield key, f"is {short(value)}, which is not allowed here{advice}"


def _range(schema: dict[str, Any]) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f"lie between {low:g} and {high:g}"
    parts = [f"be at least {low:g}"] if low is not None else [f"be above {above:g}"] if above is not None else []
    if high is not None:
        parts.append(f"be at most {high:g}" if not parts else f"at most {high:g}")
    if below is not None:
        parts.append(f"below {below:g}")
    return " and ".join(parts)
