# SPDX-License-Identifier: Apache-2.0
"""Limits on what a recording of a few bytes may make of itself: chunks that inflate, message definitions that loop."""

from __future__ import annotations

import re
from io import BytesIO

import zstandard
from mcap.records import Chunk

try:
    import lz4.frame as lz4_frame
except ImportError:  # rosbag2 writes zstd unless told otherwise
    lz4_frame = None

LARGEST_CHUNK = 512 * 1024 * 1024  # bytes; rosbag2 writes 768 KiB, large images a few hundred MiB
SMALLEST_LIMIT = 1024 * 1024
LARGEST_RATIO = 1000  # real messages compress by 2 to 50, constant ones by a few hundred
LONGEST_DEFINITION = 1_000_000  # characters
LONGEST_ARRAY = 10_000_000


def unpacked(chunk: Chunk) -> bytes:
    """The records of a chunk.

    Raises ValueError: unknown compression, or it inflates beyond its own size, beyond 1000 times what is stored or 512 MiB.
    """
    limit = min(LARGEST_CHUNK, max(SMALLEST_LIMIT, LARGEST_RATIO * len(chunk.data)))
    if chunk.uncompressed_size > limit:
        raise ValueError(f"it would inflate from {len(chunk.data)} to {chunk.uncompressed_size} bytes, at most {limit} are read")
    wanted = chunk.uncompressed_size
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(BytesIO(chunk.data)).read(wanted + 1)
    elif chunk.compression == "lz4":
        if lz4_frame is None:
            raise ValueError("it is compressed by lz4: pip install lz4")
        data = lz4_frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=wanted + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r} is not known")
    if len(data) != wanted:
        more = "more" if len(data) > wanted else f"{len(data)}"
        raise ValueError(f"it holds {more} bytes, {wanted} are announced")
    return bytes(data)


def check_definition(data: bytes) -> None:
    """Refuse a message definition (ros2msg) whose decoding need not end.

    Raises ValueError: too long, an array of fixed length beyond any message, or an array of a type without fields, whose
    length nothing bounds.
    """
    text = data.decode("utf-8", "replace")
    if len(text) > LONGEST_DEFINITION:
        raise ValueError(f"its definition has {len(text)} characters")
    bodies = re.split(r"^=+\n", text, flags=re.MULTILINE)
    fields: dict[str, list[tuple[str, str]]] = {}
    for i, body in enumerate(bodies):
        name = ""
        found: list[tuple[str, str]] = []
        for line in body.splitlines():
            code = line.split("#", 1)[0].strip()
            if i and not name and code.startswith("MSG:"):
                name = code[4:].strip().replace("/msg/", "/")
                continue
            match = re.match(r"([\w/]+)((?:<=\d+)?(?:\[[^\]]*\])?)\s+\w+(?!.*=(?!=))", code)
            if match:
                found.append((match[1].replace("/msg/", "/"), match[2]))
            for number in re.findall(r"\[(?:<=)?(\d+)\]", code):
                if int(number[:12]) > LONGEST_ARRAY:
                    raise ValueError(f"its definition holds an array of {number[:20]} values")
        fields[name] = found
    empty = {name.rsplit("/", 1)[-1] for name, found in fields.items() if not found}
    for found in fields.values():
        for type_name, array in found:
            if "[" in array and type_name.rsplit("/", 1)[-1] in empty:
                raise ValueError(f"its definition holds an array of {type_name}, which has no fields")
