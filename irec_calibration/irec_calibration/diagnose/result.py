# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says, as plain data that a report can draw, and as `diagnosis.json` (irec-diagnosis/1)."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..files import write_file
from ..identification.noise import InferredNoise
from ..identification.validation import ESTIMATOR
from ..model import Model, Term
from ..typing import Array, IntArray, Json
from .expected_error import ExpectedError
from .part_sets import Parts
from .parts import parts_json
from .proposals import Proposal
from .settings import SETTINGS

FORMAT = "irec-diagnosis/1"
TRIAL = f"trial on top of the model and what completes its springs, in the linear problem about them: {ESTIMATOR}"


@dataclass(frozen=True)
class Candidate:
    """One effect tried on top of the model.

    Attributes:
        effect: id; groups: the parts of it that are present, e.g. `axis 3`.
        cv_rms_m: held-out error of the trial: with it, in the linear problem about the fitted model; cv_rms_se_m: its standard
            error over poses.
        gain, gain_se: mean held-out loss saved per pose (squared stated standard deviations), and its standard error.
        log_evidence: natural log of the odds against the model alone; of what shows in one pose only, against a bad reading too.
        p_value: how often the best of everything that is tried has that log evidence where there is only noise.
        parameters: name -> {value, se, unit}.
        plausible: all values lie in the range that is physically likely.
        confusable_with: effects (`id:group` where only a part) that explain the session equally well.
    """

    effect: str
    groups: tuple[str, ...]
    term: Term
    cv_rms_m: float
    cv_rms_se_m: float
    gain: float
    gain_se: float
    log_evidence: float
    p_value: float
    plausible: bool
    parameters: dict[str, Json]
    confusable_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class Verdict:
    """Status `adequate`, `missing_effect` or `unexplained`.

    Attributes:
        effects: what is missing, most important first.
        depends_on: session columns or `tau_k` that the rest depends on, strongest first.
        size_m: RMS of what is in the residual beyond noise, m; remaining_m: of what has structure beside the named effects.
        evidence: what shows that structure: `repeats`, `held_out_structure`, `flexible_regression`, `readings_that_stand_out`,
            `few_poses`, `wandering`.
        one_of: sets of effects of which one is needed, likeliest first, where they are not told apart.
        usual: effects that are there as in every robot: part of an improved model, no cause to look for.
        hidden_m: how large a cause outside the catalogue could be and not be seen, m.
        explained: share of the explainable excess that the named effects (or the best try) explain.
        confident: no effect is one of several.
        parts: of each named effect that acts in axes or directions: which of them the session proves. An axis that is not
            among the proven ones is not to be acted upon.
        where: of named effects whose values say so, where to look for them in the cell: effect -> a sentence.
        too_few: `adequate` for want of poses or equations: nothing is said of the model.
    """

    status: str
    text: str
    effects: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()
    size_m: float = 0.0
    explained: float = 0.0
    confident: bool = True
    remaining_m: float = 0.0
    evidence: tuple[str, ...] = ()
    one_of: tuple[tuple[str, ...], ...] = ()
    usual: tuple[str, ...] = ()
    hidden_m: float = 0.0
    parts: dict[str, Parts] = field(default_factory=dict)
    where: dict[str, str] = field(default_factory=dict)
    too_few: bool = False

    @property
    def in_short(self) -> str:
        """What a line or a title begins with."""
        return "too few data to judge" if self.too_few else self.status.replace("_", " ")


@dataclass(frozen=True)
class View:
    """The residual seen from one side.

    Attributes:
        view: name of the variable or direction; value: the part of it where the residual is largest.
        rms_m: residual there; share: of the squared residual that this view accounts for; p_value: corrected for the number
            of views; shows: whether it shows more than chance and more than a trifle.
    """

    view: str
    value: str
    rms_m: float
    share: float
    p_value: float
    sentence: str
    shows: bool = False


@dataclass(frozen=True)
class Measurement:
    """A sample worth measuring: where it tells rivals apart.

    Attributes:
        difference_m: between the rivals' predictions as they are fitted.
        gain: evidence to be expected of one sample once both are refitted, nats (`telling`).
        q: joint angles, rad; pose is 0 for a new pose.
        repeats: how often to take it to tell them apart; 0: nobody would take it so often.
    """

    pose: int
    load_case: str
    separates: tuple[str, ...]
    difference_m: float
    gain: float
    q: tuple[float, ...] = ()
    repeats: int = 0


