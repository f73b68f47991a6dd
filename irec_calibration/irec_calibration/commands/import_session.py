# SPDX-License-Identifier: Apache-2.0
"""`irec import SESSION -o FILE.mcap`: a session in either form to MCAP."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..errors import SessionError
from ..session import read_session
from ..session.mcap_io import write_mcap


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of a table, MCAP file or rosbag2 folder")
    parser.add_argument("-o", "--output", required=True, help="MCAP file to write")
    parser.add_argument("--json", action="store_true", help="machine-readable summary on standard output")


def run(args: argparse.Namespace) -> int:
    output = Path(args.output)
    if output.suffix != ".mcap":
        raise SessionError(f"{output}: the name of the output must end in .mcap (`irec export` writes tables)")
    session = read_session(args.session)
    write_mcap(session, output)
    if args.json:
        summary = {"session": str(output), "poses": len(session.poses), "rows": len(session), "notes": list(session.notes)}
        print(json.dumps(summary))
    else:
        for note in session.notes:
            print(f"note: {note}")
        print(f"{len(session.poses)} poses, {len(session)} rows; wrote {output}")
    return 0
