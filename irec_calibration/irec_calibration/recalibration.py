# SPDX-License-Identifier: Apache-2.0
"""Whether a new calibration is better than the one in force, by the criteria of the cell file, and the record of both."""

from __future__ import annotations

import datetime
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from .errors import ModelError
from .identify import fit, identify
from .model import EIGHTEEN_DOF, Model, blank_model, total_displacement
from .model_file import file_sha256, load_model
from .observe import Observation, observe
from .procedure.settings import Acceptance
from .provenance import model_of
from .session import Session
from .typing import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Criterion:
    """One condition of the cell file with what was found; `text` is for the person at the cell."""

    name: str
    holds: bool
    text: str


@dataclass(frozen=True)
class Judgement:
    """Result of a recalibration.

    Attributes:
        model: identified from all poses: the one that would be put in force.
        held_out: pose numbers that judged; their RMS (m) by a model identified without them, and by the one in force (NaN: none).
        noise_floor: RMS that instrument noise alone would give, m.
    """

    model: Model
    held_out: IntArray
    rms_new: float
    rms_old: float
    noise_floor: float
    criteria: tuple[Criterion, ...]

    @property
    def accepted(self) -> bool:
        """All criteria hold."""
        return all(c.holds for c in self.criteria)

    @property
    def text(self) -> str:
        """The judgement in plain words, with figures."""
        verdict = "The new calibration meets all criteria." if self.accepted else "The new calibration is NOT good enough."
        return " ".join([verdict, *(("" if c.holds else "FAILED: ") + c.text for c in self.criteria)])


def held_out_poses(session: Session, share: float) -> IntArray:
    """Every n-th pose in the order of the workspace, so that the held-out poses are spread like the others.

    Args:
        share: wanted share of the poses; at least one pose is held out and at least one kept.
    """
    poses = session.poses
    first = np.array([session.p_tcp_in_base[np.flatnonzero(session.pose == p)[0]] for p in poses])
    rail = np.array([sum(v[np.flatnonzero(session.pose == p)[0]] for v in session.ext.values()) for p in poses], dtype=float)
    centred = first - first.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    order = np.argsort(centred @ axis + 1e-6 * rail, kind="stable")
    count = int(np.clip(round(share * len(poses)), 1, max(len(poses) - 1, 1)))
    picks = np.linspace(0, len(poses) - 1, count + 2)[1:-1].round().astype(int) if count < len(poses) else [0]
    return np.sort(poses[order[picks]])


def residual_of(model: Model, observation: Observation) -> Array:
    """Measured minus predicted displacement of the marker, (m, 3), m, in base_link."""
    return observation.y - observation.of(total_displacement(model.terms, observation.scene))


def rms(residual: Array, rows: BoolArray | None = None) -> float:
    """sqrt(mean |r|^2) per sample, m."""
    chosen = residual if rows is None else residual[rows]
    return float(np.sqrt((chosen**2).sum(axis=1).mean()))


def judge(session: Session, in_force: Model | None, acceptance: Acceptance) -> Judgement:
    """Identify the 18-DOF model and compare it with the one in force on poses that the compared fit has not seen.

    Raises:
        SolveError: the session can't determine a model.
    """
    held_out = held_out_poses(session, acceptance.held_out_share)
    training = session.select_poses([p for p in session.poses.tolist() if p not in held_out])
    trained = identify(training, blank_model(EIGHTEEN_DOF))
    observation = observe(session)
    rows = np.isin(observation.pose, held_out)
    rms_new = rms(residual_of(Model(trained.terms), observation), rows)
    rms_old = float("nan") if in_force is None else rms(residual_of(in_force, observation), rows)
    model = model_of(fit(trained.terms, observation), parent="" if in_force is None else str(in_force.made.get("date", "")))
    floor = observation.whiten.floor
    return Judgement(model, held_out, rms_new, rms_old, floor, _criteria(session, acceptance, rms_new, rms_old, floor))


def _criteria(session: Session, a: Acceptance, rms_new: float, rms_old: float, floor: float) -> tuple[Criterion, ...]:
    um = 1e6
    n = len(session.poses)
    criteria = [
        Criterion("min_poses", n >= a.min_poses, f"{n} poses were measured (at least {a.min_poses})."),
        Criterion(
            "held_out_rms_m", rms_new <= a.held_out_rms_m,
            f"On poses that the fit has not seen the error is {um * rms_new:.1f} um (limit {um * a.held_out_rms_m:.1f} um).",
        ),
        Criterion(
            "max_noise_floors", rms_new <= a.max_noise_floors * floor,
            f"That is {rms_new / floor:.1f} times the instruments' noise of {um * floor:.1f} um (limit {a.max_noise_floors:g}).",
        ),
    ]  # fmt: skip
    if rms_old == rms_old:
        criteria.append(
            Criterion(
                "max_ratio_to_old", rms_new <= a.max_ratio_to_old * rms_old,
                f"The calibration in force has {um * rms_old:.1f} um on the same poses"
                f" (the new one may have {a.max_ratio_to_old:g} times that).",
            )
        )  # fmt: skip
    return tuple(criteria)


class Register:
    """Which model is in force for each robot: `<folder>/<serial>.yaml`, with everything that was in force before.

    Models themselves are files that are never changed or removed.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def _file(self, serial: str) -> Path:
        safe = "".join(c if c.isalnum() or c in "-_." else "_" for c in serial)
        return self.folder / f"{safe}.yaml"

    def entries(self, serial: str) -> list[dict[str, str]]:
        """All entries for a robot, oldest first; empty if there are none. ModelError: the file can't be read."""
        path = self._file(serial)
        if not path.exists():
            return []
        try:
            entries = yaml.safe_load(path.read_text(encoding="utf-8"))["in_force"]
            return [{str(k): str(v) for k, v in e.items()} for e in entries]
        except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
            raise ModelError(f"{path}: the register of models can't be read: {error!r}; restore it from a backup") from error

    def current(self, serial: str) -> tuple[Path, Model] | None:
        """The model in force, None if there is none.

        Raises:
            ModelError: its file is missing or has been changed since.
        """
        entries = self.entries(serial)
        if not entries:
            return None
        path = Path(entries[-1]["model"])
        if not path.is_file():
            register = self._file(serial)
            raise ModelError(f"{path}: the model in force is missing; restore it, or calibrate anew after removing {register}")
        if file_sha256(path) != entries[-1]["sha256"]:
            raise ModelError(f"{path}: the model in force has been changed since it was put in force; restore it")
        return path, load_model(path)

    def put_in_force(self, serial: str, model_path: Path, session_path: str, who: str) -> None:
        """Add an entry; the file is replaced in one step."""
        entry = {
            "model": str(model_path.resolve()),
            "sha256": file_sha256(model_path),
            "session": session_path,
            "by": who,
            "since": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        }
        entries = [*self.entries(serial), entry]
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self._file(serial).with_suffix(".part")
        part.write_text(yaml.safe_dump({"serial": serial, "in_force": entries}, sort_keys=False), encoding="utf-8")
        os.replace(part, self._file(serial))
