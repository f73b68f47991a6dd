# SPDX-License-Identifier: Apache-2.0
"""A file that one process alone writes: locked while it does, and watched for being removed, replaced, cut or written to."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path
from types import ModuleType
from typing import IO, Any

from ..errors import RecordingError

try:
    import fcntl

    locks: ModuleType | None = fcntl
except ImportError:  # no POSIX system
    locks = None

UNLOCKABLE = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)  # file systems without locks
MOST_NAMES = 1000


class HeldFile:
    """The file behind an open file object.

    Attributes:
        change: sizes that were expected and found, once `is_changed` was true.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self.change = ""

    def lock(self, path: Path) -> None:
        """RecordingError where another process holds it. The lock ends with the file object, or the process."""
        lock(self._file, path)

    def written(self) -> None:
        """What was written so far is known to be of this process; call after each flush."""
        self._size = self._file.tell()

    def is_changed(self) -> bool:
        """Whether the size is another one than that which this process has written."""
        found = os.fstat(self._file.fileno()).st_size
        if found != self._size:
            self.change = f"{found} bytes, {self._size} were written"
        return found != self._size

    def has_gone(self, path: Path) -> bool:
        """Whether the name stands for no file, or for another one."""
        own = os.fstat(self._file.fileno())
        try:
            there = os.stat(path)
        except FileNotFoundError:
            return True
        return (own.st_ino, own.st_dev) != (there.st_ino, there.st_dev)

    def rescue(self, path: Path) -> Path | None:
        """Copy the content to a new file beside `path`; its name, or None where that is not possible."""
        for k in range(1, MOST_NAMES):
            target = path.with_name(f"{path.stem}_rescued_{k}{path.suffix}")
            try:
                with open(target, "xb") as copy:
                    self._file.seek(0)
                    shutil.copyfileobj(self._file, copy)
            except FileExistsError:
                continue
            except OSError:
                return None
            return target
        return None


def lock(file: IO[Any], path: Path) -> None:
    """Hold a file until it is closed.

    Raises:
        RecordingError: another process holds it.
    """
    held = f"{path} is being recorded by another process; wait until that has ended, or choose another name"
    if locks is None:
        return
    try:
        locks.flock(file, locks.LOCK_EX | locks.LOCK_NB)
    except BlockingIOError:
        raise RecordingError(held) from None
    except OSError as error:
        if error.errno not in UNLOCKABLE:
            raise
    if os.fstat(file.fileno()).st_ino != os.stat(path).st_ino:  # replaced in the moment before
        raise RecordingError(held)
