# SPDX-License-Identifier: Apache-2.0
"""What the workbench computes, with the functions that the commands use. Runs in a worker process and keeps what it prepared.

A version of the model is a file, so that nothing is lost when a worker is ended in the middle of a computation.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..cell import read_cell
from ..codec import run_codec
from ..codec.algorithm1 import pose_data
from ..diagnose import (
    Attempt,
    Study,
    added,
    attempt,
    compare_observed,
    diagnose,
    held_out,
    held_out_beside,
    remove_effect,
    start_terms,
    validated,
    versioned,
    with_error,
    write_json,
)  # fmt: skip
from ..diagnose.on_course import on_course
from ..effects import Effect, known_effects
from ..effects.formula import FormulaEffect
from ..effects.of_session import carrying
from ..effects.user import effect_from_text, register_file
from ..errors import EffectError, IrecError, ModelError
from ..files import all_or_none
from ..identification.validation import HeldOut
from ..model import Model, Term
from ..model.file import check_belongs, load_model, save_model
from ..poses.course import Course, course_of
from ..report.addition import addition_of
from ..session import Session, read_session
from .checklist import checklist
from .free_names import free_path
from .plain import Codecs, CourseView, EffectEntry, ParameterEntry, SessionView, Tried, Version
from .view import view_of

Progress = Callable[[float, str], None]
Cancelled = Callable[[], bool]


class Desk:
    """One session on the desk of a worker."""

    def __init__(self, effect_files: tuple[str, ...] = ()) -> None:
        for path in effect_files:
            register_file(path)
        self._sessions: dict[str, tuple[float, Session]] = {}
        self._studies: dict[tuple[str, str], Study] = {}
        self._courses: dict[str, Course | None] = {}
        self._trials: dict[tuple[str, str, str], Attempt] = {}

    def ready(self, progress: Progress, cancelled: Cancelled) -> None:
        """Nothing: answers as soon as the process has started."""

    def view(self, session: str, progress: Progress, cancelled: Cancelled) -> SessionView:
        """What there is to draw of a session."""
        progress(0.1, "reading the session")
        return view_of(self._session(session))

    def inspect(self, path: str, progress: Progress, cancelled: Cancelled) -> list[tuple[str, str]]:
        """A checklist of a folder or recording: (`ok`, `note`, `lost` or `bad`, what it is)."""
        progress(0.1, "looking at what is there")
        return checklist(path)

    def start(self, session: str, model: str, folder: str, progress: Progress, cancelled: Cancelled) -> Version:
        """The first version: a model file's effects, or what a diagnosis starts from, fitted to the session."""
        data = self._session(session)
        loaded = load_model(model) if model else None
        if loaded is not None:
            check_belongs(loaded, data.robot, data.serial)
            data = carrying(data, loaded.carried)
        progress(0.2, "fitting the model")
        fitted = validated(data, loaded.terms if loaded else start_terms(data))
        made = with_error(versioned(fitted, loaded, "opened in the workbench"), fitted.expected_error)
        return self._version(session, fitted.study, fitted.held_out, made, folder, " + ".join(made.effects))

    def describe(self, session: str, model: str, name: str, progress: Progress, cancelled: Cancelled) -> Version:
        """A version that was kept before, drawn again on the session as it is now."""
        progress(0.2, "fitting the model")
        study, cv = self._study(session, model), held_out(self._study(session, model))
        return describe(study, cv, load_model(model), model, name)

    def quick(self, session: str, model: str, text: str, progress: Progress, cancelled: Cancelled) -> Tried:
        """An effect on top of a version, everything refitted jointly in the linear problem: the answer within a moment."""
        study = self._study(session, model)
        effect = new_effect(text, load_model(model))
        tried = attempt(study, effect)
        self._trials[session, model, text] = tried
        said = addition_of(tried.before, tried.after, tried.term, effect.parameters(study.ready))
        return Tried(
            effect.id,
            text,
            "",
            _effect_entry(tried.term, study),
            tried.residual,
            tried.after.rms_m,
            tried.after.rms_se_m,
            tried.after.residual,
            said.p_value,
            said.sentence,
            said.supported,
            exact=False,
        )

    def exact(self, session: str, model: str, text: str, folder: str, progress: Progress, cancelled: Cancelled) -> Tried:
        """The same as `irec add`: the effect fitted exactly, with the parts of it that the session asks for, as a model file."""
        study, parent = self._study(session, model), load_model(model)
        effect = new_effect(text, parent)
        progress(0.1, f"refitting with {effect.id}")
        made, before, after = added(self._session(session), study, parent, effect, self._trials.get((session, model, text)))
        old, new = held_out(before), held_out(after)
        version = self._version(session, after, new, made, folder, f"+ {effect.id}")
        term = next(t for t in made.terms if t.effect.id == effect.id)
        said = addition_of(old, held_out_beside(before, after), term, effect.parameters(after.ready))
        entry = next(e for e in version.effects if e.id == effect.id)
        return Tried(
            effect.id,
            text,
            version.model,
            entry,
            version.residual,
            version.cv_rms_m,
            version.cv_rms_se_m,
            new.residual,
            said.p_value,
            said.sentence,
            said.supported,
            exact=True,
            version=version,
        )

    def without(self, session: str, model: str, effect: str, folder: str, progress: Progress, cancelled: Cancelled) -> Version:
        """A version without one of its effects, refitted."""
        progress(0.2, f"refitting without {effect}")
        made, study = remove_effect(load_model(model), effect, self._session(session))
        return self._version(session, study, held_out(study), made, folder, f"- {effect}")

    def diagnosis(self, session: str, model: str, progress: Progress, cancelled: Cancelled) -> dict[str, object]:
        """`irec diagnose` with a version: the content of diagnosis.json, with the label of each candidate."""
        found = diagnose(self._session(session), load_model(model), progress=progress, cancelled=cancelled)
        data = found.to_json()
        known = known_effects()
        data["labels"] = {c.effect: known[c.effect].label if c.effect in known else c.effect for c in found.candidates}
        data["physics"] = {c.effect: known[c.effect].physics for c in found.candidates if c.effect in known}
        return data

    def codec(self, session: str, models: list[tuple[str, str]], progress: Progress, cancelled: Cancelled) -> Codecs:
        """Error on unseen poses against the number of training poses, of up to two versions on the same folds."""
        data = self._session(session)
        out = {}
        floor = float("nan")
        for i, (name, model) in enumerate(models):
            progress(i / len(models), f"growth of accuracy of {name}")
            if cancelled():
                raise EffectError("cancelled")
            made = run_codec(pose_data(data, load_model(model).terms), label=name)
            out[name] = 1e3 * np.percentile(made.norm_mean, [25, 50, 75], axis=0)
            floor = 1e3 * made.floor_mean
        return Codecs(out, floor)

    def course(self, session: str, cell: str, first: str, model: str, progress: Progress, cancelled: Cancelled) -> CourseView:
        """The process course of the cell: what a version predicts, and what a correction with the first one leaves."""
        progress(0.1, "driving the course with the model")
        data = self._session(session)
        if cell not in self._courses:
            self._courses[cell] = course_of(read_cell(cell), data)
        course = self._courses[cell]
        if course is None:
            raise IrecError(f"{cell} has no section 'course'")
        found = on_course(course, load_model(first), self._study(session, model))
        return CourseView(found.in_words(), found.s, found.without, found.before, found.se, found.tolerance)

    def report(self, session: str, model: str, folder: str, progress: Progress, cancelled: Cancelled) -> list[str]:
        """`irec report` of a version; returns the files, the page first."""
        from ..report.diagnosis import write_diagnosis_report

        data = self._session(session)
        found = diagnose(data, load_model(model), progress=progress, cancelled=cancelled)
        with all_or_none():
            write_json(found.to_json(), Path(folder) / "diagnosis.json")
            return [str(p) for p in write_diagnosis_report(found, data, Path(folder))]

    def _session(self, path: str) -> Session:
        stamp = changed(Path(path))
        known = self._sessions.get(path)
        if known is None or known[0] != stamp:
            self._studies = {k: v for k, v in self._studies.items() if k[0] != path}
            self._trials = {k: v for k, v in self._trials.items() if k[0] != path}
            self._sessions[path] = known = (stamp, read_session(path))
        return known[1]

    def _study(self, session: str, model: str) -> Study:
        data = self._session(session)
        key = (session, model)
        if key not in self._studies:
            loaded = load_model(model)
            self._studies[key] = validated(carrying(data, loaded.carried), loaded.terms).study
        return self._studies[key]

    def _version(self, session: str, study: Study, cv: HeldOut, model: Model, folder: str, name: str) -> Version:
        path = str(save_model(model, free_path(Path(folder), "version", ".yaml")))
        self._studies[session, path] = study
        return describe(study, cv, model, path, name)


