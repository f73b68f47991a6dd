# SPDX-License-Identifier: Apache-2.0
"""`make case-afp`, `make case-machining`: the paper's two case studies on plants as hard as the real ones, beside its Table 1.

    python tools/case.py afp                 the case, 8 to 10 minutes on two free cores; interrupted, it goes on where it was
    python tools/case.py afp --every 4       only every fourth course
    python tools/case.py afp --no-nodes      calibration session generated directly, without ROS
    python tools/case.py afp --costs         what each cause of the hard plant costs alone
    python tools/case.py afp --ends          what other values of its assumptions give
    python tools/case.py tables              the tables of docs/case-studies.md, once both cases are done

Results go to out/case-afp: report.html, summary.json, session/, models, drives/.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
from pathlib import Path

from case_parts.costs import print_costs
from case_parts.ends import print_ends
from case_parts.jobs import ROOT, Case
from case_parts.story import run_case
from case_parts.tables import CALLED, print_tables
from irec_calibration.errors import IrecError
from irec_sim.errors import SimError


def main() -> int:
    """0: done and within the real cell's bands; 1: done, outside of them; 2: not possible; 130: interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case", choices=("afp", "machining", "tables"))
    parser.add_argument(
        "--out", type=Path, help="folder for results (default: out/case-NAME); tables: that holds both (default: out)"
    )
    parser.add_argument("--every", type=int, default=1, help="only every n-th course (default: all)")
    parser.add_argument("--processes", type=int, default=2, help="drives at the same time (default: 2)")
    parser.add_argument("--fresh", action="store_true", help="begin anew, whatever the folder holds")
    parser.add_argument("--no-budget", action="store_true", help="leave the error budget out")
    parser.add_argument("--no-nodes", action="store_true", help="generate the calibration session directly, without ROS")
    parser.add_argument("--ends", action="store_true", help="print what other values of assumptions give (fibre placement)")
    parser.add_argument("--costs", action="store_true", help="print what each cause of the hard plant costs alone")
    args = parser.parse_args()
    if args.ends and args.case != "afp":
        parser.error("--ends is about the plant of fibre placement: tools/case.py afp --ends")
    for number in (signal.SIGINT, signal.SIGTERM):  # also where SIGINT was ignored by who started this
        signal.signal(number, signal.default_int_handler)
    out = ROOT / "out"
    case = Case(args.case, (args.out or out / f"case-{args.case}").resolve(), max(1, args.every))
    try:
        if args.case == "tables":
            print_tables([Case(name, (args.out or out).resolve() / f"case-{name}") for name in CALLED], args.processes)
            return 0
        if args.fresh:
            shutil.rmtree(case.out, ignore_errors=True)
        case.out.mkdir(parents=True, exist_ok=True)
        if args.costs:
            print_costs(case, args.processes)
            return 0
        if args.ends:
            print_ends(case, args.processes)
            return 0
        return run_case(case, args.processes, not args.no_budget, not args.no_nodes)
    except (IrecError, SimError, OSError) as error:
        print(f"\ncase: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\ncase: interrupted; what is done is in {case.out}, the same command goes on from there", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
