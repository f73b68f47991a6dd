# SPDX-License-Identifier: Apache-2.0
"""One line that says what is going on: rewritten on a terminal, printed now and then elsewhere."""

from __future__ import annotations

import sys
import time

QUIET_S = 5.0  # between lines where output is not a terminal


class Progress:
    """Keeps the time of each stage, for the summary."""

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._stage = ""
        self._stage_begun = self._begun
        self._printed = 0.0
        self._open_line = False
        self.wall_s: dict[str, float] = {}

    def stage(self, name: str, text: str) -> None:
        """Begin a stage; its wall time counts under `name`."""
        self._finish_stage()
        self._stage, self._stage_begun = name, time.monotonic()
        self.say(text)

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._clear()
        print(f"[{time.monotonic() - self._begun:5.1f} s] {text}", flush=True)
        self._printed = time.monotonic()

    def update(self, text: str) -> None:
        """Replace the present line (terminal), or print it if nothing was printed for a while."""
        line = f"[{time.monotonic() - self._begun:5.1f} s] {text}"
        if sys.stdout.isatty():
            self._clear()
            print(line[:118], end="", flush=True)
            self._open_line = True
        elif time.monotonic() - self._printed >= QUIET_S:
            print(line, flush=True)
            self._printed = time.monotonic()

    def finish(self) -> dict[str, float]:
        """Wall times by stage and `total`, s."""
        self._finish_stage()
        self.wall_s["total"] = time.monotonic() - self._begun
        return {name: round(seconds, 1) for name, seconds in self.wall_s.items()}

    def _finish_stage(self) -> None:
        if self._stage:
            self.wall_s[self._stage] = self.wall_s.get(self._stage, 0.0) + time.monotonic() - self._stage_begun
            self._stage = ""

    def _clear(self) -> None:
        if self._open_line:
            print("\r\x1b[K", end="")
            self._open_line = False
