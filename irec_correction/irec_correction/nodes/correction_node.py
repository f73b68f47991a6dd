# SPDX-License-Identifier: Apache-2.0
"""`correction_node`: sets the scheduling of the process, then starts the lifecycle node."""

from __future__ import annotations

import os
import sys

from ..realtime import prefer_thread


def main(args: list[str] | None = None) -> int:
    """Run the node; exit code. IREC_RT_PRIORITY: SCHED_FIFO priority of the process, 0 or unset: none."""
    text = os.environ.get("IREC_RT_PRIORITY", "") or "0"
    if not text.isdecimal() or int(text) > 99:
        print(f"correction_node: error: IREC_RT_PRIORITY is '{text}', 0 .. 99 is possible", file=sys.stderr)
        return 2
    priority = int(text)
    refused = prefer_thread(priority)
    from .correction_lifecycle import run  # after that, so that the threads of the middleware inherit it

    return run(args, priority, refused)


if __name__ == "__main__":
    sys.exit(main())
