# SPDX-License-Identifier: Apache-2.0
"""The reference page of a format, made from its schema: `python -m irec_calibration.files.reference docs/formats`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from .schema import TYPES, format_names, schema_of

WRITTEN_BY = {
    "irec-cell/1": "people, `irec init-cell`",
    "irec-session/1": "the procedure, `irec export`, `irec import`, people",
    "irec-poses/1": "`irec plan`",
    "irec-model/1": "`irec solve`, `add`, `remove`, `improve`, people",
    "irec-diagnosis/1": "`irec diagnose`, `irec improve`",
    "irec-truth/1": "people, `irec-sim hidden`",
    "irec-import/1": "people",
    "irec-align/1": "people",
    "irec-joints/1": "people",
    "irec-journal/1": "calibration_node",
    "irec-run/1": "calibration_node",
}


def all_schemas() -> dict[str, dict[str, Any]]:
    """Schemas by format: ours, and that of the simulator where it is installed (read as a file, not imported)."""
    found = {name: schema_of(name) for name in format_names()}
    simulator = find_spec("irec_sim")
    for place in (simulator.submodule_search_locations or ()) if simulator else ():
        for file in sorted((Path(place) / "schemas").glob("*.json")):
            found[f"{file.stem[:-2]}/{file.stem[-1]}"] = json.loads(file.read_text(encoding="utf-8"))
    return found


def page(name: str, schema: dict[str, Any]) -> str:
    """The page of one format, Markdown."""
    file = f"{name.replace('/', '-')}.json"
    lines = [
        "<!-- Made from the schema by `python -m irec_calibration.files.reference docs/formats`; change the schema. -->",
        f"# `{name}`: {schema['title'][0].lower()}{schema['title'][1:]}",
        "",
        schema["description"],
        "",
        f"Written by: {WRITTEN_BY[name]}. JSON Schema: [`{file}`](schemas/{file}). Checked by `irec check FILE`.",
        "Limits are those beyond which a file is refused; a key in bold has to be there.",
        "",
        "| key | what it is | value |",
        "| --- | --- | --- |",
    ]
    lines += list(_rows(schema, "", set(schema.get("required", ()))))
    if schema.get("additionalProperties") is False:
        lines += ["", "Keys that are not listed are refused."]
    else:
        lines += ["", "Keys that are not listed are ignored."]
    return "\n".join(lines) + "\n"


def index(names: list[str]) -> str:
    """The page that lists the formats."""
    lines = [
        "<!-- Made by `python -m irec_calibration.files.reference docs/formats`. -->",
        "# Formats of files",
        "",
        "Every file says in its key `format` what it is. `irec check FILE...` reads each by the code that the programs",
        "use and says everything that is wrong with it, one line each: file, line, key, value, what is allowed, what to",
        "do. An editor that knows JSON Schema checks while you type, for example by the first line",
        "`# yaml-language-server: $schema=irec-cell-1.json`.",
        "",
        "Read are regular files of UTF-8 text of at most 16 MB, YAML or JSON. Numbers are those of YAML 1.2: `7e-6` is a",
        "number, `1:30` and `2024-03-01` are text. Refused are keys that occur twice, tags, merge keys, more than 32",
        "levels, and more than 200000 values, each alias counted as everything that it names.",
        "",
        "| format | written by |",
        "| --- | --- |",
        *(f"| [`{name}`]({name.replace('/', '-')}.md) | {WRITTEN_BY[name]} |" for name in names),
        "",
        "`samples.csv`, the rows of a session, is described in [session.md](session.md).",
    ]
    return "\n".join(lines) + "\n"


def _rows(schema: dict[str, Any], prefix: str, required: set[str]) -> Iterator[str]:
    for key, value in schema.get("properties", {}).items():
        name = f"{prefix}{key}"
        shown = f"**`{name}`**" if key in required else f"`{name}`"
        yield f"| {shown} | {_cell(value.get('description', ''))} | {_cell(_value(value))} |"
        yield from _inside(value, name)


def _inside(value: dict[str, Any], name: str) -> Iterator[str]:
    for branch in (value, value.get("then", {})):
        if "properties" in branch:
            yield from _rows(branch, f"{name}.", set(branch.get("required", ())))
        items = branch.get("items")
        if isinstance(items, dict):
            for part in (items, items.get("then", {}), items.get("else", {})):
                if "properties" in part:
                    yield from _rows(part, f"{name}[].", set(part.get("required", ())))
        more = branch.get("additionalProperties")
        if isinstance(more, dict):
            for part in (more, more.get("then", {})):
                if "properties" in part:
                    yield from _rows(part, f"{name}.*.", set(part.get("required", ())))


def _value(schema: dict[str, Any]) -> str:
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        words = " ".join(f"`{v}`" for v in schema["enum"])
        return words + _default(schema)
    kind = schema.get("type")
    if kind is None and "if" in schema:
        return " or ".join(filter(None, (_value(schema.get("else", {})), _value(schema.get("then", {})))))
    types = [kind] if isinstance(kind, str) else list(kind or ())
    out = " or ".join("nothing" if t == "null" else TYPES[t] for t in types)
    if "array" in types:
        low, high = schema.get("minItems"), schema.get("maxItems")
        count = f" of {low}" if low == high and low is not None else f" of {low or 0} to {high}" if high else ""
        items = schema.get("items", {})
        inner = _value(items) if isinstance(items, dict) else ""
        out += count + (f", each {inner}" if inner and inner != "a mapping" else "")
    if "number" in types or "integer" in types:
        out += _limits(schema)
    if "pattern" in schema:
        out = schema.get("form", f"`{schema['pattern']}`")
    return out + _default(schema)


def _limits(schema: dict[str, Any]) -> str:
    unit = f" {schema['unit']}" if schema.get("unit") else ""
    low, high, above = schema.get("minimum"), schema.get("maximum"), schema.get("exclusiveMinimum")
    if above is not None:
        return f"{unit}, above {above:g}" + (f", at most {high:g}" if high is not None else "")
    if low is not None and high is not None:
        return f"{unit}, {low:g} to {high:g}"
    if low is not None:
        return f"{unit}, at least {low:g}"
    return unit


def _default(schema: dict[str, Any]) -> str:
    return f" (default `{json.dumps(schema['default'])}`)" if "default" in schema else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def write(folder: Path) -> list[Path]:
    """All pages and schemas into a folder; returns the files."""
    (folder / "schemas").mkdir(parents=True, exist_ok=True)
    schemas = all_schemas()
    files = {folder / "README.md": index(sorted(schemas))}
    for name, schema in schemas.items():
        stem = name.replace("/", "-")
        files[folder / f"{stem}.md"] = page(name, schema)
        files[folder / "schemas" / f"{stem}.json"] = json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
    for path, text in files.items():
        path.write_text(text, encoding="utf-8")
    return list(files)


if __name__ == "__main__":
    print("\n".join(map(str, write(Path(sys.argv[1])))))
