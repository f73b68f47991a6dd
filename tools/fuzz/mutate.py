# SPDX-License-Identifier: Apache-2.0
"""Mutations of valid files: of bytes, of words, of the structure of YAML, of the records in a recording."""

from __future__ import annotations

import copy
import random
import re
import struct
from typing import Any

import yaml
import zstandard

WORDS = (
    "0", "-1", "1", "1e308", "-1e308", "1e-320", "nan", "inf", "-inf", ".nan", ".inf", "99999999999999999999", "4294967295",
    "1e9",
    "abc", "", "null", "true", "[]", "{}", "[[1]]", "'", '"', "-", "é", "\x00", "a" * 3000, "9" * 400, "/dev/zero", "../../x",
    "&a [*a]", "!!python/object:os.system x", "<<", "\n\n", "\t", "1,2", "::", "2024-03-01", "joint_1", "*", "-0.0", "1_000",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1, 7, 1e308, -1e308, float("nan"), float("inf"), 10**30, 2**32 - 1, "", "abc", "x" * 500, [], {},
    [1], [[1, 2]],
    {"a": 1}, [None], ["a", "b"], [1e9, 1e9, 1e9], [0, 0, 0], [0, 0, 0, 0], "1e400", "/dev/zero",
    "../../../etc/passwd", "é\n\x07",
    [{}], [1.0] * 300, "-(joint_2 + joint_3)", "2024-03-01", 3000, -0.0, 1e-320, "axis 1: c * tau",
)  # fmt: skip


# those of C where PyYAML has them: most of the time would go into files that nobody has read yet
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    """A few changes anywhere: bits, slices left out, doubled or put elsewhere, words put in, the end cut off."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        if not out:
            break
        at, kind = rng.randrange(len(out)), rng.randrange(7)
        length = min(rng.choice((1, 2, 4, 8, 40, 400)), len(out) - at)
        if kind == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at] = rng.choice((0, 255, 127, 128, rng.randrange(256)))
        elif kind == 2:
            del out[at : at + length]
        elif kind == 3:
            out[at:at] = out[at : at + length] * rng.choice((1, 2, 30))
        elif kind == 4:
            out[at : at + length] = rng.choice(WORDS).encode()
        elif kind == 5:
            del out[at:]
        else:
            out[at : at + 4] = struct.pack("<I", rng.choice((0, 1, 0x7FFFFFFF, 0xFFFFFFFF, len(out), 65536)))
    return bytes(out)


def mutate_words(text: str, rng: random.Random) -> str:
    """Numbers and names replaced by awkward ones, lines left out, doubled or exchanged."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        found = list(re.finditer(r"[-+.\w]+", text))
        if found and rng.random() < 0.8:
            word = rng.choice(found)
            other = rng.choice(WORDS) if rng.random() < 0.7 else rng.choice(found)[0]
            text = text[: word.start()] + other + text[word.end() :]
        else:
            lines = text.split("\n")
            i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
            if rng.random() < 0.5:
                lines[i : i + 1] = rng.choice(([], [lines[i]] * 2, [lines[j]]))
            else:
                lines[i], lines[j] = lines[j], lines[i]
            text = "\n".join(lines)
    return text


