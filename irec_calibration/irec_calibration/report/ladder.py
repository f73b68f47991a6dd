# SPDX-License-Identifier: Apache-2.0
"""The report of an improvement: the held-out error falls model by model down to the noise floor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..codec import pose_data, run_codec
from ..codec.algorithm1 import ESTIMATOR as CODEC_ESTIMATOR
from ..diagnose.comparison import compare
from ..diagnose.improve import Ladder, Rung
from ..diagnose.result import Comparison
from ..effects import find_effect
from ..effects.formula import in_words
from ..effects.of_session import carrying
from ..errors import IrecError
from ..identification.validation import ESTIMATOR
from ..lengths import length
from ..session.data import Session
from ..typing import Array, IntArray
from . import models, samples
from .codec_charts import save_chart
from .next_steps import after_improvement
from .page import Figure, Page, Section, Table, write_page


def write_ladder_report(
    ladder: Ladder, session: Session, folder: Path, more: tuple[Section, ...] = (), *, named: tuple[str, str] = ("", "")
) -> list[Path]:
    """Write the figures and report.html into a folder; returns the files, the page first.

    Args:
        more: sections to append, e.g. the course driven again.
        named: paths of session and new model as the user typed them, for commands to copy.
    """
    hero = _picture(ladder, folder)
    last = ladder.rungs[-1]
    named_all = len(ladder.rungs) > 1 and all(r.named or r.usual for r in ladder.rungs)
    explained = named_all and not ladder.before.verdict.remaining_m
    page = Page(
        title=f"How the error fell: {session.name}",
        subtitle=f"Robot {session.serial or 'without serial'}, {len(session.poses)} poses, model {' + '.join(last.effects)}",
        verdict=_verdict(ladder),
        status="adequate" if explained else ladder.before.verdict.status,
        hero=hero,
        todo=after_improvement(
            ladder,
            named[0] or str(session.path or "SESSION"),
            named[1] or "model.yaml",
            without_tracker=session.contact is not None,
        ),
        sections=[_ladder(ladder), *_before_after(ladder, session, folder), *_codec(ladder, session, folder), *more],
    )
    figures = [hero.path, *(f.path for s in page.sections for f in s.figures)]
    return [write_page(page, folder / "report.html"), *figures]


def _verdict(ladder: Ladder) -> str:
    """What was added, and what of it is no diagnosis."""
    named = [r for r in ladder.rungs[1:] if r.named or r.one_of]
    usual = [r for r in ladder.rungs if r.usual]
    others = [r for r in ladder.rungs if r.stands_in]
    first, last = ladder.rungs[0], ladder.rungs[-1]
    before = ladder.rungs[ladder.rungs.index(others[0]) - 1] if others else last
    if len(ladder.rungs) == 1:
        return f"No effect was added: {ladder.stopped}. {ladder.before.verdict.text}"
    said = []
    if named or usual:
        errors = f"from {length(first.cv_rms_m)} to {length(before.cv_rms_m)}"
        added = [_labels(named)] if named else []
        added += [f"what every robot has ({_labels(usual)})"] if usual else []
        said.append(f"Adding {' and '.join(added)} lowers the error on held-out poses {errors}.")
    said += ladder.before.verdict.where.values()
    for r in named:
        if r.one_of:
            said.append(f"These data do not tell which it is, {' or '.join(find_effect(i).label for i in r.one_of)}.")
    if usual:
        said.append(f"{_labels(usual).capitalize()} of that size is no cause to look for.")
    if others:
        said.append(
            f"To predict what has no name the model has {_labels(others)}, which is no diagnosis: the error on held-out poses is"
            f" then {length(last.cv_rms_m)} for {length(before.cv_rms_m)}."
        )
    said.append(f"The instruments' noise is {length(ladder.noise_floor_m)}. Stopped because {ladder.stopped}.")
    return " ".join(said)


def _labels(rungs: Sequence[Rung]) -> str:
    effects = [{t.effect.id: t.effect for t in r.model.terms} for r in rungs]
    return " and ".join(in_words(of[i]) for r, of in zip(rungs, effects, strict=True) for i in r.added.split("+"))


def _picture(ladder: Ladder, folder: Path) -> Figure:
    rungs = ladder.rungs
    errors, ses = [r.cv_rms_m for r in rungs], [r.cv_rms_se_m for r in rungs]
    unsure = [not r.named for r in rungs]
    picture = models.ladder([r.title for r in rungs], errors, ses, unsure, ladder.noise_floor_m, folder / "ladder.png")
    text = "Error on poses that the model was not fitted to, with its standard error over poses."
    if any(unsure):
        text += " Hollow: with what is one of several, is as in every robot, or predicts what has no name: no diagnosis."
    return Figure(picture, f"{text} Estimator: {ESTIMATOR}.")


def _ladder(ladder: Ladder) -> Section:
    rungs = ladder.rungs
    rows = []
    for r in rungs:
        term = next((t for t in r.model.terms if t.effect.id == r.added), None)
        values = "; ".join(f"{n} = {e}" for n, e in list(term.estimates.items())[:6]) if term else ""
        rows.append([r.title, f"{length(r.cv_rms_m)} +- {length(r.cv_rms_se_m)}", length(r.fit_rms_m), values])
    added = [find_effect(i) for r in rungs if r.added and (r.named or r.one_of) for i in r.added.split("+")]
    physics = [f"{effect.label.capitalize()}: {effect.physics}" for effect in added]
    return Section("What was added", physics, tables=[Table(["model", "held-out", "fit", "parameters added"], rows)])


def _before_after(ladder: Ladder, session: Session, folder: Path) -> list[Section]:
    if len(ladder.rungs) < 2:
        return []
    before, after = (
        compare(carrying(session, r.model.carried), r.model.terms, r.model.sag_share) for r in (ladder.rungs[0], ladder.rungs[-1])
    )
    rows, residuals = in_both(before, after)
    figure = samples.residual_maps(
        session.p_tcp_in_base[rows], residuals, ["Before", "After"], folder / "before_after.png",
        poses=session.pose[rows], on_surface=session.kind == "loaded",
    )  # fmt: skip
    text = "Residual vectors on the same scale."
    if len(rows) < max(len(before.rows), len(after.rows)):
        text += " Only samples that both models have: beside one of them others are plainly wrong."
    return [Section("What the model leaves, before and after", figures=[Figure(figure, text)])]


def in_both(before: Comparison, after: Comparison) -> tuple[IntArray, list[Array]]:
    """Session rows that two models were both compared on, and the residual of each model there, (m, 3) each, m."""
    rows, mine, others = np.intersect1d(before.rows, after.rows, return_indices=True)
    return rows, [before.residual[mine], after.residual[others]]


def _codec(ladder: Ladder, session: Session, folder: Path) -> list[Section]:
    if len(ladder.rungs) < 2 or session.kind != "loaded":
        return []
    try:
        codecs = [
            run_codec(pose_data(session, r.model.terms), label=label)
            for r, label in ((ladder.rungs[0], "before"), (ladder.rungs[-1], "after"))
        ]
        figure = save_chart(codecs, folder / "codec.png", "Old and new model on the same verification poses")
    except IrecError as error:
        return [Section("Growth of accuracy", [f"No chart: {error}"])]
    text = (
        "Error on unseen poses against the number of poses that the model was fitted to, old and new model on the same folds"
        f" ({CODEC_ESTIMATOR})."
    )
    return [Section("Growth of accuracy", figures=[Figure(figure, text)])]
