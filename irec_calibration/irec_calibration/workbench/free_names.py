# SPDX-License-Identifier: Apache-2.0
"""Names that nothing in a folder has yet: nothing that the workbench writes replaces what is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import IrecError
from ..files import not_written

MOST = 9999  # of one name


def free_path(folder: Path, stem: str, suffix: str) -> Path:
    """A file that was not there: stem.yaml, stem-2.yaml, ... It is made, empty. IrecError: none can be made."""
    folder.mkdir(parents=True, exist_ok=True)
    return _free(folder, stem, suffix, lambda path: path.touch(exist_ok=False))


def free_folder(root: Path, stem: str) -> Path:
    """A folder that was not there: stem, stem-2, ... It is made. IrecError: none can be made."""
    return _free(root, stem, "", lambda path: path.mkdir(parents=True))


def _free(folder: Path, stem: str, suffix: str, make: Callable[[Path], None]) -> Path:
    for n in range(1, MOST + 1):
        path = folder / (f"{stem}{suffix}" if n == 1 else f"{stem}-{n}{suffix}")
        try:
            make(path)
        except FileExistsError:
            continue
        except OSError as error:
            raise IrecError(not_written(path, error)) from error
        return path
    raise IrecError(f"{folder}: there are {MOST} of the name {stem}{suffix} already")
