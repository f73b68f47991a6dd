# SPDX-License-Identifier: Apache-2.0
"""`irec links BAG -o links.csv`: what secondary encoders read on a course without process, for `links.file` of the correction."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..errors import RecordingError
from ..files import check_replaceable, write_file
from ..files.outputs import beginning
from ..sensors.dry_drive import LINK, DryDriveTable, read_dry_drive


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bag", type=Path, help="recording of the course, driven without process")
    parser.add_argument("-o", "--output", type=Path, default=Path("links.csv"), help="table (default: links.csv)")
    parser.add_argument("--joints", default="joint_states", metavar="TOPIC", help="motor-side angles (default: joint_states)")
    parser.add_argument("--links", default="link_states", metavar="TOPIC", help="link-side angles (default: link_states)")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """0: written."""
    found = read_dry_drive(args.bag, args.joints, args.links)
    write_table(args.output, found)
    windup = found.link - found.q
    figures = {n: [float(w.min()), float(w.max())] for n, w in zip(found.names, windup.T, strict=True)}
    if args.json:
        print(json.dumps({"windup_rad": figures, "rows": len(found.q), "table": str(args.output)}, indent=2))
        return 0
    for name, (low, high) in figures.items():
        print(f"{name}: {1e3 * low:+.3f} to {1e3 * high:+.3f} mrad between both sides without process")
    print(
        f"{len(found.q)} rows of {found.samples} samples; written: {args.output}\n"
        f"for the correction: links.topic: {args.links}, links.file: {args.output}"
    )
    return 0


def write_table(path: Path, table: DryDriveTable) -> None:
    """The table that `links.file` names: a column for each joint [rad], and `link_` before its name, link-side [rad]."""
    rows = [",".join([*table.names, *(LINK + n for n in table.names)])]
    rows += [",".join(f"{x:.9g}" for x in (*q, *link)) for q, link in zip(table.q, table.link, strict=True)]
    check_replaceable(path, "a table of these joints", (beginning(rows[0]),), RecordingError)
    write_file(path, "\n".join(rows) + "\n", error=RecordingError)
