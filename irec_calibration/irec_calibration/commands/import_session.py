# SPDX-License-Identifier: Apache-2.0
"""`irec import SESSION -o FILE.mcap`: a session in either form to MCAP; with `--profile` a foreign table, with `--map` a foreign
recording to a session."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from ..errors import RecordingError, SessionError
from ..session import Session, read_session, write_table
from ..session.align import align_bag, in_words
from ..session.foreign import import_table
from ..session.mcap_io import write_mcap
from ._session import check_no_session, tell_written


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of a table, MCAP file or rosbag2 folder")
    parser.add_argument("--profile", help="mapping file (irec-import/1) by which a foreign table is read")
    parser.add_argument("--map", help="mapping file (irec-align/1) by which a foreign recording (joints, tracker points) is read")
    parser.add_argument("--name", help="with --profile: name of the session (default: the profile's)")
    parser.add_argument("-o", "--output", required=True, help="MCAP file to write; a folder with --profile or --map")
    parser.add_argument("--json", action="store_true", help="machine-readable summary on standard output")


def run(args: argparse.Namespace) -> int:
    output = Path(args.output)
    check_no_session(output)
    if args.profile:
        return tell_written(import_table(args.profile, args.session, output, args.name), output, args.json)
    if args.map:
        return tell_written(_foreign_recording(Path(args.session), Path(args.map), output), output, args.json)
    if output.suffix != ".mcap":
        raise SessionError(f"{output}: the name of the output must end in .mcap (`irec export` writes tables)")
    session = read_session(args.session)
    write_mcap(session, output)
    return tell_written(session, output, args.json)


def _foreign_recording(bag: Path, mapping: Path, output: Path) -> Session:
    """A session from joint states and tracker points; SessionError says what keeps it from being one and where to look."""
    try:
        session, delay = align_bag(bag, mapping)
    except (SessionError, RecordingError) as error:
        raise SessionError(f"{error}; `irec inspect {bag}` says what the recording holds and lacks") from error
    session = replace(session, notes=(*in_words(delay), *session.notes))
    if output.suffix == ".mcap":
        write_mcap(session, output)
    else:
        write_table(session, output)
    return session
