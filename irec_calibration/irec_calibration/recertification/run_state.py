# SPDX-License-Identifier: Apache-2.0
"""How far a recertification is, on the disk at every moment (`run.json`, irec-run/1), so that it can go on after a power cut."""

from __future__ import annotations

import datetime
import json
import os
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path

from ..errors import IrecError, ModelError
from ..files import read_document
from ..model import Model
from ..session import Session, read_session
from .advice import with_advice
from .journal import Entry
from .request import Request
from .store import Store, sync

RUN = "run.json"
RUN_FORMAT = "irec-run/1"
OPEN_STAGES = ("quick_check", "procedure", "judgement")


@dataclass
class Run:
    """State of a run on the disk."""

    folder: Path
    operator: str
    poses_path: str
    stage: str = "quick_check"
    in_force: str = ""
    full: bool = False
    check_only: bool = False
    dry_run: bool = False
    verdict: str = ""
    begun: str = field(default_factory=lambda: datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"))

    def save(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self.folder / (RUN + ".part")
        with open(part, "w", encoding="utf-8") as file:
            json.dump({"format": RUN_FORMAT} | {k: v for k, v in asdict(self).items() if k != "folder"}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, self.folder / RUN)
        sync(self.folder)

    @property
    def session(self) -> Path:
        return self.folder / ("quick.mcap" if self.stage == "quick_check" else "full.mcap")


def interrupted(store: Store) -> str:
    """The run that was interrupted last: begun, stage and operator, for people; empty where there is none."""
    run = last_run(store)
    return "" if run is None else f"begun {run.begun} by {run.operator}, stopped in: {run.stage.replace('_', ' ')}"


def begin(store: Store, request: Request) -> Run:
    if request.resume:
        run = last_run(store)
        if run is None:
            raise IrecError(with_advice("there is no interrupted run to go on with.", "start without resume"))
        run.operator = request.operator  # who answers for it from now on
        run.save()
        return run
    stamp = datetime.datetime.now().astimezone().strftime("%Y%m%d_%H%M%S")
    names = (stamp, *(f"{stamp}_{k}" for k in range(2, 100)))
    folder = next((f for f in (store.folder / "runs" / n for n in names) if not f.exists()), None)
    if folder is None:
        raise IrecError(f"{store.folder / 'runs' / stamp}: a hundred runs of this second exist already; start again")
    entry = store.in_force_entry()
    run = Run(folder, request.operator, str(folder / "poses.yaml"), in_force="" if entry is None else entry.calibration,
               full=request.full, check_only=request.check_only, dry_run=request.dry_run)  # fmt: skip
    folder.mkdir(parents=True)
    shutil.copyfile(request.poses_path, run.poses_path)  # whoever edits that file meanwhile changes nothing
    sync(Path(run.poses_path))
    run.save()
    return run


def compared_with(store: Store, run: Run) -> tuple[Entry, Path, Model] | None:
    """The calibration that a run judges: the one in force, also where the run was cut off after it had put its own in force."""
    now = store.in_force()
    number = "" if now is None else now[0].calibration
    if number == run.in_force:
        return now
    own = store.of_run(run.folder.name, "added")
    if own is not None and own.calibration == number:
        return store.calibration(run.in_force) if run.in_force else None
    if run.stage == "quick_check":
        changed = f"calibration {number or 'none'} is in force now, {run.in_force or 'none'} was when the run began"
        raise IrecError(with_advice(f"the run can't go on: {changed}.", "start without resume"))
    return now


def last_run(store: Store) -> Run | None:
    """The newest run where it did not come to its end."""
    for path in sorted((store.folder / "runs").glob(f"*/{RUN}"), reverse=True):
        try:
            content = read_document(path, RUN_FORMAT, "state of a run", ModelError).data
        except ModelError as error:
            raise ModelError(with_advice(f"{error}.", f"remove the folder {path.parent} and start again")) from error
        run = Run(path.parent, **{k: v for k, v in content.items() if k != "format"})
        return run if run.stage in OPEN_STAGES else None
    return None


def session_of(store: Store, entry: Entry) -> Session | None:
    path = store.session_path(entry.calibration)
    return None if path is None else read_session(path)
