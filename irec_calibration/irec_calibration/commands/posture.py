# SPDX-License-Identifier: Apache-2.0
"""`irec posture MODEL SESSION CELL`: how to turn the tool about its axis along a way, for the least deviation."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from ..cell import read_cell
from ..model.file import check_belongs, load_model
from ..poses.posture import Posture, in_line, stiffest, try_turns, way_of_course, way_of_table
from ..session import read_session


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("session", help="session that the model was identified from")
    parser.add_argument("cell", help="cell file: limits, tooling and, without --way, its course")
    parser.add_argument(
        "--way", type=Path, metavar="TABLE", help="points, tool axes and forces in base_link (see docs/case-studies.md)"
    )
    parser.add_argument(
        "--step", type=float, default=10.0, metavar="DEGREES", help="between two turns that are tried (default: 10)"
    )
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """0: told; 1: no turn is possible."""
    model, session, cell = load_model(args.model), read_session(args.session), read_cell(args.cell)
    check_belongs(model, session.robot, session.serial)
    way = way_of_table(args.way, session) if args.way else way_of_course(cell, session)
    step = min(max(abs(args.step), 1.0), 90.0)
    turns = np.radians(np.arange(0.0, 180.0 + 0.5 * step, step))
    found = try_turns(cell, session, model, way, [*-turns[:0:-1], *turns])
    best = stiffest(found)
    if args.json:
        print(
            json.dumps(
                {"best_turn_deg": None if best is None else _degrees(best), "turns": [_as_data(p) for p in found]}, indent=2
            )
        )
        return 0 if best is not None else 1
    print("turn about the tool's axis [deg]   predicted deviation [mm]: mean, max   way to a joint limit [deg]")
    for p in found:
        told = p.hindered or f"{1e3 * p.mean:8.3f} {1e3 * p.largest:8.3f}   {np.degrees(p.margin):8.1f}"
        print(f"{_degrees(p):8.0f}   {told}{'   <- least' if p is best else ''}")
    now = next(p for p in found if p.turn == 0.0)
    if best is None:
        print("no turn of the tool is possible along this way")
        return 1
    if not now.hindered:
        if joint := in_line(cell):
            print(f"the tool's axis is that of {joint}: turning the tool moves no other joint, and the arm stands as it stood")
        print(f"the least is {100.0 * (1.0 - best.mean / now.mean):.0f} % below how the tool is turned now")
    return 0


def _degrees(posture: Posture) -> float:
    return round(float(np.degrees(posture.turn)), 6)


def _as_data(p: Posture) -> dict[str, object]:
    figures = {"mean_m": p.mean, "max_m": p.largest, "joint_margin_rad": p.margin, "singular_value": p.singular}
    return {"turn_deg": _degrees(p), "hindered": p.hindered, **{k: v if np.isfinite(v) else None for k, v in figures.items()}}
