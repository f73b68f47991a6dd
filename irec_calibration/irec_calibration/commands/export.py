# SPDX-License-Identifier: Apache-2.0
"""`irec export SESSION -o FOLDER`: a session in either form to a table."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..errors import SessionError
from ..session import read_session, write_table


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="MCAP file, rosbag2 folder or folder of a table")
    parser.add_argument("-o", "--output", required=True, help="folder for session.yaml, samples.csv and robot.urdf")
    parser.add_argument("--json", action="store_true", help="machine-readable summary on standard output")


def run(args: argparse.Namespace) -> int:
    session = read_session(args.session)
    output = Path(args.output)
    if output.resolve() == Path(args.session).resolve():
        raise SessionError(f"{output}: is the session itself; name another folder")
    folder = write_table(session, output)
    if args.json:
        summary = {"session": str(folder), "poses": len(session.poses), "rows": len(session), "notes": list(session.notes)}
        print(json.dumps(summary))
    else:
        for note in session.notes:
            print(f"note: {note}")
        print(f"{len(session.poses)} poses, {len(session)} rows; wrote {folder}")
    return 0
