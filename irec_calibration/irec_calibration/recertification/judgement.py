# SPDX-License-Identifier: Apache-2.0
"""What a full procedure says about the calibration in force: it holds, it is renewed, or somebody has to look at the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..diagnose import validated, with_error
from ..identification.identify import fit, identify, observe_with_force_noise
from ..identification.observe import Observation
from ..identification.provenance import model_of
from ..identification.validation import rms
from ..model import EIGHTEEN_DOF, Estimate, Model, Term, axis_compliances, blank_model, total_displacement
from ..procedure.settings import Acceptance
from ..session import Session
from ..typing import Array, IntArray, Json
from .advice import with_advice
from .force_scale import scale_doubt
from .quick_check import QuickResult, check, reference_of
from .station import with_stations_found
from .verdict import Kind, kind_of

ENGINEER = "have an engineer look at it."
HANG_A_WEIGHT = "press nothing; hang a known weight on the tool, mend unit or gain of the force sensor, measure again."
MATTERS = 0.05  # share of the tolerance: an effect that is missing by less is left to the next model


@dataclass(frozen=True)
class Criterion:
    """One condition of the cell file with what was found; `text` is for the person at the cell."""

    name: str
    holds: bool
    text: str


@dataclass(frozen=True)
class Missing:
    """What the diagnosis of the new session names beyond the renewed model: effect ids, proven parts of each, size (m), words."""

    status: str = "not_evaluated"
    effects: tuple[str, ...] = ()
    parts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    size_m: float = 0.0
    text: str = ""


@dataclass(frozen=True)
class Judgement:
    """Result of a full procedure.

    Attributes:
        verdict: `pass`, `recalibrated`, `investigate: what` or `failed: why`.
        text: what it means and what to do now, for the person at the cell.
        model: identified from all poses with the effects of the model in force.
        held_out: pose numbers that were kept apart and judged. rms_new, rms_old: there, of the new model identified without them
            and of the one in force (NaN: none), m.
        noise_floor: m.
        axes: compliances of actuated axes that are known singly, joint (from 0) -> estimate.
        change: test against the calibration in force; None where there is none.
        missing: what the diagnosis of this session names beyond the new model.
    """

    verdict: str
    text: str
    model: Model
    held_out: IntArray
    rms_new: float
    rms_old: float
    noise_floor: float
    criteria: tuple[Criterion, ...]
    axes: dict[int, Estimate]
    change: QuickResult | None
    missing: Missing = Missing()

    @property
    def figures(self) -> Json:
        """Numbers for the record."""
        return {
            "held_out_rms_new_m": self.rms_new,
            "held_out_rms_old_m": self.rms_old if np.isfinite(self.rms_old) else None,
            "noise_floor_m": self.noise_floor,
            "odds_of_change": None if self.change is None else self.change.e_value,
            "like": [] if self.change is None else list(self.change.like),
        }


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


def renewed(session: Session, in_force: Model | None) -> Model:
    """The model in force with its effects and their parts identified anew from a session; 18 DOF where there is none.

    Raises:
        SolveError: the session can't determine it.
    """
    session = with_stations_found(session)
    return model_of(identify(session, _start(in_force)), parent=_parent(in_force))


def judge(
    session: Session, in_force: Model | None, before: Session | None, acceptance: Acceptance, tolerance: float
) -> Judgement:
    """Judge a session of the full procedure.

    Args:
        in_force, before: the model in force and the session that it was made from (None: not kept; then the change is judged by
            the criteria only).
        tolerance: of the process, m.

    Raises:
        SolveError: the session can't determine a model.
    """
    session = with_stations_found(session)
    start = _start(in_force)
    held_out = held_out_poses(session, acceptance.held_out_share)
    training = session.select_poses([p for p in session.poses.tolist() if p not in held_out])
    sag_share = 1.0 if in_force is None else in_force.sag_share
    trained = Model(identify(training, start, sag_share).terms)
    observation = observe_with_force_noise(session, start, sag_share=sag_share)
    rows = np.isin(observation.pose, held_out)
    rms_new = rms(residual_of(trained, observation)[rows])
    rms_old = float("nan") if in_force is None else rms(residual_of(in_force, observation)[rows])
    one_by_one = validated(session, trained.terms)  # as in the file of any other model
    model = model_of(fit(trained.terms, observation), held_out=one_by_one.held_out, parent=_parent(in_force))
    model = with_error(model, one_by_one.expected_error)
    floor = observation.whiten.floor
    change, doubt = None, ""
    if in_force is not None and before is not None:  # a model that was not measured on this robot tells nothing of its sensor
        change = check(reference_of(in_force.terms, before, tolerance, in_force.sag_share), session, last=True)
        doubt = scale_doubt(observation.y, observation.y - residual_of(in_force, observation))
    criteria = _criteria(session, acceptance, rms_new, floor)
    verdict, text = _verdict(criteria, change, in_force, rms_new, rms_old, acceptance)
    if doubt:
        verdict, text = "investigate: force sensor", with_advice(doubt, HANG_A_WEIGHT)
    axes = axis_compliances(model.terms, observation.scene)
    return Judgement(verdict, text, model, held_out, rms_new, rms_old, floor, criteria, axes, change)


def with_diagnosis(judgement: Judgement, missing: Missing, tolerance: float) -> Judgement:
    """The judgement after the diagnosis of the new session: an effect that matters and that is missing is to be looked at."""
    judgement = replace(judgement, missing=missing)
    if missing.status == "missing_effect" and missing.effects and missing.size_m > MATTERS * tolerance:
        if kind_of(judgement.verdict) in (Kind.FAILED, Kind.INVESTIGATE):
            return judgement  # it says what to do now; the certificate has what the diagnosis says
        name = missing.effects[0]
        what = ", ".join([name, *missing.parts.get(name, ())])
        text = with_advice(f"The robot does something that its model lacks: {missing.text}", ENGINEER)
        return replace(judgement, verdict=f"investigate: {what}", text=text)
    return judgement


def residual_of(model: Model, observation: Observation) -> Array:
    """Measured minus predicted displacement of the marker, (m, 3), m, in base_link."""
    return observation.y - observation.of(total_displacement(model.terms, observation.scene))


def _start(in_force: Model | None) -> tuple[Term, ...]:
    return blank_model(EIGHTEEN_DOF) if in_force is None else in_force.terms


def _parent(in_force: Model | None) -> str:
    return "" if in_force is None else str(in_force.made.get("date", ""))


def _criteria(session: Session, a: Acceptance, rms_new: float, floor: float) -> tuple[Criterion, ...]:
    um, n = 1e6, len(session.poses)
    return (
        Criterion("min_poses", n >= a.min_poses, f"{n} poses were measured, at least {a.min_poses} are needed"),
        Criterion(
            "held_out_rms_m", rms_new <= a.held_out_rms_m,
            f"on the poses kept apart, which the fit has not seen, the error is {um * rms_new:.1f} um,"
            f" the limit is {um * a.held_out_rms_m:.1f} um",
        ),
        Criterion(
            "max_noise_floors", rms_new <= a.max_noise_floors * floor,
            f"that is {rms_new / floor:.1f} times the stated noise of {um * floor:.1f} um, the limit is {a.max_noise_floors:g}",
        ),
    )  # fmt: skip


def _verdict(
    criteria: Sequence[Criterion],
    change: QuickResult | None,
    in_force: Model | None,
    rms_new: float,
    rms_old: float,
    a: Acceptance,
) -> tuple[str, str]:
    um = 1e6
    error = f"On poses kept apart the new calibration errs by {um * rms_new:.1f} um"
    error += f", the one in force by {um * rms_old:.1f} um." if in_force is not None else "."
    failed = [c.text for c in criteria if not c.holds]
    if failed:
        few = [c for c in criteria if c.name == "min_poses" and not c.holds]
        advice = (
            "measure the rest of the poses (start again with resume)"
            if few
            else "check that tool, disc and tracker are fast, then measure again"
        )
        return f"failed: {failed[0]}", with_advice(
            f"{error} It is not put in force, because {'; and '.join(failed)}.", f"{advice}."
        )
    if in_force is None:
        return "recalibrated", f"{error} It is the first calibration of this robot."
    if change is None or change.decision != "changed" or not change.like:
        if rms_new <= rms_old * a.max_ratio_to_old and rms_old > a.held_out_rms_m:
            return "recalibrated", f"{error} The one in force no longer meets the limit of {um * a.held_out_rms_m:.1f} um."
        as_it_was = "is as it was when it was calibrated"
        if change is not None and change.decision == "changed":
            as_it_was = "differs by micrometres only from when it was calibrated"
        return "pass", f"{error} The robot {as_it_was}. Nothing has to be done."
    looks = _looked_at(change)
    if looks:
        words = " or ".join(change.words[n] for n in change.like[:3])
        found = (
            f"{error} The robot has changed in a way that a new calibration should not hide. It looks like: {words}. The new"
            " calibration is stored but not in force."
        )
        text = with_advice(found, f"{_where_to_look(change)}; mend what you find, measure again.")
        return f"investigate: {' or '.join(looks)}", text
    if rms_new > rms_old * a.max_ratio_to_old:
        text = with_advice(f"{error} The robot has changed, but the new calibration is no better.", ENGINEER)
        return "failed: the new calibration is not better than the one in force", text
    likely = " or ".join(change.words[n] for n in change.like[:3])
    return "recalibrated", f"{error} The robot has changed: {likely}. The new calibration takes that into account."


def _where_to_look(change: QuickResult) -> str:
    """What a person with a spanner looks at."""
    return ", ".join(dict.fromkeys(change.named[n].ageing.look for n in change.like[:3]))


def _looked_at(change: QuickResult) -> list[str]:
    """What may be broken: what a new calibration must not take into account before somebody has looked."""
    out = []
    for name in change.like[:3]:
        cause = change.named[name]
        if not cause.ageing.renewable:
            out.append(f"{cause.effect}, {cause.part}" if cause.part else cause.effect)
        elif change.size[name] > cause.ageing.renewable:
            out.append(change.words[name])
    return list(dict.fromkeys(out))
