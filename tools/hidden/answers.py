# SPDX-License-Identifier: Apache-2.0
"""One session of a blind run: what was hidden, what was said, and whether that is right. Strictly counted.

A wrong name is a wrong name, also where the truth stands among `confusable_with`. What is visible is what the truth's own
oracle says. Only the score reads truth files.
"""

from __future__ import annotations

import csv
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from axes import AxisScore, axes_in_model, axes_in_text, hidden_axes, score_axes

SERIOUS = 0.08  # strength from which an effect has to be found
FORM = ("bending_place", "linkage_compliance")  # complete the form of the base model, which every plant has more of
ROWS = re.compile(r"outlier|bad_row|suspect|spoiled|left_out|set_aside")  # keys of diagnosis.json that list doubtful rows


@dataclass
class Case:
    """One session: what was hidden, what was said, validation errors in m.

    Attributes:
        hidden: effects that are asked for; visible: those that the oracle sees; background: what the base model has anyway
            (geometry, of absolute sessions). What is there but too small to show is none of them: nobody can know its name.
        named: effects of the verdict; ladder: effects that `improve` added as causes, not to stand in for others.
        accused: poses that the diagnosis lists as having doubtful rows.
        expected: the validation error that the improved model says is to be expected; NaN where it says nothing.
    """

    name: str
    kind: str
    strength: float = 0.0
    hidden: list[str] = field(default_factory=list)
    background: list[str] = field(default_factory=list)
    visible: list[str] = field(default_factory=list)
    variables: list[str] = field(default_factory=list)
    claim_right: bool = True
    mishap: str = ""
    mishap_pose: int = 0
    plain: bool = True
    status: str = ""
    named: list[str] = field(default_factory=list)
    ladder: list[str] = field(default_factory=list)
    ranked: list[str] = field(default_factory=list)
    depends_on: list[str] = field(default_factory=list)
    accused: list[int] = field(default_factory=list)
    axes: list[AxisScore] = field(default_factory=list)
    base: float = float("nan")
    after: float = float("nan")
    oracle: float = float("nan")
    expected: float = float("nan")
    seconds: float = float("nan")
    failed: bool = False
    said: dict[str, Any] = field(default_factory=dict)

    @property
    def sees_all(self) -> bool:
        """Everything asked for is visible to the oracle."""
        return bool(self.hidden) and set(self.hidden) <= set(self.visible)

    @property
    def first_right(self) -> bool:
        return bool(self.named) and self.named[0] in self.hidden

    @property
    def among_three(self) -> bool:
        return any(e in self.hidden for e in [*self.named, *self.ranked][:3])

    @property
    def false_names(self) -> list[str]:
        return [e for e in self.named if e not in self.hidden and e not in self.background]

    @property
    def wrong_axis(self) -> bool:
        return any(a.is_wrong for a in self.axes)

    @property
    def wrong_name(self) -> bool:
        """An effect, or an axis of one, is named that is not there."""
        return bool(self.false_names) or self.wrong_axis

    @property
    def all_named(self) -> bool:
        return set(self.hidden) <= set(self.named) and not self.wrong_name

    @property
    def variable_right(self) -> bool:
        """One of the first three variables is one that the cause depends on."""
        return bool(set(self.depends_on[:3]) & set(self.variables))

    @property
    def sorted_as_named(self) -> bool:
        """The table of candidates begins with the effect that the verdict names first."""
        return not self.named or (bool(self.ranked) and self.ranked[0] == self.named[0])

    @property
    def mishap_found(self) -> bool:
        return self.mishap_pose in self.accused

    @property
    def right(self) -> bool:
        if self.failed:
            return False
        if self.kind == "outside":
            return self.status == "unexplained"
        if not self.hidden:
            return self.status == "adequate"
        if self.wrong_name:
            return False
        if not self.visible:
            return self.status == "adequate" or self.first_right
        return self.first_right

    @property
    def to_oracle(self) -> float:
        return self.after / self.oracle


def deflections(path: Path) -> dict[tuple[int, int, int], np.ndarray]:
    """Deflection by (pose, load case, repeat), m."""
    with path.open(encoding="utf-8") as file:
        return {
            (int(r["pose"]), int(r["load_case"]), int(r["repeat"])): np.array([float(r[f"deflection_{a}"]) for a in "xyz"])
            for r in csv.DictReader(file)
        }


