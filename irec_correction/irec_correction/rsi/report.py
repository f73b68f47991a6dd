# SPDX-License-Identifier: Apache-2.0
"""What the loop tells whoever watches, as one block of numbers in shared memory."""

from __future__ import annotations

from itertools import accumulate

from irec_calibration.typing import Array

from ..watchdog import Fault

# of the link, then of the chain (see correction.Counts); names are keys in /diagnostics
LINK_COUNTS = (
    "answered", "late_here", "late_at_controller", "lost", "foreign", "unreadable", "sessions", "duplicate",
    "out_of_sequence", "not_taken", "repeated", "unanswered",
)  # fmt: skip
CHAIN_COUNTS = ("ticks", "limited", "held", "late")
FAULTS = tuple(Fault)
KEPT = 4096  # latencies over which percentiles are taken
_SIZES = {
    "now": 1, "link": len(LINK_COUNTS), "chain": len(CHAIN_COUNTS), "faults": len(FAULTS),
    "translation": 3, "rotation": 3, "deflection": 3, "wrench": 6, "q": 6, "p_tcp": 3, "abc": 3, "external": 1, "state": 1,
}  # fmt: skip
_ENDS = list(accumulate(_SIZES.values()))
# name -> where in the block; times s (CLOCK_MONOTONIC), SI units, wrench in tool0, everything else in base_link
WHERE = {name: slice(end - size, end) for (name, size), end in zip(_SIZES.items(), _ENDS)}
REPORT_SIZE = _ENDS[-1]


def counts(values: Array) -> dict[str, int]:
    """Counters of link, chain and faults by name, from a whole block."""
    out = {n: int(v) for n, v in zip(LINK_COUNTS, values[WHERE["link"]])}
    out |= {n: int(v) for n, v in zip(CHAIN_COUNTS, values[WHERE["chain"]])}
    return out | {f"fault.{f.value}": int(v) for f, v in zip(FAULTS, values[WHERE["faults"]]) if v}
