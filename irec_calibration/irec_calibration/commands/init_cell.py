# SPDX-License-Identifier: Apache-2.0
"""`irec init-cell`: a commented cell file from what is known on the first day, by options or by questions."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..cell import read_cell
from ..cell.mesh import MESH_LIMIT
from ..errors import CellError
from ..files import all_or_none, read_bytes, read_text, write_file
from ..files.regular import URDF_LIMIT
from ..poses.check import cell_problems
from ..poses.draft import Facts, cell_text, mesh_of_points, mesh_section, quaternion, shape_of
from ..poses.step_file import STEP_SUFFIXES, mesh_of_step
from ..procedure.scale import scale_notes
from ..robot import Robot
from ..robot.frames import with_frames

# option, question, what is asked for when nothing is answered
QUESTIONS = (
    ("name", "name of the cell", "cell"),
    ("urdf", "robot description (URDF, the output of xacro)", None),
    ("serial", "serial number of the robot", None),
    ("tool_frame", "link of the description that carries the TCP", "tool0"),
    ("base_frame", "link of the description that positions refer to", "base_link"),
    (
        "surface",
        "tooling: mesh file (STL, OBJ, PLY), STEP file, table of probed points (CSV), 'block X Y Z' or 'patch X Y RX RY' in m",
        None,
    ),
    ("surface_xyz", "where its origin is in base_link: x y z, m", "0 0 0"),
    ("surface_rpy", "how it is turned: about x, y, z, degrees", "0 0 0"),
    ("station", "tracker station: name x y z in base_link, m (several: separated by ;)", None),
    ("marker", "reflector in tool0: x y z, m", "0 0 -0.03"),
    ("sensor_range", "force sensor's range of one axis, N", None),
    ("payload", "rated payload of the robot, kg", None),
)


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", type=Path, required=True, help="cell file to write; other files go beside it")
    parser.add_argument("--name", help="name of the cell (default: that of the file)")
    parser.add_argument("--urdf", type=Path, help="robot description; of xacro its output")
    parser.add_argument("--serial", help="serial number of the robot")
    parser.add_argument("--base-frame", help="link that positions refer to (default: base_link)")
    parser.add_argument("--tool-frame", help="link that carries the TCP (default: tool0)")
    parser.add_argument("--tool-xyz", nargs=3, type=float, metavar="M", help="TCP in that link (default: 0 0 0)")
    parser.add_argument("--tool-rpy", nargs=3, type=float, metavar="DEG", help="its turn; z must point out of the tool")
    parser.add_argument("--effort", nargs="+", type=float, metavar="NM", help="rated torques, where the description has none")
    parser.add_argument("--joint-names", nargs="+", metavar="NAME", help="names in ROS topics where they are others")
    parser.add_argument("--home", nargs="+", type=float, metavar="RAD", help="joint angles of HOME (default: found)")
    parser.add_argument("--rail", nargs=5, type=float, metavar=("X", "Y", "Z", "LOWER", "UPPER"), help="axis and travel, m")
    parser.add_argument("--surface", nargs="+", help="mesh, STEP, CSV of probed points, `block X Y Z` or `patch X Y RX RY`, m")
    parser.add_argument("--faces", nargs="+", default=["+z"], help="of a block: +x -x +y -y +z -z (default: +z)")
    parser.add_argument("--scale", type=float, help="metres per unit of the mesh (default: recognised)")
    parser.add_argument("--surface-xyz", nargs=3, type=float, metavar="M", help="origin of the surface in base_link")
    parser.add_argument("--surface-rpy", nargs=3, type=float, metavar="DEG", help="turn of the surface about x, y, z")
    parser.add_argument("--station", nargs="+", action="append", metavar="NAME X Y Z", help="tracker station, m; may be repeated")
    parser.add_argument("--marker", nargs=3, type=float, metavar="M", help="reflector in tool0 (default: 0 0 -0.03)")
    parser.add_argument("--sensor-range", type=float, metavar="N", help="of one axis, data sheet of the sensor")
    parser.add_argument("--sensor-frame", help="its link (default: the one that carries the TCP)")
    parser.add_argument("--payload", type=float, metavar="KG", help="rated payload, data sheet of the robot")
    parser.add_argument("--friction", type=float, default=0.5, help="of the pad on the surface (default: 0.5)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")
    parser.add_argument("--ask", action="store_true", help="ask for what is not given, on the terminal")


def run(args: argparse.Namespace) -> int:
    """0: written, nothing wrong; 2: something is missing or wrong."""
    answers(args)
    if args.output.exists():
        raise CellError(f"{args.output} exists; choose another name or remove it")
    with all_or_none():
        urdf, notes = _write(args)
    problems, more = cell_problems(args.output)
    if not problems:
        more += scale_notes(read_cell(args.output))
    if args.json:
        print(json.dumps({"cell": str(args.output), "urdf": str(urdf), "problems": problems, "notes": notes + more}))
        return 2 if problems else 0
    for note in notes + more:
        print(f"note: {note}")
    for problem in problems:
        print(problem)
    print(f"wrote {args.output} and {urdf}; look at it: irec show-cell {args.output}; then: irec plan {args.output}")
    return 2 if problems else 0


def _write(args: argparse.Namespace) -> tuple[Path, list[str]]:
    """Write cell file, robot description and mesh; returns the path of the description, and notes on what was recognised.

    Raises:
        IrecError: what was given can't be used, or one of the files can't be written.
    """
    folder = args.output.parent
    notes: list[str] = []
    text = read_text(args.urdf, "robot description", CellError, URDF_LIMIT)
    moved = tuple(args.tool_xyz or (0, 0, 0)), tuple(math.radians(v) for v in args.tool_rpy or (0, 0, 0))
    effort = tuple(args.effort) if args.effort else None
    made = with_frames(text, str(args.urdf), args.base_frame, args.tool_frame, *moved, effort)  # type: ignore[arg-type]
    robot = Robot(made, str(args.urdf))
    urdf = folder / f"{args.name}.urdf"
    if urdf.exists() and urdf.read_bytes() != made.encode():
        raise CellError(f"{urdf} exists and is another robot description; choose another --name or folder, or remove it")
    xyz, quat = tuple(args.surface_xyz), quaternion(tuple(args.surface_rpy))  # type: ignore[arg-type]
    R, p = Rotation.from_quat(quat).as_matrix(), np.array(xyz)
    stations = tuple(_station(words) for words in args.station)
    seen_from = np.array([s[1] for s in stations])
    kind = args.surface[0]
    if kind in ("block", "patch"):
        numbers = _numbers(args.surface[1:], {"block": 3, "patch": 4}[kind], f"--surface {kind}")
        section, shape = shape_of(kind, numbers, R, p, numbers[2:], args.faces)
    else:
        source = Path(kind)
        target = folder / f"{args.name}_surface{source.suffix.lower()}"
        if source.suffix.lower() in (".csv", ".txt", ".xyz"):
            target = target.with_suffix(".obj")
            count, said = mesh_of_points(source, target, seen_from.mean(axis=0))
            notes += [f"{source}: {count} probed points; wrote {target}", *said]
        elif source.suffix.lower() in STEP_SUFFIXES:
            if args.scale is not None:
                raise CellError(f"{source}: a STEP file states its unit; leave --scale out")
            target, args.scale = target.with_suffix(".obj"), 1.0
            notes += mesh_of_step(source, target)
        elif source.resolve() != target.resolve():
            if not source.is_file():
                raise CellError(f"{source}: the mesh is not there")
            write_file(target, read_bytes(source, "mesh", CellError, MESH_LIMIT), error=CellError)
        section, shape, said = mesh_section(target, target.name, R, p, seen_from, args.scale)
        notes += said
    write_file(urdf, made, error=CellError)
    facts = Facts(
        args.name, args.serial, urdf.name, robot, section, xyz, quat, shape, stations, tuple(args.marker),  # type: ignore[arg-type]
        (tuple(args.rail[:3]), tuple(args.rail[3:])) if args.rail else None, args.sensor_range,
        args.sensor_frame or ("tool0" if not robot.has_link(args.tool_frame) else args.tool_frame), args.payload, args.friction,
        np.array(args.home) if args.home else None, tuple(args.joint_names or ()),
    )  # fmt: skip
    write_file(args.output, cell_text(facts), error=CellError)
    return urdf, notes


def answers(args: argparse.Namespace) -> None:
    """Fill in what was not given: by questions with --ask, else by defaults. CellError names all that is missing at once."""
    if args.name is None:
        args.name = args.output.stem
    missing = []
    for key, question, default in QUESTIONS:
        if getattr(args, key) is not None:
            continue
        text = default
        if args.ask:
            print(f"{question}{f' [{default}]' if default else ''}: ", end="", file=sys.stderr, flush=True)
            text = sys.stdin.readline().strip() or default
        if text is None:
            missing.append(f"--{key.replace('_', '-')} ({question})")
            continue
        setattr(args, key, _parsed(key, text))
    if missing:
        raise CellError(f"not given: {'; '.join(missing)}; --ask asks for them")


def _parsed(key: str, text: str) -> object:
    if key in ("surface_xyz", "surface_rpy", "marker"):
        return _numbers(text.split(), 3, f"--{key.replace('_', '-')}")
    if key in ("sensor_range", "payload"):
        return _numbers([text], 1, f"--{key.replace('_', '-')}")[0]
    if key == "station":
        return [part.split() for part in text.split(";") if part.strip()]
    if key == "surface":
        return text.split() if text.split()[0] in ("block", "patch") else [text]
    return Path(text) if key == "urdf" else text


def _numbers(words: list[str], count: int, what: str) -> list[float]:
    try:
        values = [float(w) for w in words]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise CellError(f"{what}: {count} numbers are needed, given was {' '.join(words)!r}")
    return values


def _station(words: list[str]) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    if len(words) not in (4, 8):
        raise CellError(f"--station {' '.join(words)}: NAME X Y Z is needed, or NAME X Y Z QX QY QZ QW")
    values = _numbers(words[1:], len(words) - 1, f"--station {words[0]}")
    return words[0], tuple(values[:3]), tuple(values[3:] or (0.0, 0.0, 0.0, 1.0))