@dataclass(frozen=True)
class Comparison:
    """A model against a session; m observed rows.

    Attributes:
        measured, predicted, residual: (m, 3), m, in base_link; rows: indices in the session.
        rms_m, noise_floor_m: per sample; explainable_m: sqrt(rms^2 - floor^2) or 0.
        repeat_floor_m: from repeats, NaN where there are none.
        by_pose, by_load_case: number -> RMS, m; by_axis: RMS along base x, y, z, m.
        notes: what the user should know, e.g. repeats that disagree with the data sheet.
    """

    rows: IntArray
    measured: Array
    predicted: Array
    residual: Array
    rms_m: float
    noise_floor_m: float
    repeat_floor_m: float
    explainable_m: float
    chi2_per_dof: float
    by_pose: dict[int, float]
    by_load_case: dict[str, float]
    by_axis: tuple[float, float, float]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Diagnosis:
    """Everything that `irec diagnose` found.

    Attributes:
        fit_rms_m, cv_rms_m, cv_rms_se_m: of the model as it was asked about, in the fit and on held-out poses with its standard
            error, by ESTIMATOR.
        cv_rms_after_m, cv_rms_se_after_m: with every effect that was added, and its standard error.
        proposals: formulas for what has structure and no name, best first.
        expected_error: of predictions with every effect that was added; None where the session does not tell.
    """

    session: str
    model: Model
    fit_rms_m: float
    cv_rms_m: float
    cv_rms_after_m: float
    cv_rms_se_after_m: float
    comparison: Comparison
    verdict: Verdict
    candidates: tuple[Candidate, ...]
    skipped: dict[str, str]
    where: tuple[View, ...]
    next_measurements: tuple[Measurement, ...]
    flexible_gain_m: float = math.nan
    notes: tuple[str, ...] = ()
    noise: InferredNoise | None = None
    bad_rows: tuple[Json, ...] = ()
    proposals: tuple[Proposal, ...] = ()
    cv_rms_se_m: float = math.nan
    expected_error: ExpectedError | None = None

    def to_json(self) -> Json:
        """The content of `diagnosis.json`; no NaN."""
        v = self.verdict
        data = {
            "format": FORMAT,
            "session": self.session,
            "model": {
                "effects": list(self.model.effects),
                "fit_rms_m": self.fit_rms_m,
                "cv_rms_m": self.cv_rms_m,
                "cv_rms_se_m": self.cv_rms_se_m,
                "estimator": ESTIMATOR,
            },
            "noise_floor_m": self.comparison.noise_floor_m,
            "noise": noise_json(self.noise),
            "repeat_floor_m": self.comparison.repeat_floor_m,
            "explainable_m": self.comparison.explainable_m,
            "flexible_gain_m": self.flexible_gain_m,
            **({} if self.expected_error is None else {"improved": self.expected_error.figures}),
            "verdict": {
                "status": v.status,
                "effects": list(v.effects),
                "text": v.text,
                "depends_on": list(v.depends_on),
                "size_m": v.size_m,
                "explained": v.explained,
                "confident": v.confident,
                "remaining_m": v.remaining_m,
                "evidence": list(v.evidence),
                "one_of": [list(s) for s in v.one_of],
                "usual": list(v.usual),
                "hidden_m": v.hidden_m,
                **({"too_few": True} if v.too_few else {}),
                "parts": parts_json(v.parts),
                "where": v.where,
                "cv_rms_after_m": self.cv_rms_after_m,
            },
            "candidates_estimator": TRIAL,
            "candidates": [
                {
                    "effect": c.effect,
                    "groups": list(c.groups),
                    "cv_rms_m": c.cv_rms_m,
                    "cv_rms_se_m": c.cv_rms_se_m,
                    "p_value": c.p_value,
                    "log_evidence": c.log_evidence,
                    "plausible": c.plausible,
                    "parameters": c.parameters,
                    "confusable_with": list(c.confusable_with),
                }
                for c in self.candidates
            ],
            "skipped": self.skipped,
            "where": [
                {
                    "view": w.view,
                    "value": w.value,
                    "rms_m": w.rms_m,
                    "share": w.share,
                    "p_value": w.p_value,
                    "shows": w.shows,
                    "text": w.sentence,
                }
                for w in self.where
            ],
            "next_measurements": [
                {
                    "pose": m.pose,
                    "load_case": m.load_case,
                    "separates": list(m.separates),
                    "difference_m": m.difference_m,
                    "gain": m.gain,
                    "repeats": m.repeats,
                    **({"joints": list(m.q)} if m.q else {}),
                }
                for m in self.next_measurements
            ],
            "proposals": [asdict(p) for p in self.proposals],
            "bad_rows": list(self.bad_rows),
            "notes": list(self.notes),
            "settings": SETTINGS.to_json(),
        }
        return finite(data)  # type: ignore[no-any-return]


def noise_json(noise: InferredNoise | None) -> Json | None:
    """The level of the noise for a result file."""
    if noise is None:
        return None
    return {
        "claimed_m": noise.claimed_m,
        "inferred_m": noise.inferred_m,
        "inferred_low_m": noise.low_m,
        "inferred_high_m": noise.high_m,
        "source": noise.source,
        "dof": noise.dof,
        "wander_share": noise.wander_share,
        "wander_time_s": noise.wander_time_s,
    }


def finite(value: Any) -> Any:
    """The same data with null in place of NaN and infinities, and plain Python numbers."""
    if isinstance(value, dict):
        return {str(k): finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(data: Json, path: str | Path) -> Path:
    """Write a result file in one step. IrecError: it can't be written."""
    return write_file(path, json.dumps(finite(data), indent=2, allow_nan=False) + "\n")
