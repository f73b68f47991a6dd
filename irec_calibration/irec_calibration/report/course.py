# SPDX-License-Identifier: Apache-2.0
"""The process course of a cell before and after, as a section of a report."""

from __future__ import annotations

from pathlib import Path

from ..cell import read_cell
from ..diagnose.improve import add_effect
from ..diagnose.on_course import OnCourse, on_course
from ..diagnose.result import Diagnosis
from ..diagnose.study import prepare
from ..effects import find_effect
from ..errors import IrecError
from ..model import Model
from ..poses.course import course_of
from ..session.data import Session
from ..typing import Array
from . import models
from .page import Figure, Section


def drive(cell: str, session: Session, before: Model, after: Model) -> OnCourse | str:
    """The course of a cell file as the later model predicts it, corrected with the earlier one; or why it can't be predicted.

    Args:
        cell: path of the cell file; an empty string is answered by one.
    """
    if not cell:
        return ""
    try:
        course = course_of(read_cell(cell), session)
        if course is None:
            return f"{cell} has no section 'course': no course is predicted."
        return on_course(course, before, prepare(session, after.terms))
    except IrecError as error:
        return str(error)


def course_section(driven: OnCourse | str, folder: Path) -> list[Section]:
    """What `drive` found, with its figure."""
    if isinstance(driven, str):
        return [Section("The process course could not be predicted", [driven])] if driven else []
    changed = bool((driven.before > 1e-9).any())
    figure = models.course(
        dict.fromkeys(_runs(driven, changed), driven.s), _runs(driven, changed), driven.tolerance, folder / "course.png",
        title="Lateral deviation along the course, as predicted",
    )  # fmt: skip
    return [Section("The process course, driven with the models", [driven.in_words()], [Figure(figure, _caption(changed))])]


def in_words(driven: OnCourse | str) -> str:
    """What `drive` found, for a terminal."""
    return driven if isinstance(driven, str) else driven.in_words()


def _runs(driven: OnCourse, changed: bool) -> dict[str, Array]:
    runs: dict[str, Array] = {"no correction": driven.without}
    if changed:
        runs["corrected with the first model"] = driven.before
    return runs | {"standard error of the last model": driven.se}


def _caption(changed: bool) -> str:
    what = "what a correction with the first model would leave of it, " if changed else ""
    return f"Predicted, not measured: the deviation without correction, {what}and how well the last model is known there."


def with_named_effects(result: Diagnosis, session: Session) -> Model:
    """The diagnosed model with the effects that the verdict names added, as `irec add` does; the model itself where none is."""
    model = result.model
    for effect in result.verdict.effects:
        try:
            model = add_effect(model, find_effect(effect), session)[0]
        except IrecError:  # what can't be added is said by the command that adds it
            continue
    return model
