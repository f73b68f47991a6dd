# SPDX-License-Identifier: Apache-2.0
"""Faults at each phase of procedure and correction, with real processes.

`python tools/faults/fault_matrix.py [--only PATTERN] [--part K/N]`

Goes on where it was stopped (out/faults/results.jsonl; --fresh begins anew). Exit 1 where a combination failed.
"""

from __future__ import annotations

import argparse
import fnmatch
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from catalogue import CORRECTION_FAULTS, CORRECTION_PHASES, FAULTS, PHASES, SOLVE_FAULTS  # noqa: E402
from demo_parts.domain import free_domain  # noqa: E402
from table import Results, Row, page  # noqa: E402


def everything() -> list[tuple[str, str, str]]:
    """(side, fault, phase), breadth first: each fault and each phase of a side comes before any fault comes again."""
    return [
        *(("procedure", fault, phase) for fault, phase in _breadth_first([f.name for f in FAULTS], list(PHASES))),
        *(("solve", fault, "solve") for fault in SOLVE_FAULTS),
        *(("correction", fault, phase)
          for fault, phase in _breadth_first([f.name for f in CORRECTION_FAULTS], list(CORRECTION_PHASES))),
    ]  # fmt: skip


def _breadth_first(faults: list[str], phases: list[str]) -> list[tuple[str, str]]:
    """Every pair once; round by round each fault, at a phase one further on than that of the fault before it."""
    n = len(phases)
    return [(fault, phases[(i + turn) % n]) for turn in range(n) for i, fault in enumerate(faults)]


def chosen(only: Sequence[str], part: str) -> list[tuple[str, str, str]]:
    """Those that match one of the patterns (with `*`, or a piece of side/fault/phase), and of them the K-th of N parts."""
    found = [c for c in everything() if not only or any(fnmatch.fnmatch("/".join(c), o) or o in "/".join(c) for o in only)]
    if part:
        k, n = (int(v) for v in part.split("/"))
        found = found[(k - 1) * len(found) // n : k * len(found) // n]
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[], help="patterns of side/fault/phase, e.g. 'procedure/force*/pressing'")
    parser.add_argument("--part", default="", help="K/N: the K-th of N parts of what is chosen")
    parser.add_argument("--seconds", type=float, default=0.0, help="begin no combination after so many seconds; 0: no limit")
    parser.add_argument("--fresh", action="store_true", help="try again what was tried before")
    parser.add_argument("--failed", action="store_true", help="try again what failed before")
    parser.add_argument("--out", type=Path, default=Path("out/faults"), help="logs, recordings and results")
    parser.add_argument("--page", type=Path, help="write the table of all results there")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(3))
    results = Results(args.out / "results.jsonl")
    work = [c for c in chosen(args.only, args.part)
            if args.fresh or "/".join(c) not in results.rows or (args.failed and results.rows["/".join(c)].failures)]  # fmt: skip
    tried = _run(work, args.out.absolute(), results, args.seconds)
    known = {"/".join(c) for c in everything()}
    rows = sorted((r for r in results.rows.values() if r.key in known), key=_place)
    if args.page:
        args.page.write_text(page(rows, len(known)))
    failed = [r for r in tried if r.failures]
    print(f"{len(tried)} combinations, {len(failed)} failed; {len(rows)} of {len(known)} in {args.out}/results.jsonl")
    return 1 if failed else 0


def _place(row: Row) -> tuple[int, int, int]:
    """Where it stands on the page: fault by fault, phase by phase."""
    if row.side == "solve":
        return 1, SOLVE_FAULTS.index(row.fault), 0
    faults, phases = (FAULTS, PHASES) if row.side == "procedure" else (CORRECTION_FAULTS, CORRECTION_PHASES)
    return 2 * (row.side == "correction"), [f.name for f in faults].index(row.fault), list(phases).index(row.phase)


def _run(work: list[tuple[str, str, str]], folder: Path, results: Results, seconds: float) -> list[Row]:
    if not work:
        return []
    from sides import Sides

    end = time.monotonic() + seconds if seconds else float("inf")
    tried: list[Row] = []
    print(f"{len(work)} combinations", flush=True)
    sides = Sides(folder, free_domain())
    try:
        for combination in work:
            if time.monotonic() > end:
                break
            began = time.monotonic()
            row = sides.run(*combination)
            row.seconds = round(time.monotonic() - began, 1)
            results.add(row)
            tried.append(row)
            left = (len(work) - len(tried)) * (sum(r.seconds for r in tried) / len(tried))
            mark = f"FAILED: {'; '.join(row.failures)}" if row.failures else "held"
            print(f"{row.key:<42} {row.seconds:5.1f} s  {row.robot:<24} {mark}  ({left / 60:.0f} min left)", flush=True)
    finally:
        sides.close()
    return tried


if __name__ == "__main__":
    sys.exit(main())
