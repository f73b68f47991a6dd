# SPDX-License-Identifier: Apache-2.0
"""Values between processes through shared memory: one writer, any number of readers, nobody waits.

A sequence number is odd while the writer is at work; a reader that sees it change reads again.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import tempfile
import uuid
from pathlib import Path

import numpy as np
from irec_calibration.typing import Array

from .errors import CorrectionError

# block of a force sensor: time (CLOCK_MONOTONIC, s), counter, status bits that are errors, wrench(6) in N and N m
WRENCH_SIZE = 9
_TRIES = 64
SAME_USER = "writer and reader have to run as the same user"


class SharedValues:
    """A block of float64 that is read and written as a whole. A value that was never written reads as zeros with `version` 0."""

    def __init__(self, name: str, memory: mmap.mmap, size: int, owner: bool) -> None:
        self.name = name
        self._memory, self._owner = memory, owner
        self._sequence = np.ndarray((1,), dtype=np.uint64, buffer=memory)
        self._values = np.ndarray((size,), dtype=np.float64, buffer=memory, offset=8)

    @classmethod
    def create(cls, size: int, name: str | None = None) -> SharedValues:
        """A new block of `size` numbers; one of that name that a dead process left is replaced.

        Raises:
            CorrectionError: a living process has a block of that name: its readers would read another cell's sensor.
        """
        name = name or f"irec_{uuid.uuid4().hex}"
        path = _path(name)
        try:
            _refuse_if_in_use(path)
            path.unlink(missing_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        except OSError as error:
            raise CorrectionError(f"shared memory '{name}' can't be made: {error.strerror}; {SAME_USER}") from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # lasts as long as the mapping, which has a duplicate
            os.ftruncate(descriptor, 8 * (size + 1))
            return cls(name, mmap.mmap(descriptor, 8 * (size + 1)), size, True)
        finally:
            os.close(descriptor)

    @classmethod
    def attach(cls, name: str, size: int) -> SharedValues:
        """A block that another process created. Raises CorrectionError where there is none or it has another size."""
        try:
            descriptor = os.open(_path(name), os.O_RDWR | os.O_NOFOLLOW)
        except FileNotFoundError as error:
            raise CorrectionError(f"shared memory '{name}' does not exist; start the process that writes it first") from error
        except OSError as error:
            raise CorrectionError(f"shared memory '{name}' can't be opened: {error.strerror}; {SAME_USER}") from error
        try:
            status = os.fstat(descriptor)
            if status.st_uid != os.geteuid() or status.st_mode & 0o022:  # anybody may make a file of this name there first
                raise CorrectionError(f"shared memory '{name}' can be written by another user (id {status.st_uid}); {SAME_USER}")
            found = status.st_size
            if found != 8 * (size + 1):
                raise CorrectionError(f"shared memory '{name}' has {found} bytes, {8 * (size + 1)} are needed; versions differ")
            return cls(name, mmap.mmap(descriptor, found), size, False)
        finally:
            os.close(descriptor)

    @property
    def version(self) -> int:
        """Grows by 2 with each write."""
        return int(self._sequence[0])

    @property
    def numbers(self) -> Array:
        """The values in place, for numbers each of which stands alone; not to be used after `close`."""
        return self._values

    def write(self, values: Array) -> None:
        """Replace all values, (size,)."""
        self._sequence[0] += 1
        self._values[:] = values
        self._sequence[0] += 1

    def read(self, into: Array) -> bool:
        """Copy all values, (size,). False where the writer stopped in the middle of writing; `into` is then not to be used."""
        for _ in range(_TRIES):
            before = int(self._sequence[0])
            into[:] = self._values
            if before % 2 == 0 and int(self._sequence[0]) == before:
                return True
        return False

    def close(self) -> None:
        """Let go of the block; its creator removes it."""
        del self._sequence, self._values
        self._memory.close()
        if self._owner:
            _path(self.name).unlink(missing_ok=True)


def _refuse_if_in_use(path: Path) -> None:
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
    except FileNotFoundError:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise CorrectionError(
            f"shared memory '{path.name}' belongs to another process that is running; give this one a name of its own"
            " (parameter 'block' of can_ft_node, 'wrench_block' of rsi_bridge)"
        ) from None
    finally:
        os.close(descriptor)


def _path(name: str) -> Path:
    if name in ("", "..") or Path(name).name != name or not name.isprintable():
        raise CorrectionError(f"shared memory is named {name!r:.80}; a plain name without '/' is needed")
    memory = Path("/dev/shm")
    return (memory if memory.is_dir() else Path(tempfile.gettempdir())) / name
