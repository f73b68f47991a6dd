# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that nobody else on this machine uses: two demos at once must not hear each other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from pathlib import Path
from typing import IO

FIRST, LAST = 10, 59  # the tests use 60 to 99; from 101 on ports collide with those that Linux hands out
PORTS = 7400, 250  # UDP ports of DDS: the first of domain 0, and how many each domain has
_held: list[IO[str]] = []  # locks last as long as this process


def in_use(domain: int) -> bool:
    """Whether a process of this machine talks in a domain, with or without its lock, such as one that a killed run has left."""
    first = PORTS[0] + PORTS[1] * domain
    ports = (int(line.split()[1].split(":")[1], 16) for line in Path("/proc/net/udp").read_text().splitlines()[1:])
    return any(first <= port < first + PORTS[1] for port in ports)


def take_domain(first: int, last: int) -> tuple[int, IO[str]]:
    """A domain id that nobody on this machine uses, and its lock, which holds while it is open.

    Raises:
        ValueError: all of first to last are taken.
    """
    for domain in range(first, last + 1):
        path = Path(tempfile.gettempdir()) / f"irec-ros-domain-{domain}.lock"
        try:  # anybody may make a file, or a link to a file of ours, of this name there first
            lock = open(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644), "r+")
        except OSError:  # somebody else's
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        if not in_use(domain):
            return domain, lock
        lock.close()
    raise ValueError(f"no free ROS domain between {first} and {last}; other demos or tests are running")


def free_domain() -> int:
    """A domain id, locked until this process ends. ValueError: all are taken."""
    domain, lock = take_domain(FIRST, LAST)
    _held.append(lock)
    return domain
