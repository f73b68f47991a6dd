# SPDX-License-Identifier: Apache-2.0
"""Run the tool blind on a matrix of sessions: it sees DIR/sessions and DIR/validation and never the truth.

    python tools/hidden/run.py DIR -o OUT [--processes 2] [--only NAME ...]

For each session OUT/<name>/ gets what `irec improve` leaves (without figures), the 18-DOF model (base.yaml), the
predictions of both for the validation session (base.csv, model.csv), and timing.json.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from irec_calibration.cli import main as irec
from irec_calibration.diagnose import improve, write_json
from irec_calibration.identify import identify
from irec_calibration.model import EIGHTEEN_DOF, blank_model
from irec_calibration.model_file import save_model
from irec_calibration.provenance import model_of
from irec_calibration.session import read_session


def one(folder: Path, name: str, out: Path) -> str:
    """Diagnose, improve and predict one session; returns a line for the terminal."""
    there = out / name
    began = time.perf_counter()
    session = read_session(folder / "sessions" / name)
    ladder = improve(session)
    seconds = time.perf_counter() - began
    save_model(ladder.model, there / "model.yaml")
    write_json(ladder.to_json(), there / "ladder.json")
    write_json(ladder.before.to_json(), there / "diagnosis.json")
    save_model(model_of(identify(session, blank_model(EIGHTEEN_DOF))), there / "base.yaml")
    validation = str(folder / "validation" / name)
    with contextlib.redirect_stdout(io.StringIO()):
        codes = [
            irec(["predict", str(there / f"{m}.yaml"), validation, "-o", str(there / f"{m}.csv")]) for m in ("base", "model")
        ]
    if any(codes):
        raise SystemExit(f"{name}: irec predict ended with {codes}")
    (there / "timing.json").write_text(json.dumps({"improve_s": seconds}), encoding="utf-8")
    return f"{name}: {seconds:.1f} s"


def main() -> int:
    parser = argparse.ArgumentParser(description="Run irec blind on a matrix of sessions.")
    parser.add_argument("matrix", type=Path, help="folder with sessions/ and validation/")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=[], help="names of sessions (default: all)")
    args = parser.parse_args()
    names = args.only or sorted(p.name for p in (args.matrix / "sessions").iterdir())
    todo = [n for n in names if not (args.output / n / "timing.json").exists()]
    with ProcessPoolExecutor(args.processes) as pool:
        futures = [pool.submit(one, args.matrix, n, args.output) for n in todo]
        for i, future in enumerate(as_completed(futures), 1):
            print(f"[{i}/{len(todo)}] {future.result()}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