def absolute_error(predicted: Path, true: Path) -> float:
    """RMS over poses of predicted minus true displacement of the TCP, m, less what no session can tell.

    Where the station stands in base_link and where the marker sits in the tool are unknowns of an absolute session: a motion of
    everything and a shift in the tool are taken out.
    """
    said = deflections(predicted)
    with true.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    keys = [(int(r["pose"]), int(r["load_case"]), int(r["repeat"])) for r in rows]
    difference = np.array([said[k] - [float(r[f"deflection_{a}"]) for a in "xyz"] for k, r in zip(keys, rows, strict=True)])
    p = np.array([[float(r[f"tcp_{a}"]) for a in "xyz"] for r in rows])
    R = np.array([[float(r[f"R_{i}{j}"]) for i in "xyz" for j in "xyz"] for r in rows]).reshape(-1, 3, 3)
    cross = np.zeros((len(p), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = p[:, 2], -p[:, 1], p[:, 0]
    cross -= cross.swapaxes(1, 2)
    columns = np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), cross, R], axis=2).reshape(-1, 9)
    flat = difference.ravel()
    left = flat - columns @ np.linalg.lstsq(columns, flat, rcond=None)[0]
    return float(np.sqrt((left.reshape(-1, 3) ** 2).sum(1).mean()))


def validation_error(predicted: dict[tuple[int, int, int], np.ndarray], true: dict[tuple[int, int, int], np.ndarray]) -> float:
    """RMS over samples of the norm of the difference, m."""
    return float(np.sqrt(np.mean([((predicted[k] - v) ** 2).sum() for k, v in true.items()])))


def accused_poses(diagnosis: Any, listed: bool = False) -> set[int]:
    """Poses of all rows that a diagnosis lists as doubtful, under whatever key says so."""
    found: set[int] = set()
    if isinstance(diagnosis, dict):
        if listed and isinstance(diagnosis.get("pose"), (int, float)):
            found.add(int(diagnosis["pose"]))
        for key, value in diagnosis.items():
            found |= accused_poses(value, listed or bool(ROWS.search(key)))
    elif isinstance(diagnosis, list):
        for value in diagnosis:
            found |= accused_poses(value, listed)
    return found


def read_case(row: dict[str, str], truth: Path, out: Path) -> Case:
    """Everything about one session; a row of matrix.csv, the folder of the truth, the folder that run.py wrote."""
    background = row["background"].split() if row["kind"] == "absolute" else []
    case = Case(
        row["name"], row["kind"], float(row["strength"]), row["effects"].split(), background,
        row["visible"].split(), row["variables"].split(), row["claim"] == "right", row["mishap"],
        plain=row["tail"] == "normal" and row["slow"] == "0", oracle=float(row["oracle_m"]), base=float(row["base_m"]),
    )  # fmt: skip
    hidden = yaml.safe_load((truth / case.name / "truth.yaml").read_text(encoding="utf-8"))
    case.mishap_pose = next((int(m["pose"]) for m in hidden.get("mishaps", [])), 0)
    there = out / case.name
    if not (there / "timing.json").exists():
        case.failed, case.status = True, "FAILED"
        return case
    said = case.said = json.loads((there / "diagnosis.json").read_text(encoding="utf-8"))
    ladder = json.loads((there / "ladder.json").read_text(encoding="utf-8"))
    verdict = said["verdict"]
    case.status, case.named, case.depends_on = verdict["status"], verdict["effects"], verdict.get("depends_on", [])
    case.ladder = [s["added"] for s in ladder["steps"] if s.get("added") and s["added"] not in FORM and s.get("named", True)]
    case.ranked = [c["effect"] for c in said["candidates"]]
    case.accused = sorted(accused_poses(said))
    if case.kind == "absolute":
        case.after = absolute_error(there / "model.csv", truth / case.name / "truth.csv")
    else:
        case.after = validation_error(deflections(there / "model.csv"), deflections(truth / case.name / "truth.csv"))
    case.seconds = json.loads((there / "timing.json").read_text(encoding="utf-8"))["improve_s"]
    model = yaml.safe_load((there / "model.yaml").read_text(encoding="utf-8"))
    case.expected = float((model.get("figures") or {}).get("expected_error_m", "nan"))
    for one in hidden["effects"]:
        effect = one["effect"]
        where = hidden_axes(effect, one["parameters"])
        if where is not None and effect in case.named:
            text = axes_in_text(verdict["text"], effect.replace("_", " "))
            case.axes.append(score_axes(effect, where, said, text, axes_in_model(model, effect), ladder))
    return case
