# SPDX-License-Identifier: Apache-2.0
"""`irec history`: the calibrations of a robot with their trend (CELL), or the versions that led to a model (MODEL)."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from ..cell import read_cell
from ..errors import IrecError
from ..files import check_replaceable, write_file
from ..files.outputs import PICTURES
from ..model.file import load_model
from ..recertification.store import Store, calibration_folder
from ..recertification.trend import trend
from ..recertification.verdict import Kind, kind_of


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("what", metavar="CELL|MODEL", help="cell file: all calibrations of its robot; model.yaml: its versions")
    parser.add_argument("--folder", default="", help="calibration folder (default: calibrations beside the cell file)")
    parser.add_argument("-o", "--output", help="with CELL: picture of the trend (PNG)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    try:
        is_cell = "irec-cell/" in Path(args.what).read_text(encoding="utf-8", errors="replace")[:4000]
    except OSError as error:
        raise IrecError(f"{args.what}: can't be read: {error.strerror}; name a cell file or a model.yaml") from error
    return _of_cell(args) if is_cell else _of_model(args)


def _of_cell(args: argparse.Namespace) -> int:
    cell = read_cell(args.what)
    store = Store(args.folder or calibration_folder(cell.path), cell.serial)
    entries, points = store.entries(), trend(store)
    if args.output and points:
        from ..report.certificate import trend_png  # draws: only when it is asked for

        check_replaceable(args.output, "a picture", PICTURES)
        write_file(args.output, trend_png(points))
    if args.json:
        print(json.dumps({"events": [asdict(e) for e in entries], "trend": [asdict(p) for p in points]}))
        return 0
    if not entries:
        print(f"{store.folder}: no calibration of {cell.serial} yet; the first one: ros2 action send_goal irec/recertify ...")
        return 0
    print(f"{cell.serial}, {store.folder}")
    for e in entries:
        event = e.event.replace("_", " ")
        verdict = f": {e.verdict}" if e.verdict and e.verdict != event else ""
        print(f"{e.at[:16]}  {event:13} {e.calibration or '-':5} by {e.by or '?'}{verdict}")
    print("\ncalibration  date        mean deflection at rated load  error on poses not used")
    for p in points:
        mark = "  in force" if p.in_force else f"  {p.verdict}" if kind_of(p.verdict) is Kind.INVESTIGATE else ""
        error = f"{1e6 * p.held_out_rms_m:6.1f} um" if p.held_out_rms_m == p.held_out_rms_m else "unknown"
        if p.event == "checked":
            axes = ", ".join(f"axis {k + 1} less than {100 * s:.0f} % softer" for k, s in sorted(p.softer_below.items()))
            print(f"{p.calibration:11}  {p.at[:10]}  confirmed by a check{f': {axes}' if axes else ''}")
            continue
        print(f"{p.calibration:11}  {p.at[:10]}  {1e3 * p.deflection_m:21.3f} mm      {error}{mark}")
    if args.output and points:
        print(f"trend: {args.output}")
    return 0


def _of_model(args: argparse.Namespace) -> int:
    model = load_model(args.what)
    if args.json:
        print(json.dumps(list(model.history)))
        return 0
    if not model.history:
        made = ", ".join(f"{k} {v}" for k, v in model.made.items())
        print(f"no earlier version is recorded; made: {made or 'unknown'}")
    for i, entry in enumerate(model.history, 1):
        cv = entry.get("cv_rms_m")
        error = f"{1e6 * cv:.1f} um on held-out poses" if isinstance(cv, (int, float)) else "held-out error unknown"
        print(
            f"{i}. {entry.get('date', '')}  {entry.get('change', '')}: {error}  [{', '.join(entry.get('effects', []))}] on "
            f"{entry.get('session', '')}"
        )
    return 0
