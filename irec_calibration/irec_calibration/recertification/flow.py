# SPDX-License-Identifier: Apache-2.0
"""One recertification from the first check to the certificate, whatever carries it out: nodes, or a test.

    preconditions -> quick check -> (only where needed or asked for) full procedure -> judgement -> certificate -> in force

What has been decided and measured so far is on the disk at every moment (`runs/<stamp>/run.json`), so that a run which was
interrupted, by whatever, goes on from its last complete pose.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from ..codec.follow import complete_poses
from ..errors import IrecError, ModelError
from ..model import Model
from ..model.file import save_model
from ..poses.store import PoseList, read_poses, write_poses
from ..session import Session, read_session, write_table
from ..typing import Json
from .advice import RESUME, with_advice
from .journal import Entry
from .judgement import Judgement, Missing, judge, with_diagnosis
from .preconditions import Precondition, own_preconditions, told
from .quick_check import QuickResult, Reference, check, reference_of
from .quick_plan import MOST_LATERAL, QuickPlan, plan
from .request import Place, Request
from .run_state import Run, begin, compared_with, session_of
from .station import with_stations_found
from .store import Store

QUICK_POSES = "quick_poses.yaml"  # in the folder of a run
GO_ON = f"mend that, then {RESUME}; it goes on after the last complete pose"
CHECK_A_PART = "check one part at reduced speed."


class CellSide(Protocol):
    """What a recertification needs of the cell."""

    def preconditions(self) -> Sequence[Precondition]:
        """Look at robot, tracker, sensor and nodes now; nothing moves."""

    def lateral_factor(self, poses: PoseList, most: float) -> float:
        """By how much the forces across the tool may be larger than in the cell file at these poses: 1 to `most`."""

    def run(self, poses_path: Path, session_path: Path, resume: bool, enough: Callable[[], bool]) -> str:
        """Measure the poses; `enough` is asked after each pose and ends the run. Empty, or why it ended before its end.

        Raises Cancelled where the operator has cancelled.
        """

    def diagnose(self, session_path: Path, model_path: Path, folder: Path) -> Missing:
        """The diagnosis of a session that starts from a model."""

    def activate(self, model_path: Path) -> str:
        """Put a model in force in the correction. Empty, or why it was refused."""

    def report(self, stage: str, text: str) -> None:
        """Progress for the person at the cell."""


@dataclass(frozen=True)
class Outcome:
    """Result of a recertification.

    Attributes:
        verdict: `pass`, `recalibrated`, `investigate: what`, `failed: why`.
        text: for the person at the cell; ends in what to do now.
        activated: a new calibration is in force.
        calibration: its number in the store, empty where none was stored.
        folder: of this run (session, certificate).
        quick, judgement: what they rest on, None where that stage did not take place.
    """

    verdict: str
    text: str
    activated: bool = False
    calibration: str = ""
    folder: Path | None = None
    session_path: str = ""
    quick: QuickResult | None = None
    quick_plan: QuickPlan | None = None
    judgement: Judgement | None = None
    preconditions: tuple[Precondition, ...] = ()


def recertify(place: Place, store: Store, request: Request, side: CellSide) -> Outcome:
    """Carry out a recertification.

    Raises:
        Cancelled: the operator has cancelled; the run can be resumed.
        IrecError: it can't go on; the calibration in force is unchanged and the run can be resumed.
    """
    side.report("preconditions", "looking at robot, instruments and files; nothing moves")
    own = own_preconditions(place, store, request)
    side.report("preconditions", told(own))
    of_cell = () if place.without_tracker else side.preconditions()
    side.report("preconditions", told(of_cell))
    found = (*own, *of_cell)
    missing = [p for p in found if not p.holds]
    if missing:
        text = " ".join(f"{p.name}: {p.text}." for p in missing)
        again = " and ".join(p.name for p in missing)
        text = with_advice(f"Nothing was moved. {text}", f"put that right ({again}), then start again.")
        return Outcome(f"failed: {missing[0].name}", text, preconditions=found)
    run = begin(store, request)
    now = compared_with(store, run)
    before = None if now is None else session_of(store, now[0])
    quick, chosen = None, None
    if run.stage == "quick_check":
        if now is None or before is None or run.full:
            run.stage = "procedure"
        else:
            quick, chosen = _quick_check(place, store, run, now, before, side)
            if quick.decision == "pass" or run.check_only:
                return _close(store, run, _checked(store, run, quick, chosen, found))
            run.stage = "procedure"
        run.save()
    elif now is not None and before is not None:
        quick, chosen = _quick_check_of(place, run, now[2], before)
    if run.stage == "procedure":
        side.report("procedure", "the full procedure")
        why = side.run(Path(run.poses_path), run.session, run.session.exists(), lambda: False)
        if why:
            raise IrecError(with_advice(f"{why.rstrip('.')}.", GO_ON))
        run.stage = "judgement"
        run.save()
    side.report("judgement", "identifying the calibration anew and comparing it with the one in force")
    outcome = _judge(place, store, run, None if now is None else now[2], before, side)
    return _close(store, run, replace(outcome, quick=quick, quick_plan=chosen, preconditions=found))


def _quick_check(
    place: Place, store: Store, run: Run, now: tuple[Entry, Path, Model], before: Session, side: CellSide
) -> tuple[QuickResult, QuickPlan]:
    side.report("quick_check", "choosing poses that would show a change")
    reference = reference_of(now[2].terms, before, place.tolerance, now[2].sag_share)
    kept = store.folder / now[0].calibration / "poses.yaml"
    listed = read_poses(kept, place.serial, place.robot.sha256)
    begun = _lateral_of(run)
    chosen = plan(reference, side.lateral_factor(listed, MOST_LATERAL) if begun is None else begun)
    poses = _quick_poses(listed, str(kept), chosen, run.folder / QUICK_POSES)
    results: list[QuickResult] = []
    seen = 0

    def enough(last: bool = False) -> bool:
        nonlocal seen
        visits, result = _so_far(reference, chosen, run.session, seen, last)
        if result is None:
            return False
        seen = visits
        results.append(result)
        side.report("quick_check", result.text)
        return result.decision != "undecided"

    why = ""
    if not enough():  # of a run that was interrupted after its last pose
        why = side.run(poses, run.session, run.session.exists(), enough)
        enough(last=not why)
    if not results or (why and results[-1].decision == "undecided"):
        raise IrecError(with_advice(f"{(why or 'no pose of the quick check could be used').rstrip('.')}.", GO_ON))
    return results[-1], chosen


def _quick_check_of(place: Place, run: Run, model: Model, before: Session) -> tuple[QuickResult | None, QuickPlan | None]:
    """What the quick check had found before a run was interrupted; None where it did not take place."""
    path = run.folder / "quick.mcap"
    if not path.exists():
        return None, None
    reference = reference_of(model.terms, before, place.tolerance, model.sag_share)
    chosen = plan(reference, _lateral_of(run) or 1.0)
    _, quick = _so_far(reference, chosen, path, 0, last=True)
    return quick, chosen if quick is not None else None


def _so_far(reference: Reference, chosen: QuickPlan, path: Path, seen: int, last: bool) -> tuple[int, QuickResult | None]:
    """Visits and the check of them; None where the robot has left no pose since so many visits were `seen`.

    Args:
        last: nothing more will be measured; all that there is counts.
    """
    try:
        session = read_session(path)
        complete = complete_poses(session)
        measured = max(complete.tolist(), default=0)
        visits = measured if last else max((n for n in chosen.looks if n <= measured), default=0)
        if visits == 0 or (visits == seen and not last):
            return seen, None
        now = session.select_poses([p for p in complete.tolist() if p <= visits])
        return visits, check(reference, now, chosen.sizes, last or visits >= len(chosen.poses))
    except IrecError:  # nothing complete has reached the disk yet
        return seen, None


def _lateral_of(run: Run) -> float | None:
    """The factor of the forces across the tool with which a run was begun that goes on now."""
    path = run.folder / QUICK_POSES
    return read_poses(path).lateral_factor if path.exists() else None


def _quick_poses(listed: PoseList, kept: str, chosen: QuickPlan, path: Path) -> Path:
    """A pose file with the visits of the plan; as many of them are made as are needed.

    Args:
        listed, kept: the poses of the calibration, and the name of their file.
    """
    of = {p.index: p for p in listed.poses}
    known = [n for n in chosen.poses if n in of]
    if len(known) < len(chosen.poses):
        raise ModelError(f"{kept}: does not hold pose {sorted(set(chosen.poses) - set(of))[0]} of the calibration's session")
    poses = tuple(replace(of[n], index=i) for i, n in enumerate(known, 1))
    return write_poses(replace(listed, poses=poses, plan={}, lateral_factor=chosen.lateral), path)


def _checked(store: Store, run: Run, quick: QuickResult, chosen: QuickPlan, found: tuple[Precondition, ...]) -> Outcome:
    """The end of a run that stays with the quick check."""
    if quick.decision == "pass":
        verdict, text = "pass", quick.text
    elif quick.decision == "changed":
        verdict, text = "failed: the robot has changed", quick.text
    else:
        verdict, text = "failed: not decided", with_advice(quick.text, "run the full procedure.")
    figures = {"poses": quick.poses, "odds_of_change": quick.e_value, "like": list(quick.like), "run": run.folder.name}
    if quick.decision == "pass":
        figures["softer_below"] = _softer_below(quick, chosen)
    if store.of_run(run.folder.name, "checked") is None:
        store.record_check(verdict, run.operator, figures)
    return Outcome(verdict, text, False, "", run.folder, str(run.folder / "quick.mcap"), quick, chosen, None, found)


def _softer_below(quick: QuickResult, chosen: QuickPlan) -> dict[str, float]:
    """What a passed check confirms: axis -> share of its compliance by which it would have been found softer."""
    softer = [(name, c) for name, c in quick.named.items() if c.ageing.relative and c.part]
    return {c.part: c.ageing.size * chosen.sizes[name] for name, c in softer if name in chosen.sizes}


def _judge(place: Place, store: Store, run: Run, model: Model | None, before: Session | None, side: CellSide) -> Outcome:
    run.stage = "judgement"
    session = with_stations_found(read_session(run.session))
    judgement = judge(session, model, before, place.acceptance, place.tolerance)
    files = run.folder / "calibration"
    shutil.rmtree(files, ignore_errors=True)
    files.mkdir(parents=True)
    path = save_model(judgement.model, files / "model.yaml")
    side.report("judgement", "looking for effects that the model lacks")
    measured = write_table(session, files / "session")  # a tracker that was put up anew is no effect that the model lacks
    judgement = with_diagnosis(judgement, side.diagnose(measured, path, files / "diagnosis"), place.tolerance)
    shutil.copyfile(run.poses_path, files / "poses.yaml")
    figures: Json = {**judgement.figures, "run": run.folder.name, "session": str(run.session)}
    entry = store.of_run(run.folder.name, "added") or store.add(files, judgement.verdict, run.operator, figures)
    number, at = entry.calibration, str(run.session)
    outcome = Outcome(judgement.verdict, judgement.text, False, number, run.folder, at, judgement=judgement)
    if judgement.verdict != "recalibrated":
        return outcome
    how = f"ros2 service call irec/put_in_force with calibration {number}"
    if run.dry_run:
        return replace(outcome, text=f"{outcome.text} This was a dry run: nothing was put in force. To do that: {how}.")
    refused = side.activate(store.model_path(entry.calibration))
    if refused:
        stored = f"{outcome.text} It is stored as {number} but not in force: {refused.rstrip('.')}."
        text = with_advice(stored, f"mend that, then put it in force ({how}); nothing has to be measured again.")
        return replace(outcome, text=text)
    now = store.in_force_entry()
    if now is None or now.calibration != entry.calibration:
        store.put_in_force(entry.calibration, run.operator)
    kept = "; the one before it was kept" if model is not None else ""
    return replace(outcome, activated=True, text=with_advice(f"{outcome.text} It is now in force{kept}.", CHECK_A_PART))


def _close(store: Store, run: Run, outcome: Outcome) -> Outcome:
    run.stage, run.verdict = "done", outcome.verdict
    run.save()
    return outcome
