# SPDX-License-Identifier: Apache-2.0
"""`irec show-cell CELL`: a drawing of the cell in which a mistake is seen: robot, surface, stations, poses, sight lines."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..cell import read_cell
from ..poses.check import cell_problems
from ..poses.store import PoseList, read_poses
from ..report.cell_picture import save_cell_picture


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cell", type=Path, help="cell file")
    parser.add_argument("-o", "--output", type=Path, help="PNG, PDF or SVG (default: beside the cell file)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    """0: drawn; 2: the cell file can't be read. What is wrong but can be drawn is drawn and said."""
    cell = read_cell(args.cell)
    problems, notes = cell_problems(args.cell)
    poses: PoseList | None = read_poses(cell.poses_path) if cell.poses_path.exists() else None
    path, sights = save_cell_picture(cell, poses, args.output or args.cell.with_suffix(".png"))
    if args.json:
        print(json.dumps({"drawing": str(path), "problems": problems, "notes": notes, "sight_lines": list(sights)}))
        return 0
    for line in [*problems, *(f"note: {n}" for n in notes), *sights]:
        print(line)
    print(f"wrote {path}")
    return 0