def mutate_yaml(data: bytes, rng: random.Random) -> bytes:
    """A YAML file with some of its values, keys or list items changed."""
    kind = rng.random()
    if kind < 0.15:
        return mutate_bytes(data, rng)
    if kind < 0.35:
        return mutate_words(data.decode(), rng).encode("utf-8", "surrogateescape")
    tree = yaml.load(data, _Loader)
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        places = list(_places(tree))
        if not places:
            break
        parent, key = rng.choice(places)
        change = rng.randrange(7)
        if change == 0:
            del parent[key]
        elif change == 1 and isinstance(parent, dict):
            parent[rng.choice(("", "é", 5, str(key) + "_", str(key)[:-1], "format", None, True))] = parent.pop(key)
        elif change == 2:
            other, k = rng.choice(places)
            parent[key] = copy.deepcopy(other[k])
        elif change == 3 and isinstance(parent, list):
            parent.extend(copy.deepcopy(parent) * rng.choice((1, 3)))
        elif change == 4 and isinstance(parent[key], (int, float)):
            parent[key] = parent[key] * rng.choice((-1, 1000, 1e-3, 1e12, 57.29577951308232, 0))
        else:
            parent[key] = copy.deepcopy(rng.choice(VALUES))
    sort_keys, style = rng.random() < 0.2, rng.choice((None, True, False))
    text = yaml.dump(tree, Dumper=_Dumper, allow_unicode=True, sort_keys=sort_keys, default_flow_style=style)
    return text.encode("utf-8", "replace")


