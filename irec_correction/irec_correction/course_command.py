# SPDX-License-Identifier: Apache-2.0
"""`irec course-filter MODEL CELL BAG... -o filter.csv`: a filter of each axis of the force, learnt on courses (`filter.file`)."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from irec_calibration.cell import Cell, read_cell
from irec_calibration.errors import RecordingError
from irec_calibration.model.file import check_belongs, load_model
from irec_calibration.typing import Array

from .conditioning import FilterSettings, make_filters
from .course_filter import CourseFilter, learn, spread_postures
from .course_recordings import DIRECTIONS, RATE, Topics, read_part, read_sweep
from .course_training import Answers, DrivenPart, driven_course
from .deflection import Deflection
from .fir import MOST, TapTable, write_taps
from .offset_answer import impulse
from .preview import Preview, read_profile


def configure(parser: argparse.ArgumentParser) -> None:
    """Arguments of the subcommand."""
    parser.add_argument("model", help="model.yaml that will be in force")
    parser.add_argument("cell", help="cell file")
    parser.add_argument(
        "bag", type=Path, nargs="+", help="recordings of courses under the process, without correction or with their offset"
    )
    parser.add_argument("--dry", type=Path, nargs="+", default=[], metavar="BAG", help="the same courses without process")
    parser.add_argument("--profile", type=Path, nargs="+", default=[], metavar="FILE", help="preview.file of each course")
    parser.add_argument("--lead", type=float, default=0.0, help="as preview.lead, with --profile: s (default: 0)")
    parser.add_argument("--slack", type=float, default=0.0, help="as preview.slack, with --profile: s (default: 0)")
    parser.add_argument("--swept", type=Path, nargs="+", default=[], metavar="BAG", help="offsets swept on the standing arm")
    parser.add_argument("--delay", type=float, help="s from an offset to its motion, where no offset was swept")
    parser.add_argument("--counts", choices=DIRECTIONS, default="across", help="direction of the deviation (default: across)")
    parser.add_argument("--postures", type=int, default=6, help="that have taps of their own, at most (default: 6)")
    parser.add_argument("--acceleration", type=float, default=0.5, help="limit of the offset: m/s^2 (default: 0.5)")
    parser.add_argument("--taps", type=int, default=60, help="samples that it looks back (default: 60)")
    parser.add_argument("--crossed", action="store_true", help="each axis from all axes of the force, not from its own alone")
    parser.add_argument("--gravity", type=float, nargs=3, default=(0.0, 0.0, -9.81), help="in base_link: m/s^2")
    parser.add_argument("--spindle-speed", type=float, default=0.0, help="as filter.spindle_speed, 1/s; 0: none (default)")
    parser.add_argument("--harmonics", type=int, default=2, help="as filter.harmonics (default: 2)")
    parser.add_argument("--notch-quality", type=float, default=5.0, help="as filter.notch_quality (default: 5)")
    for name, default in vars(Topics()).items():
        parser.add_argument(f"--{name}", default=default, metavar="TOPIC", help=f"(default: {default})")
    parser.add_argument("-o", "--output", type=Path, default=Path("filter.csv"), help="table (default: filter.csv)")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(args: argparse.Namespace) -> int:
    """0: written."""
    _check(args)
    model, cell = load_model(args.model), read_cell(args.cell)
    check_belongs(model, cell.robot, cell.serial, "the cell file")
    topics = Topics(*(getattr(args, name) for name in vars(Topics())))
    settings = FilterSettings(
        rate=RATE, spindle_speed=args.spindle_speed, harmonics=args.harmonics, notch_quality=args.notch_quality, cutoff=0.0
    )
    stages, dry, known = make_filters(settings), args.dry or [None] * len(args.bag), _profiles(args, cell)
    parts = [read_part(b, cell, topics, args.counts, stages, d, k) for b, d, k in zip(args.bag, dry, known, strict=True)]
    answers = _answers(args, cell, topics, parts)
    postures = spread_postures(np.concatenate([p.q[p.used] for p in parts]), args.postures)
    deflection = Deflection(model, cell.robot, tuple(args.gravity), cell.payload)
    courses = [driven_course(deflection, part, answers, postures, 1.0 / RATE) for part in parts]
    # a third of the limit, so that the limit itself acts rarely
    found = learn(courses, RATE, args.acceleration / 3.0, args.taps, args.crossed)
    write_taps(args.output, TapTable(found.taps, postures, cell.robot.joint_names))
    _tell(args, found, len(parts), len(postures), sum(float(p.used.sum()) for p in parts) / RATE)
    return 0


def _check(args: argparse.Namespace) -> None:
    for name, value, low, high in (
        ("--acceleration", args.acceleration, 1e-3, 50.0), ("--postures", args.postures, 1, MOST),
        ("--delay", args.delay or 0.0, 0.0, 0.2),
    ):  # fmt: skip
        if not low <= value <= high:
            raise RecordingError(f"{name} is {value:g}; {low:g} .. {high:g} is possible")
    for name, given in (("--dry", args.dry), ("--profile", args.profile)):
        if given and len(given) != len(args.bag):
            raise RecordingError(f"{name} names {len(given)} files for {len(args.bag)} courses; one for each, in their order")
    if (args.lead or args.slack) and not args.profile:
        raise RecordingError("--lead and --slack are about the force profiles of --profile; name one for each course")
    if bool(args.swept) == (args.delay is not None):
        raise RecordingError(
            "how the TCP answers an offset is told by --swept BAG... or by --delay (irec latency); give one of both"
        )


def _profiles(args: argparse.Namespace, cell: Cell) -> list[Preview | None]:
    """Of each course."""
    read = [read_profile(file, cell.robot.joint_names) for file in args.profile]
    return [Preview(one, args.lead, slack=args.slack) for one in read] or [None] * len(args.bag)


def _answers(args: argparse.Namespace, cell: Cell, topics: Topics, parts: list[DrivenPart]) -> Answers:
    """As swept; or the same delay everywhere."""
    if args.swept:
        read = [read_sweep(bag, cell, topics) for bag in args.swept]
        return Answers(np.array([q for q, _ in read]), [h for _, h in read])
    f: Array = np.fft.rfftfreq(1000, 1.0 / RATE)
    late = np.exp(-2j * np.pi * f * args.delay)[:, None, None] * np.eye(3)
    return Answers(np.mean([p.q.mean(axis=0) for p in parts], axis=0)[None], [impulse(f, late, RATE)])


def _tell(args: argparse.Namespace, found: CourseFilter, courses: int, postures: int, seconds: float) -> None:
    if args.json:
        figures = {"left_m": found.left, "before_m": found.before, "acceleration_m_s2": found.acceleration, "postures": postures}
        print(json.dumps({**figures, "seconds": seconds, "table": str(args.output)}, indent=2))
        return
    print(
        f"{seconds:.0f} s of {courses} courses, {postures} postures with taps of their own\n"
        f"on these courses it leaves {1e6 * found.left:.1f} um RMS of the unsteady deviation, the unfiltered prediction"
        f" {1e6 * found.before:.1f} um (acceleration of the offset {found.acceleration:.2f} m/s^2 RMS where it is roughest)\n"
        f"written: {args.output}\n"
        f"for the correction: filter.file: {args.output}, lead: 0.0, limit.translation_acceleration: {args.acceleration:g};"
        " judge it on courses that are not among these"
    )
