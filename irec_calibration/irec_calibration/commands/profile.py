# SPDX-License-Identifier: Apache-2.0
"""`irec profile BAG... -o profile.csv`: the force that is known along a course, for `preview.file` of the correction."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from ..errors import RecordingError
from ..files import check_replaceable, write_file
from ..files.outputs import beginning
from ..sensors.course_recording import RecordedCourse, read_course
from ..sensors.force_profile import HEAD, SMOOTH, TAIL, CommonForce, ForcedCourse, common_force, smoothed
from ..typing import Array


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("bag", type=Path, nargs="+", help="recordings of courses under the process, two or more")
    parser.add_argument("--course", type=Path, help="recording (dry is enough) of the course that it is for (default: the first)")
    parser.add_argument("-o", "--output", type=Path, default=Path("profile.csv"), help="table (default: profile.csv)")
    parser.add_argument("--head", type=float, default=HEAD, help=f"s at the begin that go by time (default: {HEAD:g})")
    parser.add_argument("--tail", type=float, default=TAIL, help=f"s at the end that go by time (default: {TAIL:g})")
    parser.add_argument("--smooth", type=float, default=SMOOTH, help=f"s over which it is smoothed (default: {SMOOTH:g})")
    parser.add_argument("--wrench", default="wrench", metavar="TOPIC", help="wrench at the TCP in tool0 (default: wrench)")
    parser.add_argument("--pose", default="tcp_pose", metavar="TOPIC", help="TCP by the controller (default: tcp_pose)")
    parser.add_argument("--joints", default="joint_states", metavar="TOPIC", help="joint states (default: joint_states)")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """0: written."""
    if len(args.bag) < 2:
        raise RecordingError("one recording does not tell what courses have in common; give two or more")
    for name, value in (("--head", args.head), ("--tail", args.tail)):
        if not 0.1 <= value <= 60.0:
            raise RecordingError(f"{name} is {value:g} s; 0.1 .. 60 s is possible")
    if not 0.0 <= args.smooth <= 1.0:
        raise RecordingError(f"--smooth is {args.smooth:g} s; 0 .. 1 s is possible")
    topics = args.wrench, args.pose, args.joints
    courses = [read_course(bag, *topics) for bag in args.bag]
    wanted = read_course(args.course, *topics, need_force=False) if args.course else courses[0]
    found = common_force([ForcedCourse(c.share, c.along_path()) for c in courses], wanted.period, args.head, args.tail)
    force = wanted.in_tool(smoothed(found.along(wanted.share, wanted.period), wanted.period, args.smooth))
    write_table(args.output, wanted, force)
    _tell(args, found, len(courses), float(np.linalg.norm(force, axis=1).max()))
    return 0


def write_table(path: Path, course: RecordedCourse, force: Array) -> None:
    """The table that `preview.file` names: stamp [s], joints [rad], force in tool0 [N]."""
    rows = [",".join(["stamp", *course.names, "force_x", "force_y", "force_z"])]
    for k, (q, f) in enumerate(zip(course.q, force, strict=True)):
        rows.append(",".join([f"{k * course.period:.6f}", *(f"{x:.9g}" for x in q), *(f"{x:.3f}" for x in f)]))
    check_replaceable(path, "a table of this course", (beginning(rows[0]),), RecordingError)
    write_file(path, "\n".join(rows) + "\n", error=RecordingError)


def _tell(args: argparse.Namespace, found: CommonForce, count: int, largest: float) -> None:
    slack = round(min(2.0 * found.spread, 0.2), 3)
    if args.json:
        figures = {"courses": count, "spread_s": found.spread, "left_n": found.left, "largest_n": largest, "slack_s": slack}
        print(json.dumps({**figures, "table": str(args.output)}, indent=2))
        return
    print(
        f"{count} courses have a force of up to {largest:.0f} N in common; {found.left:.0f} N RMS are not common\n"
        f"it comes {1e3 * found.spread:.0f} ms (one standard deviation) sooner or later from course to course\n"
        f"written: {args.output}\n"
        f"for the correction: preview.file: {args.output}, preview.slack: {slack:g}, preview.lead: as irec latency says"
    )
