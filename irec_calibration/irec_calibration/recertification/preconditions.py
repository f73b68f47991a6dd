# SPDX-License-Identifier: Apache-2.0
"""What can be checked before the robot moves without asking the cell: operator, model in force, tool, poses, disk space."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import IrecError
from ..model.file import check_belongs
from ..poses.store import read_poses
from ..session import Session
from .request import Place, Request, Tool
from .run_state import last_run, session_of
from .store import Store

FREE_DISK = 2e9  # bytes: one full procedure with all raw streams, twice
SAME_MASS, SAME_MASS_SHARE = 0.5, 0.01  # kg, and share of it: a difference that is another way to state the same tool
HOLDS, FAILS = "✓ ", "✗ "
NO_TRACKER = (
    "the cell file states procedure.without_tracker: true, and a recertification measures with a tracker: what the springs of arm"
    " and disc share can't be told from a change without one; set up a tracker and take the key out of the cell file, or record a"
    " session with irec/run_procedure and identify from it with irec solve --without-tracker"
)
SAME_MARKER = 5e-3  # m; a reflector that was put on anew


@dataclass(frozen=True)
class Precondition:
    """Something that must hold before the robot moves. `text` says what was found and, where it does not hold, what to do."""

    name: str
    holds: bool
    text: str


def told(preconditions: Sequence[Precondition]) -> str:
    """One line for each: HOLDS or FAILS, its name, what was found."""
    return "\n".join(f"{HOLDS if p.holds else FAILS}{p.name}: {p.text}" for p in preconditions)


def told_lines(message: str) -> list[str]:
    """The lines of a message of progress that tell a precondition; none where it tells something else."""
    return [line for line in message.splitlines() if line.startswith((HOLDS, FAILS))]


def own_preconditions(place: Place, store: Store, request: Request) -> tuple[Precondition, ...]:
    """What can be checked without the cell: operator, model in force, poses, disk space."""
    wrong = not_an_operator(request.operator, place.operators)
    out = [Precondition("operator", not wrong, wrong or request.operator)]
    if place.without_tracker:
        out.append(Precondition("tracker", False, NO_TRACKER))
    before: Session | None = None
    try:
        now = store.in_force()
        if now is not None:
            check_belongs(now[2], place.robot, place.serial, "the cell")
            before = session_of(store, now[0])
        text = "no calibration is in force yet: this run makes the first" if now is None else f"calibration {now[0].calibration}"
        nothing = _nothing_to_check(request, before)
        out.append(Precondition("model", not nothing, nothing or text))
    except IrecError as error:
        out.append(Precondition("model", False, str(error)))
    if before is not None and place.tool is not None:
        other = another_tool(place.tool, before)
        out.append(Precondition("stated tool", not other, other or "that of the calibration in force"))
    try:
        run = last_run(store) if request.resume else None
        path = run.poses_path if run is not None else request.poses_path
        n = len(read_poses(path, place.serial, place.robot.sha256).poses)
        out.append(Precondition("poses", True, f"{n} poses in {Path(request.poses_path).name}"))
    except IrecError as error:
        out.append(Precondition("poses", False, str(error)))
    return (*out, _disk(store))


def _nothing_to_check(request: Request, before: Session | None) -> str:
    """Why a check that must not go on to the full procedure can't be made; empty where it can, or may go on."""
    if not request.check_only or request.resume:
        return ""
    if request.full:
        return "check_only and full are both asked for; leave one of them out"
    if before is None:
        return "there is no calibration in force with its session, which a check compares with; recalibrate"
    return ""


def not_an_operator(name: str, operators: Sequence[str]) -> str:
    """Why nobody can answer for it with this name; empty: somebody can. Upper and lower case and spaces make no difference."""
    if not any(c.isalpha() for c in name):
        return f"{repr(name) + ' is no name' if name.strip() else 'the name is empty'}; state who answers for it"
    known = {" ".join(o.split()).casefold() for o in operators}
    if known and " ".join(name.split()).casefold() not in known:
        return f"{name!r} is none of those whom the cell file names ({', '.join(operators)}); write the name so, or add it there"
    return ""


def another_tool(tool: Tool, before: Session) -> str:
    """In what the tool that the cell file states differs from that of the calibration in force; empty: in nothing."""
    then = str(before.meta.get("tool", ""))
    mass, mass_then = tool.payload.mass, 0.0 if before.payload is None else before.payload.mass
    marker = next((np.array(m.xyz) for m in before.markers if m.link == "tool0"), tool.marker_in_tool)
    moved = float(np.linalg.norm(tool.marker_in_tool - marker))
    differs = []
    if tool.name and then and tool.name != then:
        differs.append(f"it is called {tool.name!r}, then {then!r}")
    if abs(mass - mass_then) > max(SAME_MASS, SAME_MASS_SHARE * mass_then):
        differs.append(f"its mass is {mass:.1f} kg, then {mass_then:.1f} kg")
    if moved > SAME_MARKER:
        differs.append(f"its marker lies {1e3 * moved:.1f} mm elsewhere")
    if not differs:
        return ""
    advice = "mount that tool again and restore the cell file; another tool gets a calibration folder of its own"
    return f"the cell file states another tool than the calibration in force had: {', '.join(differs)}; {advice}"


def _disk(store: Store) -> Precondition:
    try:
        store.folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=store.folder):
            free = shutil.disk_usage(store.folder).free
    except OSError as error:
        text = f"{store.folder} can't be written: {error.strerror}; mend that, or choose another calibration folder"
        return Precondition("disk", False, text)
    enough = free > FREE_DISK
    advice = "" if enough else f"; {FREE_DISK / 1e9:.0f} GB are needed: remove what is not needed from the disk of {store.folder}"
    return Precondition("disk", enough, f"{free / 1e9:.1f} GB free{advice}")
