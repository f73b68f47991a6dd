# SPDX-License-Identifier: Apache-2.0
"""What may be written where a file is already: the same kind of file again, and nothing that the same command reads.

A recording, a cell file, a session cost hours and have no copy. Who names one of them as the place to write to has mistyped.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from ..errors import IrecError
from .writing import not_written

HEAD = 4096  # bytes that tell what a file is
PICTURES = (rb"\A\x89PNG", rb"\A%PDF", rb"<svg")  # patterns of their heads, as `kinds` of check_replaceable
TAPS = (rb"\A(?!pose,|stamp,)[^\n]*force_x,force_y,force_z",)  # of a filter's table, which may name joints first


def of_format(text: str) -> bytes:
    """Pattern of a YAML document of irec: `irec-model/1` of any version."""
    return rb"(?m)^[\"']?format[\"']?\s*:\s*[\"']?" + re.escape(text.partition("/")[0].encode()) + rb"/"


def beginning(text: str) -> bytes:
    """Pattern of a file whose first line begins with these words: the first names of a table."""
    return rb"\A" + re.escape(text.encode())


def check_replaceable(path: str | Path, what: str, kinds: Iterable[bytes], error: type[IrecError] = IrecError) -> Path:
    """Refuse to write over a file of another kind; an empty one may be replaced.

    Args:
        path: of the file to be written. what: it will be, for people. kinds: regular expressions, one of which is found in the
            first 4 kB of such a file.

    Raises:
        IrecError: of the class `error`; what is there is something else, a folder, or can't be read.
    """
    path = Path(path)
    try:
        if not os.path.lexists(path):
            return path
        if path.is_dir():
            raise error(f"{path}: is a folder, {what} is to be written there; name a file")
        if path.exists() and not path.is_file():
            raise error(f"{path}: is not a regular file, {what} is to be written there; name another file")
        with path.open("rb") as file:
            head = file.read(HEAD)
    except FileNotFoundError:  # a link to nothing
        return path
    except (OSError, ValueError) as reason:
        raise error(not_written(path, reason, what)) from reason
    if head and not any(re.search(kind, head) for kind in kinds):
        raise error(f"{path}: exists and is not {what}; it is never overwritten by one: name another file")
    return path


def check_no_input(path: str | Path, inputs: Iterable[object], error: type[IrecError] = IrecError) -> None:
    """Refuse to write over a file that is read. Args: inputs: paths; what is no path of a file that exists is no input.

    Raises:
        IrecError: of the class `error`.
    """
    path = Path(path)
    for given in inputs:
        try:
            same = isinstance(given, (str, Path)) and bool(str(given)) and Path(given).is_file() and path.samefile(given)
        except (OSError, ValueError):  # one of the two is not there
            continue
        if same:
            raise error(f"{path}: is read by this command and would be overwritten; name another file to write to")
