# SPDX-License-Identifier: Apache-2.0
"""`irec join SESSION MORE -o FOLDER`: several sessions of one robot as one."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import SessionError
from ..session import read_session, write_table
from ..session.join import GAP_S, joined
from ..session.table import read_table
from ._session import tell_written


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sessions", nargs="+", metavar="SESSION", help="two or more, as they were measured")
    parser.add_argument("--name", default="", help="of the new session (default: the names of all)")
    parser.add_argument("--gap", type=float, default=GAP_S, metavar="S", help=f"s from one to the next (default: {GAP_S:g})")
    parser.add_argument("-o", "--output", required=True, help="new folder for session.yaml, samples.csv and robot.urdf")
    parser.add_argument("--json", action="store_true", help="machine-readable summary on standard output")


def run(args: argparse.Namespace) -> int:
    output = Path(args.output)
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise SessionError(f"{output}: exists and is not empty; name another folder with -o")
    session = joined([read_session(path) for path in args.sessions], args.name, args.gap)
    folder = write_table(session, output)
    read_table(folder)  # what is written can be read
    return tell_written(session, folder, args.json)
