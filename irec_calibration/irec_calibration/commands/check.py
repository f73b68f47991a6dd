# SPDX-License-Identifier: Apache-2.0
"""`irec check FILE...`: everything that is wrong in files of ours, by the code that reads them, before a program starts."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from ..errors import IrecError, SessionError
from ..files.document import one_line
from ..files.regular import read_text
from ..files.schema import format_names
from ..files.yaml_text import YamlProblem, parse_yaml
from ..session import is_bag, read_session


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        nargs="+",
        help="cell, poses, session (folder, session.yaml, MCAP or rosbag2 folder), model, truth, profile, diagnosis,"
        " journal or run file; the key `format` says which",
    )
    parser.add_argument("--json", action="store_true", help="machine-readable findings on standard output")


def run(args: argparse.Namespace) -> int:
    """0: nothing wrong; 2: something is."""
    found = [check_file(Path(name)) for name in args.file]
    if args.json:
        print(json.dumps({"files": found}, indent=2))
    else:
        for entry in found:
            for line in entry["problems"]:
                print(line)
            for line in entry["notes"]:
                print(f"{entry['file']}: note: {line}")
            if not entry["problems"]:
                print(f"{entry['file']}: {entry['format']}: nothing wrong")
    return 2 if any(entry["problems"] for entry in found) else 0


def check_file(path: Path) -> dict[str, Any]:
    """file, format, problems (one line each, naming the file) and notes of one file."""
    entry: dict[str, Any] = {"file": str(path), "format": "", "problems": [], "notes": []}
    try:
        entry["format"], check = _kind(path)
        problems, notes = check(path)
        entry["problems"], entry["notes"] = [one_line(p) for p in problems], [one_line(n) for n in notes]
    except IrecError as error:
        entry["problems"] = list(map(one_line, error.problems or (str(error),)))
    entry["problems"] = [p if str(path) in p else f"{path}: {p}" for p in entry["problems"]]
    return entry


Check = Callable[[Path], tuple[list[str], list[str]]]


def _kind(path: Path) -> tuple[str, Check]:
    """The format of a file, and the function that checks it.

    Raises IrecError: none of ours.
    """
    if path.is_dir() or is_bag(path) or path.name == "samples.csv":
        return "irec-session/1", _session
    if path.suffix.lower() in (".urdf", ".xml"):
        return "URDF", _urdf
    if path.suffix == ".jsonl":
        return "irec-journal/1", _journal
    text = read_text(path, "file")
    try:
        data = parse_yaml(text)[0]
    except YamlProblem as problem:
        raise IrecError(f"{path}:{problem.line}: {problem.text}") from None
    stated = str(data.get("format", "")) if isinstance(data, dict) else ""
    format_ = next((name for name in _CHECKS if stated == name or stated.startswith(f"{name}.")), None)
    if format_ is not None:
        return format_, _CHECKS[format_]
    others = {point.name: point for point in entry_points(group="irec.formats")}  # files of other packages
    if stated in others:
        return stated, lambda p: (others[stated].load()(p), [])
    known = ", ".join(sorted({*_CHECKS, *others}))
    is_ = repr(stated) if stated else "not stated"
    raise IrecError(f"{path}: format is {is_}; checked are {known}, robot descriptions (.urdf) and recordings")


def _cell(path: Path) -> tuple[list[str], list[str]]:
    """The cell file, what it names, and whether the three belong together."""
    from ..cell import read_cell
    from ..poses.check import cell_problems
    from ..procedure.scale import scale_notes

    problems, notes = cell_problems(path)
    return problems, notes if problems else [*notes, *scale_notes(read_cell(path))]


def _poses(path: Path) -> tuple[list[str], list[str]]:
    from ..poses.store import read_poses

    read_poses(path)
    return [], []


def _model(path: Path) -> tuple[list[str], list[str]]:
    from ..model.file import model_problems

    return model_problems(path), []


def _session(path: Path) -> tuple[list[str], list[str]]:
    from ..recording import BagReader
    from ..recording.survey import clocks_apart, survey
    from ..session.plausible import judged

    if path.name in ("samples.csv", "session.yaml"):
        path = path.parent
    if path.is_dir() and (path / "session.yaml").is_file():
        from ..session.header import read_header

        header = read_header(path / "session.yaml")  # says all that is wrong in it, and the table only its first
        if not (path / "samples.csv").exists():
            return [f"{path}: samples.csv is not there beside session.yaml of {header.name}"], []
    session = read_session(path)
    doubts, notes = judged(session)
    apart = [] if (path / "session.yaml").is_file() else clocks_apart(survey(BagReader(path)).topics)
    return [*apart, *(f"implausible: {doubt}" for doubt in doubts)], [*session.notes, *notes]


def _urdf(path: Path) -> tuple[list[str], list[str]]:
    from ..robot import Robot

    robot = Robot.from_urdf(path)
    return [], [f"{robot.n_joints} joints from base_link to tool0: {', '.join(robot.joint_names)}"]


def _profile(format_: str) -> Check:
    def check(path: Path) -> tuple[list[str], list[str]]:
        from ..files import open_document

        document = open_document(path, format_, "profile", SessionError)
        if document.sound("session", "robot", "urdf"):
            urdf = path.parent / document.data["session"]["robot"]["urdf"]
            try:
                _urdf(urdf)
            except IrecError as error:
                document.wrong(("session", "robot", "urdf"), f"can't be used: {error}")
        return [str(p) for p in document.problems], []

    return check


def _journal(path: Path) -> tuple[list[str], list[str]]:
    """The chain of hashes, and the files of all calibrations that it names."""
    from ..recertification.store import changed_files

    read, changed = changed_files(path)
    notes = [f"{len(read.lines)} events"]
    if read.torn:
        notes.append(f"a line that was not written to its end ({read.torn} bytes) does not count")
    return changed, notes


def _plain(format_: str, what: str) -> Check:
    def check(path: Path) -> tuple[list[str], list[str]]:
        from ..files import open_document

        return [str(p) for p in open_document(path, format_, what, IrecError).problems], []

    return check


_CHECKS: dict[str, Check] = {
    "irec-cell/1": _cell,
    "irec-poses/1": _poses,
    "irec-model/1": _model,
    "irec-session/1": _session,
    "irec-import/1": _profile("irec-import/1"),
    "irec-align/1": _profile("irec-align/1"),
    "irec-joints/1": _plain("irec-joints/1", "profile"),
    "irec-diagnosis/1": _plain("irec-diagnosis/1", "diagnosis"),
    "irec-journal/1": _journal,
    "irec-run/1": _plain("irec-run/1", "state of a run"),
}
if missing := set(format_names()) - set(_CHECKS):  # a format with a schema is a format that can be checked
    raise RuntimeError(f"no check for {', '.join(sorted(missing))}")
