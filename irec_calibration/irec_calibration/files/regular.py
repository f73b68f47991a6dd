# SPDX-License-Identifier: Apache-2.0
"""Bytes and text of files whose path stands in another file: never a device, never more than a stated size."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from ..errors import IrecError

MEGABYTE = 1_000_000
TEXT_LIMIT = 16 * MEGABYTE
URDF_LIMIT = 4 * MEGABYTE
TABLE_LIMIT = 500 * MEGABYTE


def read_bytes(path: str | Path, what: str, error: type[IrecError] = IrecError, limit: int = TEXT_LIMIT) -> bytes:
    """Content of a regular file.

    Args:
        path: file; a device, a pipe, a socket or a folder is refused, a link is followed.
        what: the kind of file, for messages.
        error: class of the error to raise.
        limit: largest size, bytes.

    Raises:
        error: not there, not readable, not a regular file, or too large; one line that names the file.
    """
    name = one_line_path(path)
    try:
        # without O_NONBLOCK opening a pipe that nobody writes to would wait for ever
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    except FileNotFoundError:
        raise error(f"{name}: the {what} is not there") from None
    except (OSError, ValueError) as cause:
        raise error(f"{name}: can't read the {what}: {getattr(cause, 'strerror', None) or cause}") from cause
    try:
        with os.fdopen(descriptor, "rb") as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise error(f"{name}: the {what} is {_kind(status.st_mode)}; a regular file is needed")
            if status.st_size > limit:
                raise error(f"{name}: the {what} has {status.st_size} bytes, at most {limit} are read; is it the right file?")
            data = file.read(status.st_size + 1)  # no more: memory is set aside for what is asked for
            if len(data) > status.st_size:  # it has grown, or is one whose size nobody knows
                data += file.read(limit + 1 - len(data))
    except OSError as cause:
        raise error(f"{name}: can't read the {what}: {cause.strerror}") from cause
    if len(data) > limit:
        raise error(f"{name}: the {what} grows beyond {limit} bytes while it is read; is it the right file?")
    return data


def read_text(path: str | Path, what: str, error: type[IrecError] = IrecError, limit: int = TEXT_LIMIT) -> str:
    """UTF-8 text of a regular file; see read_bytes."""
    data = read_bytes(path, what, error, limit)
    if data.startswith(b"PK\x03\x04"):
        raise error(f"{one_line_path(path)}: the {what} is a spreadsheet (.xlsx, .ods) or an archive; save it as text in UTF-8")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise error(f"{one_line_path(path)}: the {what} is UTF-16 text; save it as UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        line = data.count(b"\n", 0, cause.start) + 1
        raise error(
            f"{one_line_path(path)}:{line}: the {what} is no UTF-8 text (byte {cause.start} is 0x{data[cause.start]:02x});"
            " save it as UTF-8"
        ) from None


def is_there(path: str | Path) -> bool:
    """Whether a file or folder of this name exists; a name that no file can have is not there."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def one_line_path(path: str | Path) -> str:
    """A path as it can stand in a message: control characters and line ends in it are escaped."""
    text = str(path)
    return text if text.isprintable() else text.encode("unicode_escape").decode()


def _kind(mode: int) -> str:
    for test, name in (
        (stat.S_ISDIR, "a folder"), (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"), (stat.S_ISFIFO, "a pipe"),
        (stat.S_ISSOCK, "a socket"),
    ):  # fmt: skip
        if test(mode):
            return name
    return "no regular file"
