# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all; where one can't be written, the error says in one line which and why."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextvars import ContextVar
from itertools import takewhile
from pathlib import Path

from ..errors import IrecError
from .regular import one_line_path

_made: ContextVar[list[Path] | None] = ContextVar("_made", default=None)  # since `all_or_none` began


def not_written(path: str | Path, reason: BaseException, what: str = "") -> str:
    """The message for a file that can't be written. Args: what: the file will be, for people; empty where its name says it."""
    return f"{one_line_path(path)}: {what + ' ' if what else ''}can't be written: {getattr(reason, 'strerror', None) or reason}"


def write_file(path: str | Path, content: str | bytes, what: str = "", error: type[IrecError] = IrecError) -> Path:
    """Write a file in one step: what was there is whole until the new content (text as UTF-8) is whole, too.

    Its folder is made where it is not there. Libraries that write files themselves (matplotlib, numpy) write into a buffer first.

    Args:
        path: of the file. what: it will be, for the message. error: class of the error to raise.

    Raises:
        error: it can't be written; then nothing is left of it, and no folder that was made for it.
    """
    path = Path(path)
    part = path.with_name(path.name + ".part")
    made: list[Path] = []
    try:
        _make_folder(path.parent, made)
        if not os.path.lexists(path):
            made.append(path)
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(part, path)
    except OSError as reason:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        _remove(made)
        raise error(not_written(path, reason, what)) from reason
    together = _made.get()
    if together is not None:
        together += made
    return path


@contextlib.contextmanager
def all_or_none() -> Iterator[None]:
    """Around the writing of files that belong together: where it ends early, those that were not there before are removed again.

    Only what `write_file` has made in between is removed, never what was there or what others have put beside it.
    """
    made: list[Path] = []
    token = _made.set(made)
    try:
        yield
    except BaseException:
        _remove(made)
        raise
    finally:
        _made.reset(token)


def _make_folder(folder: Path, made: list[Path]) -> None:
    """Make a folder and those above it; `made` takes each that was not there. OSError."""
    missing = list(takewhile(lambda f: not f.exists(), (folder, *folder.parents)))
    for one in reversed(missing):
        one.mkdir(exist_ok=True)
        made.append(one)


def _remove(made: list[Path]) -> None:
    """Remove files, and folders that are empty then, the last made first; what can't be removed stays."""
    for path in reversed(made):
        with contextlib.suppress(OSError):
            if path.is_dir() and not path.is_symlink():
                path.rmdir()
            else:
                path.unlink(missing_ok=True)
