# SPDX-License-Identifier: Apache-2.0
"""`irec export SESSION -o FOLDER`: a session in either form to a table."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from ..errors import SessionError
from ..session import read_session, write_table
from ..session.align import align_bag, in_words
from ._session import check_no_session, tell_written


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="MCAP file, rosbag2 folder or folder of a table")
    parser.add_argument(
        "--profile", help="mapping file (irec-align/1) for a recording without load cases: joint states and tracker points"
    )
    parser.add_argument("-o", "--output", required=True, help="folder for session.yaml, samples.csv and robot.urdf")
    parser.add_argument("--json", action="store_true", help="machine-readable summary on standard output")


def run(args: argparse.Namespace) -> int:
    if args.profile:
        session, delay = align_bag(args.session, args.profile)
        session = replace(session, notes=(*in_words(delay), *session.notes))
    else:
        session = read_session(args.session)
    output = Path(args.output)
    if output.resolve() == Path(args.session).resolve():
        raise SessionError(f"{output}: is the session itself; name another folder")
    check_no_session(output)
    folder = write_table(session, output)
    return tell_written(session, folder, args.json)
