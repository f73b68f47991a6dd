# SPDX-License-Identifier: Apache-2.0
"""Progress with an honest estimate of the time left, on standard error."""

from __future__ import annotations

import sys
import time

SURE_AFTER = 0.3  # share done before an estimate is given at all: stages differ, and a guess from the first is wrong by ten
WIDTH = 100


class Progress:
    """Call it with the share done (0..1) and what is being done."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._on_terminal = sys.stderr.isatty()

    def __call__(self, share: float, what: str) -> None:
        end = "\n" if share >= 1.0 or not self._on_terminal else ""
        begin = "\r\033[K" if self._on_terminal else ""
        print(
            f"{begin}{self.line(share, what, time.monotonic() - self._began)}"[: WIDTH + len(begin)],
            end=end,
            file=sys.stderr,
            flush=True,
        )

    @staticmethod
    def line(share: float, what: str, spent: float) -> str:
        """One line; the time left is a range, since stages take their own time."""
        left = ""
        if SURE_AFTER < share < 1.0 and spent > 1.0:
            guess = spent * (1.0 - share) / share
            low, high = 0.5 * guess, 2.0 * guess
            left = f", {low:.0f} to {high:.0f} s left" if high >= 2.0 else ", nearly done"
        return (
            f"{100 * share:3.0f} %  {what}, {spent:.0f} s{left}"
            if share < 1.0
            else f"{100 * share:3.0f} %  {what} in {spent:.0f} s"
        )
