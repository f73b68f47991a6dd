# SPDX-License-Identifier: Apache-2.0
"""Progress with an estimate of the time left, on standard error."""

from __future__ import annotations

import sys
import time


class Progress:
    """Call it with the share done (0..1) and what is being done."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._on_terminal = sys.stderr.isatty()

    def __call__(self, share: float, what: str) -> None:
        spent = time.monotonic() - self._began
        left = f", about {spent * (1.0 - share) / share:.0f} s left" if 0.05 < share < 1.0 else ""
        end = "\n" if share >= 1.0 or not self._on_terminal else ""
        print(
            f"{chr(13) + chr(27) + '[K' if self._on_terminal else ''}{100 * share:3.0f} %  {what}{left}",
            end=end,
            file=sys.stderr,
            flush=True,
        )
