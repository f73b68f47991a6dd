# SPDX-License-Identifier: Apache-2.0
"""A stretch of the real correction node: `python tools/endurance/node.py [--seconds 600]`.

A scripted publisher in place of the cell at 250 Hz, with lost inputs, models swapped and faults acknowledged now and then:
memory, handles and threads of the node over time. Exit 1 where something certainly grows.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "faults")]

from correction_side import CorrectionSide  # noqa: E402
from demo_parts.domain import free_domain  # noqa: E402
from slopes import grows, sample, slopes  # noqa: E402
from stack import Stack  # noqa: E402

LIMITS = {"memory_kB": 4096.0, "handles": 4.0, "threads": 4.0}  # per hour: a stretch of minutes can't tell less
EVERY, EVENT = 1.0, 15.0  # s
EVENTS = ("joints gap", "swap", "force NaN", "swap")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--out", type=Path, default=Path("out/endurance"))
    args = parser.parse_args()
    stack = Stack(args.out.absolute(), free_domain())
    side = CorrectionSide(stack)
    samples, events = [], 0
    try:
        side.start()
        began = told = happened = time.monotonic()
        while (now := time.monotonic()) - began < args.seconds:
            stack.spin()
            side.forget()
            if now - told >= EVERY:
                told = now
                samples.append(sample((now - began) / 3600.0, stack.processes["correction"].pid))
            if now - happened >= EVENT:
                happened = now
                side.happen(EVENTS[events % len(EVENTS)])
                events += 1
    finally:
        side.close()
        stack.close()
    found = slopes(samples)
    print(f"{samples[-1].hours:.3f} h of the node in real time, {events} events")
    print(f"{samples[0].memory_kB / 1024:.1f} MB at first, {samples[-1].memory_kB / 1024:.1f} MB at last")
    for what, slope in found.items():
        print(f"  {what:<10} {slope}")
    bad = grows(found, LIMITS)
    print("; ".join(bad) or "nothing certainly grows")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
