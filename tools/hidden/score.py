# SPDX-License-Identifier: Apache-2.0
"""Score what the tool said about a matrix of sessions against the truth.

    python tools/hidden/score.py DIR DIR-truth OUT

An oracle that is told which effect is hidden fits the 18-DOF model with it to the same session. An effect is visible where
the oracle gains significantly. Validation error: RMS difference between predicted and true deflection of the TCP at other
poses. Where an effect was hidden in particular axes, the axes that the tool names are compared too; an axis that is named and
has nothing hidden counts as a wrong name.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from axes import AxisScore, axes_in_model, axes_in_text, axes_in_words, hidden_axes, score_axes
from irec_calibration.diagnose import start_terms
from irec_calibration.diagnose.held_out import held_out
from irec_calibration.diagnose.improve import add_effect, versioned
from irec_calibration.diagnose.study import prepare
from irec_calibration.diagnose.tool_weight import reference_readings
from irec_calibration.effects import find_effect
from irec_calibration.errors import IrecError
from irec_calibration.model import Model
from irec_calibration.scene import scene_of
from irec_calibration.session import read_session

NATS_VISIBLE = 5.0  # log evidence that the oracle must gain


@dataclass
class Case:
    """One session: what was hidden, what was said, validation errors in m."""

    name: str
    kind: str
    strength: float
    hidden: list[str]
    status: str = ""
    named: list[str] = field(default_factory=list)
    confusable: list[str] = field(default_factory=list)
    ranked: list[str] = field(default_factory=list)
    depends_on: list[str] = field(default_factory=list)
    axes: list[AxisScore] = field(default_factory=list)
    visible: bool = False
    before: float = float("nan")
    after: float = float("nan")
    oracle: float = float("nan")
    seconds: float = float("nan")

    @property
    def first_right(self) -> bool:
        return bool(self.named) and (self.named[0] in self.hidden or any(c in self.hidden for c in self.confusable))

    @property
    def among_three(self) -> bool:
        return self.first_right or any(e in self.hidden for e in [*self.named, *self.ranked][:3])

    @property
    def wrong_axis(self) -> bool:
        return any(a.is_wrong for a in self.axes)

    @property
    def right(self) -> bool:
        expected = {"clean": "adequate", "outside": "unexplained"}.get(self.kind)
        return self.first_right and not self.wrong_axis if expected is None else self.status == expected

    @property
    def wrong_with_confidence(self) -> bool:
        return self.status == "missing_effect" and (not self.first_right or self.wrong_axis)


def deflections(path: Path) -> dict[tuple[int, int, int], np.ndarray]:
    """Deflection by (pose, load case, repeat), m."""
    with path.open(encoding="utf-8") as file:
        return {
            (int(r["pose"]), int(r["load_case"]), int(r["repeat"])): np.array([float(r[f"deflection_{a}"]) for a in "xyz"])
            for r in csv.DictReader(file)
        }


def validation_error(predicted: dict[tuple[int, int, int], np.ndarray], true: dict[tuple[int, int, int], np.ndarray]) -> float:
    """RMS over samples of the norm of the difference, m."""
    return float(np.sqrt(np.mean([((predicted[k] - v) ** 2).sum() for k, v in true.items()])))


def oracle(folder: Path, case: Case, true: dict[tuple[int, int, int], np.ndarray]) -> tuple[bool, float]:
    """Whether the hidden effects show, and the validation error of the model that has them."""
    session = read_session(folder / "sessions" / case.name)
    study = prepare(session, start_terms(session))
    model: Model = versioned(study, held_out(study), None, "start")
    gained = 0.0
    for effect in case.hidden:
        if effect == "tool_weight":
            readings = reference_readings(study.ready, session.noise.force_n)
            gained += readings.log_evidence if readings else 0.0
            continue
        try:
            before = study.bench.posterior(study.base).log_evidence
            model, _, study = add_effect(model, find_effect(effect), session)
        except IrecError:
            continue
        gained += study.bench.posterior(study.base).log_evidence - before
    validation = read_session(folder / "validation" / case.name)
    deflection = model.predict(scene_of(validation, observe="tcp"))
    keys = zip(validation.pose.tolist(), validation.load_case.tolist(), validation.repeat.tolist(), strict=True)
    predicted = {(int(p), int(j), int(r)): deflection[i] for i, (p, j, r) in enumerate(keys)}
    return gained > NATS_VISIBLE, validation_error(predicted, true)


def read_case(row: dict[str, str], folder: Path, truth: Path, out: Path) -> Case:
    """Everything about one session."""
    case = Case(row["name"], row["kind"], float(row["strength"]), row["effects"].split())
    true = deflections(truth / case.name / "truth.csv")
    said = json.loads((out / case.name / "diagnosis.json").read_text(encoding="utf-8"))
    verdict = said["verdict"]
    case.status, case.named, case.depends_on = verdict["status"], verdict["effects"], verdict["depends_on"]
    case.ranked = [c["effect"] for c in said["candidates"]]
    if case.named:
        lead = next((c for c in said["candidates"] if c["effect"] == case.named[0]), None)
        case.confusable = [c.split(":")[0] for c in lead["confusable_with"]] if lead else []
    case.before = validation_error(deflections(out / case.name / "base.csv"), true)
    case.after = validation_error(deflections(out / case.name / "model.csv"), true)
    case.seconds = json.loads((out / case.name / "timing.json").read_text(encoding="utf-8"))["improve_s"]
    case.axes = read_axes(case, said, truth, out)
    if case.kind in ("single", "pair"):
        case.visible, case.oracle = oracle(folder, case, true)
    return case


def read_axes(case: Case, said: dict[str, Any], truth: Path, out: Path) -> list[AxisScore]:
    """The axes of every hidden effect that was named."""
    hidden = yaml.safe_load((truth / case.name / "truth.yaml").read_text(encoding="utf-8"))["effects"]
    model = yaml.safe_load((out / case.name / "model.yaml").read_text(encoding="utf-8"))
    ladder = json.loads((out / case.name / "ladder.json").read_text(encoding="utf-8"))
    scores = []
    for one in hidden:
        effect = one["effect"]
        where = hidden_axes(effect, one["parameters"])
        if where is not None and effect in case.named:
            text = axes_in_text(said["verdict"]["text"], find_effect(effect).label)
            scores.append(score_axes(effect, where, said, text, axes_in_model(model, effect), ladder))
    return scores


def rate(cases: list[Case], test: str) -> str:
    """Share of the cases that pass a test, as text."""
    passed = sum(bool(getattr(c, test)) for c in cases)
    return f"{passed} of {len(cases)} ({100 * passed / len(cases):.0f} %)" if cases else "no case"


def axes_of(a: AxisScore) -> str:
    """Axes named and hidden, for the line of a session."""
    named = ", ".join(sorted(a.right | a.wrong)) or ("not told apart" if a.offered else "no axis")
    return f"[{a.kind}: {named}; hidden {', '.join(sorted(a.hidden)) if len(a.hidden) < 6 else 'all'}]"


def summary(cases: list[Case]) -> str:
    """The score table."""
    lines = []
    single = [c for c in cases if c.kind == "single"]
    for strength in sorted({c.strength for c in single}):
        visible = [c for c in single if c.strength == strength and c.visible]
        every = [c for c in single if c.strength == strength]
        lines.append(f"hidden effect at {100 * strength:.0f} %: {len(visible)} of {len(every)} visible to the oracle")
        lines.append(f"  first named right      {rate(visible, 'first_right')}")
        lines.append(f"  among the first three  {rate(visible, 'among_three')}")
        axis = sum(c.first_right and c.wrong_axis for c in every)
        lines.append(f"  wrong name, confident  {rate(every, 'wrong_with_confidence')}, {axis} of them only a wrong axis")
    strong = [c for c in single if c.strength >= 0.08 and c.visible]
    lines.append(f"all at 8 % and more, visible: first {rate(strong, 'first_right')}, first three {rate(strong, 'among_three')}")
    pairs = [c for c in cases if c.kind == "pair" and c.visible]
    lines.append(
        f"pairs: first right {rate(pairs, 'first_right')}; both named {sum(set(c.hidden) <= set(c.named) for c in pairs)}"
    )
    clean = [c for c in cases if c.kind == "clean"]
    lines.append(f"clean cells: false alarms {sum(c.status != 'adequate' for c in clean)} of {len(clean)}")
    outside = [c for c in cases if c.kind == "outside"]
    lines.append(f"outside the catalogue: called unexplained {sum(c.status == 'unexplained' for c in outside)} of {len(outside)}")
    lines += axes_in_words([a for c in cases for a in c.axes])
    for label, some in (
        ("8 % and more", strong),
        ("3 %", [c for c in single if c.strength < 0.08 and c.visible]),
        ("pairs", pairs),
    ):
        if some:
            to_oracle = np.median([c.after / c.oracle for c in some])
            to_before = np.median([c.after / c.before for c in some])
            lines.append(f"validation error, {label}, median: after/oracle {to_oracle:.2f}, after/before {to_before:.2f}")
    if clean:
        to_plain = np.median([c.after / c.before for c in clean])
        lines.append(f"validation error, clean cells, median: after/18-DOF least squares {to_plain:.2f}")
    lines.append(
        f"irec improve: median {np.median([c.seconds for c in cases]):.1f} s, slowest {max(c.seconds for c in cases):.1f} s"
    )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description="Score a blind run against the truth.")
    parser.add_argument("matrix", type=Path, help="folder with sessions/ and validation/")
    parser.add_argument("truth", type=Path, help="folder with matrix.csv")
    parser.add_argument("output", type=Path, help="folder that run.py wrote")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    with (args.truth / "matrix.csv").open(encoding="utf-8") as file:
        rows = [r for r in csv.DictReader(file) if (args.output / r["name"] / "diagnosis.json").exists()]
    if not rows:
        print(f"{args.output}: no result of run.py for a session of {args.truth}", file=sys.stderr)
        return 2
    with ProcessPoolExecutor(args.processes) as pool:
        n = len(rows)
        cases = list(pool.map(read_case, rows, [args.matrix] * n, [args.truth] * n, [args.output] * n))
    for c in sorted(cases, key=lambda c: (c.kind, c.hidden, c.strength)):
        hidden, said = "+".join(c.hidden) or "-", "+".join(c.named)
        seen = "" if c.visible or c.kind in ("clean", "outside") else "(not visible)"
        mark = "ok" if c.right else "--"
        where = "; ".join(axes_of(a) for a in c.axes)
        print(f"{mark} {c.name} {c.kind:8} {hidden:40} {100 * c.strength:3.0f} % {c.status:15} {said} {where} {seen}".rstrip())
    print(summary(cases))
    return 0


if __name__ == "__main__":
    sys.exit(main())