def _places(tree: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    todo = [tree]
    while todo:
        at = todo.pop()
        items = list(at.items()) if isinstance(at, dict) else list(enumerate(at)) if isinstance(at, list) else []
        for key, value in items:
            found.append((at, key))
            todo.append(value)
    return found


def mutate_table(data: bytes, rng: random.Random) -> bytes:
    """A CSV file with fields, columns or lines changed."""
    if rng.random() < 0.2:
        return mutate_bytes(data, rng)
    rows = [line.split(",") for line in data.decode().split("\n")]
    for _ in range(rng.choice((1, 1, 2, 5))):
        row = rng.choice(rows[:1] if rng.random() < 0.3 else rows)
        i = rng.randrange(len(row))
        kind = rng.randrange(5)
        if kind == 0:
            row[i] = rng.choice(WORDS)
        elif kind == 1 and len(row) > 1:
            del row[i]
        elif kind == 2:
            row[i] = rng.choice(rng.choice(rows))
        elif kind == 3:
            rows.insert(rng.randrange(len(rows)), list(row))
        else:
            column = rng.randrange(len(rows[0]))
            for r in rows[1:]:
                if column < len(r):
                    r[column] = rng.choice(WORDS)
    return "\n".join(",".join(row) for row in rows).encode("utf-8", "replace")


def mutate_recording(data: bytes, rng: random.Random) -> bytes:
    """An MCAP file with changed bytes, or with changed records inside of its chunks, compressed anew."""
    if rng.random() < 0.4:
        return mutate_bytes(data, rng)
    records = [data[:8]]
    at = 8
    while at + 9 <= len(data):
        length = int.from_bytes(data[at + 1 : at + 9], "little")
        records.append(data[at : at + 9 + length])
        at += 9 + length
    for _ in range(rng.choice((1, 1, 2, 4))):
        i = rng.randrange(1, len(records))
        record = records[i]
        kind = rng.randrange(7)
        if kind == 0:
            del records[i]
            if len(records) < 2:
                break
        elif kind == 1:
            records.insert(rng.randrange(1, len(records)), record)
        elif kind == 2 or not record or record[0] != 6:
            body = mutate_bytes(record[9:], rng)
            records[i] = record[:1] + struct.pack("<Q", len(body)) + body
        else:
            records[i] = _chunk_anew(record[9:], rng)
    return b"".join(records)


def _chunk_anew(body: bytes, rng: random.Random) -> bytes:
    """A chunk whose records are mutated, or that holds zeros, announced rightly or wrongly."""
    size, _, name = struct.unpack_from("<QII", body, 16)
    packed = body[32 + name + 8 :]
    try:
        plain = zstandard.decompress(packed, max_output_size=size)
    except zstandard.ZstdError:
        plain = packed
    kind = rng.randrange(4)
    if kind == 0:
        plain = bytes(rng.choice((9, 1000, 40_000_000)))
    elif kind == 1:
        plain = (bytes([rng.choice((0, 1, 5, 7, 200))]) + bytes(8)) * rng.choice((1, 1000, 300_000))
    else:
        plain = mutate_bytes(plain, rng)
    announced = rng.choice((len(plain), len(plain), len(plain), 0, 2**40, len(plain) + 1))
    compressed = zstandard.compress(plain)
    new = (
        body[:16]
        + struct.pack("<QI", announced, 0)
        + struct.pack("<I", 4)
        + b"zstd"
        + struct.pack("<Q", len(compressed))
        + compressed
    )
    return b"\x06" + struct.pack("<Q", len(new)) + new


def mutate_xml(data: bytes, rng: random.Random) -> bytes:
    """A robot description with attributes, elements or bytes changed."""
    if rng.random() < 0.25:
        return mutate_bytes(data, rng)
    text = data.decode()
    for _ in range(rng.choice((1, 1, 2, 4))):
        kind = rng.randrange(4)
        quoted = list(re.finditer(r'"([^"]*)"', text))
        elements = list(re.finditer(r"<[^<>]*/>", text))
        if kind <= 1 and quoted:
            a = rng.choice(quoted)
            new = rng.choice(
                (*WORDS, rng.choice(quoted)[1], "0 0 0", "1e400 0 0", "0 0", "revolute", "prismatic", "floating", "planar")
            )
            text = text[: a.start(1)] + new + text[a.end(1) :]
        elif kind == 2 and elements:
            a = rng.choice(elements)
            text = text[: a.start()] + rng.choice(("", a[0] * 2, rng.choice(elements)[0])) + text[a.end() :]
        else:
            i = rng.randrange(len(text))
            text = (
                text[:i]
                + rng.choice(("<link name='x'/>", "<a>" * 300, "<!DOCTYPE x [<!ENTITY a 'b'>]>", "&a;", "</robot>"))
                + text[i:]
            )
    return text.encode("utf-8", "replace")


def mutate_packets(data: bytes, rng: random.Random) -> bytes:
    """Packets of a controller, one a line: numbers, attributes, bytes changed; packets lost, doubled, exchanged."""
    if rng.random() < 0.3:
        return mutate_bytes(data, rng)
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 1, 2, 5))):
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        kind = rng.randrange(6)
        if kind == 0:
            lines[i] = lines[j]
        elif kind == 1 and len(lines) > 1:
            del lines[i]
        elif kind == 2:
            lines[i] = mutate_bytes(lines[i], rng)
        elif kind == 3:
            lines[i : i + 1] = [lines[i]] * rng.choice((2, 10))
        elif kind == 4:  # another time stamp, near or far
            ahead = rng.choice((4, -4, 40, -40, 400, 2**31, 2**32 - 4, -(2**32)))
            lines[i] = re.sub(rb"<IPOC>(\d+)", lambda m, a=ahead: b"<IPOC>%d" % (int(m[1]) + a), lines[i])
        else:
            numbers = list(re.finditer(rb'"[^"]*"', lines[i]))
            if numbers:
                n = rng.choice(numbers)
                lines[i] = lines[i][: n.start() + 1] + rng.choice(WORDS).encode() + lines[i][n.end() - 1 :]
    return b"\n".join(lines)


def mutate_formula(data: bytes, rng: random.Random) -> bytes:
    """A formula put together from pieces of formulas."""
    pieces = re.findall(r"\w+|\*\*|.", data.decode())
    extra = [
        *("(", ")", "**", "tau", "tau_9", "lambda", "__import__", ".", "1e999", "9" * 30, "0", "-", "[", "sqrt", "log", "if"),
        *(":", "axis 99:", "tool z:", "\x00", "\n", "(" * 200, "-" * 400, "x" * 600),
        *("min", ",", "q_1", "temp_a", "=", "'", "1j"),
    ]
    for _ in range(rng.choice((1, 2, 4))):
        i = rng.randrange(len(pieces) + 1)
        pieces[i : i + rng.randrange(3)] = rng.choices((*extra, *pieces), k=rng.randrange(3))
        if not pieces:
            return b""
    return "".join(pieces).encode()
