# SPDX-License-Identifier: Apache-2.0
"""Poses on the tooling of a cell that answer what a session left open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..cell import Cell
from ..effects.of_session import marker_by_controller
from ..errors import PlanError
from ..poses.pool import Pool
from ..session.data import Session
from ..typing import Array
from .questions import Question, questions
from .run import Progress, examine
from .telling import Told, choose

PASSES_BETWEEN_S = 600.0  # from the end of the session to the first imagined pose
ROW_S = 8.0  # from one row to the next
SURE, HARDLY = 0.9, 0.1  # chances of an answer


@dataclass(frozen=True)
class Open:
    """What a session leaves open, and how noisy its samples are beside what it states."""

    session: Session
    questions: tuple[Question, ...]
    ratio: float


def left_open(session: Session, cell: Cell, progress: Progress | None = None) -> Open:
    """Diagnose a session for what it does not tell.

    Args:
        cell: where more poses are to be measured.

    Raises:
        PlanError: it is not a loaded one, of another robot than the cell's, or nothing is in question.
        SolveError: as of `diagnose`.
    """
    if session.kind != "loaded":
        raise PlanError(f"{session.path or session.name}: is {session.kind}: poses on a tooling tell about loaded sessions only")
    if session.serial and cell.serial and session.serial != cell.serial:
        raise PlanError(f"{session.path or session.name}: is of robot {session.serial!r}, {cell.path} of {cell.serial!r}")
    if session.robot.joint_names != cell.robot.joint_names or session.robot.sha256 != cell.robot.sha256:
        raise PlanError(
            f"{session.path or session.name}: was measured with another robot description (SHA-256 {session.robot.sha256[:12]}..)"
            f" than {cell.path} has ({cell.robot.sha256[:12]}..)"
        )
    _, assessment, _ = examine(session, progress=progress)
    asked = questions(assessment)
    if not asked:
        raise PlanError(
            f"{session.path or session.name}: the diagnosis ({assessment.status}) leaves nothing open that poses could tell: no"
            " two effects are in question, and none shows that lacks evidence; plan without --to-tell"
        )
    return Open(session, asked, max(assessment.noise.ratio, 1e-3))


def chosen_to_tell(asked: Open, cell: Cell, pool: Pool, n: int) -> Told:
    """The poses of a pool that tell best."""
    return choose(asked.questions, imagined(asked.session, cell, pool), n, asked.ratio)


def imagined(session: Session, cell: Cell, pool: Pool) -> Session:
    """What Procedure 1 would record at the poses of a pool if nothing gave way; numbers from 1, the cell's load cases in order.

    What the session knows beside that (robot, noise, markers, stations) stays; temperatures are its medians.
    """
    cases = np.concatenate([np.zeros((1, 3)), cell.forces_in_tool])
    n, rows = len(pool), len(pool) * len(cases)

    def each(values: Any) -> Any:
        return np.repeat(values, len(cases), axis=0)

    names = [s.name for s in session.stations]
    station = [names.index(s.name) if s.name in names else 0 for s in cell.stations]
    q = each(pool.q)
    kin = session.robot.kinematics(q)
    ext = {name: np.full(rows, np.nanmedian(value)) for name, value in session.ext.items()}
    made = replace(
        session,
        pose=each(np.arange(1, n + 1)), load_case=np.tile(np.arange(len(cases)), n), repeat=np.zeros(rows, dtype=np.int64),
        stamp=session.stamp.max() + PASSES_BETWEEN_S + ROW_S * np.arange(rows),
        q=q, p_tcp_in_base=kin.p_tcp, p_marker_in_station=np.zeros((rows, 3)),
        station=np.array(station, dtype=np.int64)[each(pool.station)],
        marker=np.full(rows, session.marker[np.argmax(session.on_tool)]),
        force_in_tool=np.tile(cases, (n, 1)), torque_in_tool=np.zeros((rows, 3)), q_target=None,
        ext=ext | ({"rail": each(pool.rail)} if "rail" in ext else {}),
        temperature={name: np.full(rows, _middle(value)) for name, value in session.temperature.items()},
        load_case_names={}, load_cases={}, notes=(), path=None,
    )  # fmt: skip
    believed = marker_by_controller(made, kin)
    R = np.stack([s.R_in_base for s in session.stations])[made.station]
    t = np.array([s.xyz for s in session.stations])[made.station]
    return replace(made, p_marker_in_station=np.einsum("nji,nj->ni", R, believed - t))


def _middle(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def in_words(told: Told, label: Callable[[str], str]) -> list[str]:
    """What the chosen poses are expected to say about each question, one line each.

    Args:
        label: what an effect is called in words.
    """
    out = []
    for number, question in enumerate(told.questions):
        one, other = question.names
        what = f"whether {label(one)} is there" if question.is_presence else f"{label(one)} or {label(other)}"
        enough = next((k for k in range(1, len(told.chosen) + 1) if told.chance(number, k) >= SURE), 0)
        chance = told.chance(number)
        begin = f"the first {enough} of these poses tell" if enough else f"these poses tell in {100 * chance:.0f} of 100 cases"
        unsure = "; more poses (-n) make it surer" if chance >= HARDLY else "; no pose of this tooling tells much"
        more = "" if chance >= SURE else unsure
        nats, lacks = told.nats[number, -1], question.lacks
        sides = "" if question.is_presence else f" and {nats[1]:.1f} of {lacks[1]:.1f}"
        out.append(f"{what}: {begin} (evidence {nats[0]:.1f} of {lacks[0]:.1f}{sides} nats){more}")
    return out


def tells(told: Told) -> bool:
    """Whether the chosen poses answer any of the questions more likely than not."""
    return any(told.chance(i) > 0.5 for i in range(len(told.questions)))
