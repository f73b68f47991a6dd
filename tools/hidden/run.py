# SPDX-License-Identifier: Apache-2.0
"""Run the tool blind on a matrix of sessions: it sees DIR/sessions and DIR/validation and never the truth.

    python tools/hidden/run.py DIR -o OUT [--processes 2] [--only NAME ...] [--minutes 6]

For each session OUT/<name>/ gets what `irec improve` leaves (without figures), what its model predicts for the validation
session (model.csv), and timing.json; or error.txt, where a command failed.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import sys
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any


def _refuse_truth(event: str, args: tuple[Any, ...]) -> None:
    """An audit hook: no file of a truth folder may be opened by the process that runs the tool."""
    if event == "open" and args and isinstance(args[0], (str, bytes)) and "-truth" in os.fsdecode(args[0]):
        raise PermissionError(f"{os.fsdecode(args[0])}: the truth is not for the tool")


def blindfold() -> None:
    """Let this process open no truth file any more, and draw no figures."""
    sys.addaudithook(_refuse_truth)
    sys.modules["matplotlib"] = None  # type: ignore[assignment]


def one(folder: Path, name: str, out: Path) -> str:
    """Diagnose, improve and predict one session by the commands that people use; returns a line for the terminal."""
    from irec_calibration.cli import main as irec

    there = out / name
    there.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            improved = irec(["improve", str(folder / "sessions" / name), "-o", str(there)])
            seconds = time.perf_counter() - began
            if improved > 1:
                raise RuntimeError(f"irec improve ended with {improved}")
            validation = str(folder / "validation" / name)
            if irec(["predict", str(there / "model.yaml"), validation, "-o", str(there / "model.csv")]):
                raise RuntimeError("irec predict failed")
    except Exception:  # whatever goes wrong in the tool is a result of the run, not its end
        (there / "error.txt").write_text(said.getvalue() + traceback.format_exc(), encoding="utf-8")
        return f"{name}: FAILED, see {there / 'error.txt'}"
    (there / "timing.json").write_text(json.dumps({"improve_s": seconds}), encoding="utf-8")
    return f"{name}: {seconds:.1f} s"


def main() -> int:
    parser = argparse.ArgumentParser(description="Run irec blind on a matrix of sessions.")
    parser.add_argument("matrix", type=Path, help="folder with sessions/ and validation/")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=[], help="names of sessions (default: all)")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no session after that; the next run continues")
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    names = args.only or sorted(p.name for p in (args.matrix / "sessions").iterdir())
    todo = [n for n in names if not (args.output / n / "timing.json").exists()]
    began = time.perf_counter()
    with ProcessPoolExecutor(args.processes, initializer=blindfold) as pool:
        futures = [pool.submit(one, args.matrix, n, args.output) for n in todo]
        for i, future in enumerate(as_completed(futures), 1):
            if future.cancelled():
                continue
            left = (time.perf_counter() - began) / i * (len(todo) - i)
            print(f"[{i}/{len(todo)}] {future.result()}, about {left / 60:.0f} min left", flush=True)
            if time.perf_counter() - began > 60.0 * args.minutes:
                for f in futures:
                    f.cancel()
    return 0


if __name__ == "__main__":
    sys.exit(main())
