# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes that are ended whatever happens."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType

_PR_SET_PDEATHSIG = 1  # <linux/prctl.h>
_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
GRACE = ((signal.SIGTERM, 20.0), (signal.SIGKILL, 5.0))  # s to obey each


class NodeEnded(RuntimeError):
    """A node has ended by itself; the message holds the end of its log."""


class Processes:
    """Starts nodes, each in a process group of its own and with a log file; ends them all when left."""

    def __init__(self, log_folder: Path, environment: dict[str, str]) -> None:
        self._folder, self._environment = log_folder, {**os.environ, **environment}
        self._folder.mkdir(parents=True, exist_ok=True)
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, module: str, parameters: dict[str, object], remaps: dict[str, str] | None = None) -> None:
        """Run `python -m module` with ROS parameters; its output goes to <log_folder>/<name>.log."""
        arguments = [sys.executable, "-m", module, "--ros-args"]
        for key, value in parameters.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            arguments += ["-p", f"{key}:={text}"]
        for key, value in (remaps or {}).items():
            arguments += ["-r", f"{key}:={value}"]
        with open(self._folder / f"{name}.log", "wb") as log:
            self._running[name] = subprocess.Popen(
                arguments,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
                preexec_fn=die_with_parent,
            )

    def check(self) -> None:
        """Raise NodeEnded if a node has ended."""
        for name, process in self._running.items():
            if process.poll() is not None:
                raise NodeEnded(f"{name} ended with code {process.returncode}; end of its log:\n{self.tail(name)}")

    def tail(self, name: str, lines: int = 15) -> str:
        """Last lines of a node's log."""
        text = (self._folder / f"{name}.log").read_text(errors="replace")
        return "\n".join(text.splitlines()[-lines:])

    def end(self, name: str) -> None:
        """End one node: SIGTERM, then harder."""
        process = self._running.pop(name, None)
        if process is not None:
            _end([process])

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        _end(list(self._running.values()))
        self._running.clear()


def die_with_parent() -> None:
    """In a process that was just started: end, in order, when the one that started it is killed and can't end it."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)


def _end(processes: list[subprocess.Popen[bytes]]) -> None:
    for number, patience in GRACE:
        alive = [p for p in processes if p.poll() is None]
        for process in alive:
            try:
                os.killpg(process.pid, number)  # its own group: it was started in a session of its own
            except ProcessLookupError:
                pass
        deadline = time.monotonic() + patience
        while any(p.poll() is None for p in alive) and time.monotonic() < deadline:
            time.sleep(0.05)