def describe(study: Study, cv: HeldOut, model: Model, path: str, name: str) -> Version:
    """A version for the screen."""
    c = compare_observed(study.observation, study.terms, study.fit.rank)
    entries = tuple(_effect_entry(t, study) for t in model.terms)
    sigma = np.sqrt(3.0) * np.sqrt(study.observation.whiten.sigma**2 + study.observation.whiten.sigma_reference**2)
    return Version(
        name=name,
        model=path,
        effects=entries,
        combinations=tuple(str(x) for x in model.combinations),
        rows=c.rows,
        measured=c.measured,
        predicted=c.predicted,
        residual=c.residual,
        sigma=sigma,
        held_out=cv.residual,
        fit_rms_m=c.rms_m,
        cv_rms_m=cv.rms_m,
        cv_rms_se_m=cv.rms_se_m,
        noise_m=c.noise_floor_m,
        repeat_m=c.repeat_floor_m,
        notes=c.notes,
    )


def _effect_entry(term: Term, study: Study) -> EffectEntry:
    own = {p.name: p for p in term.effect.parameters(study.ready)}
    entries = []
    for name, e in term.estimates.items():
        p = own.get(name)
        low, high = p.plausible_range if p else (-np.inf, np.inf)
        entries.append(ParameterEntry(name, e.value, e.se, e.unit, e.lower, e.upper, e.identified, bool(low <= e.value <= high)))
    formula = term.effect.formula if isinstance(term.effect, FormulaEffect) else ""
    return EffectEntry(term.effect.id, term.effect.label, term.effect.physics, formula, tuple(entries))


def new_effect(text: str, model: Model) -> Effect:
    """The effect that a user named or typed, under an id that the model does not have yet."""
    effect = effect_from_text(text)
    if isinstance(effect, FormulaEffect) and effect.id in model.effects:
        n = next(n for n in range(2, 1000) if f"{effect.id}_{n}" not in model.effects)
        effect = FormulaEffect(f"{effect.id}_{n}", effect.formula)
    if effect.id in model.effects:
        raise ModelError(f"the model has the effect '{effect.id}' already")
    return effect


def changed(path: Path) -> float:
    """A number that changes when a session's files do."""
    if not path.exists():
        return 0.0
    files = [path] if path.is_file() else [p for p in path.iterdir() if p.is_file()]
    return float(sum(f.stat().st_mtime + f.stat().st_size for f in files))
