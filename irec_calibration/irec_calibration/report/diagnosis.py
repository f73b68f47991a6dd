# SPDX-License-Identifier: Apache-2.0
"""The report of a diagnosis: where the model fails, which effect is missing, what to measure next."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..diagnose.result import Candidate, Comparison, Diagnosis
from ..effects import find_effect
from ..model import Estimate
from ..session.data import Session
from . import models, samples
from .page import Figure, Page, Section, Table, write_page

STATUS = {
    "adequate": "The model is adequate",
    "missing_effect": "An effect is missing",
    "unexplained": "There is structure without a name",
}
SHOWN = 12


def write_diagnosis_report(diagnosis: Diagnosis, session: Session, folder: Path) -> list[Path]:
    """Write the figures and report.html into a folder; returns the files, the page first."""
    where = _where(diagnosis, folder)
    which = _which(diagnosis, folder)
    compare = compare_section(diagnosis.comparison, session, folder)
    page = Page(
        title=f"{STATUS[diagnosis.verdict.status]}: {session.name}",
        subtitle=f"Robot {session.serial or 'without serial'}, model {' + '.join(diagnosis.model.effects)}, "
        f"{len(session.poses)} poses, {len(diagnosis.comparison.rows)} samples",
        verdict=diagnosis.verdict.text,
        status=diagnosis.verdict.status,
        sections=[compare, where, which, *_next(diagnosis), *_notes(diagnosis)],
    )
    figures = [f.path for s in page.sections for f in s.figures]
    return [write_page(page, folder / "report.html"), *figures]


def compare_section(comparison: Comparison, session: Session, folder: Path) -> Section:
    """Predicted against measured, residual against noise."""
    rows = comparison.rows
    figures = []
    if session.kind == "loaded":
        reference = session.reference_row()[rows]
        commanded = session.p_tcp_in_base[rows] - session.p_tcp_in_base[reference]
        figures.append(
            Figure(
                samples.norms_per_sample(
                    commanded, comparison.residual, comparison.noise_floor_m, folder / "samples.png", poses=session.pose[rows]
                ),
                "Norm of the commanded displacement of the TCP and of the model's residual, sample by sample.",
            )
        )
    figures += [
        Figure(
            samples.predicted_against_measured(comparison.measured, comparison.predicted, folder / "measured.png"),
            "Measured against predicted displacement of the marker; the line is agreement.",
        ),
        Figure(
            samples.residual_maps(session.p_tcp_in_base[rows], [comparison.residual], ["residual"], folder / "map.png"),
            "Residual vectors at the TCP positions, seen along the direction in which these extend least.",
        ),
    ]
    worst = sorted(comparison.by_pose.items(), key=lambda item: -item[1])[:SHOWN]
    return Section(
        "Compare",
        [
            f"The model leaves {_um(comparison.rms_m)} rms; the instruments' noise explains "
            f"{_um(comparison.noise_floor_m)}, so that "
            f"{_um(comparison.explainable_m)} could be explained by physics that the model lacks.",
            *comparison.notes,
        ],
        figures,
        [
            Table(["load case", "residual rms [um]"], [[case, 1e6 * rms] for case, rms in comparison.by_load_case.items()]),
            Table(["pose (worst first)", "residual rms [um]"], [[pose, 1e6 * rms] for pose, rms in worst]),
        ],
    )


def _where(diagnosis: Diagnosis, folder: Path) -> Section:
    if not diagnosis.where:
        return Section("Where", ["No view of the residual shows structure."])
    shown = diagnosis.where[:SHOWN]
    figure = models.views([w.view for w in shown], [w.share for w in shown], folder / "where.png")
    rows = [[w.sentence, w.value, 1e6 * w.rms_m, 100 * w.share, w.p_value] for w in shown]
    return Section(
        "Where",
        figures=[Figure(figure, "How much of the squared residual goes along with each view.")],
        tables=[Table(["in words", "largest at", "rms there [um]", "share [%]", "p, corrected"], rows)],
    )


def _which(diagnosis: Diagnosis, folder: Path) -> Section:
    shown = diagnosis.candidates[:SHOWN]
    figures = []
    if shown:
        figures.append(
            Figure(
                models.candidates(
                    [label(c) for c in shown],
                    [c.cv_rms_m for c in shown],
                    [c.cv_rms_se_m for c in shown],
                    diagnosis.cv_rms_m,
                    diagnosis.comparison.noise_floor_m,
                    [label(c) for c in shown if c.effect in diagnosis.verdict.effects],
                    folder / "candidates.png",
                ),
                "Error on held-out poses with each effect added and everything refitted; green: named by the verdict.",
            )
        )
    rows = [
        [
            label(c),
            1e6 * c.cv_rms_m,
            c.p_value,
            "; ".join(f"{n} = {Estimate(**v)}" for n, v in list(c.parameters.items())[:4]),
            "yes" if c.plausible else "no",
            ", ".join(c.confusable_with) or "-",
        ]
        for c in shown
    ]
    header = ["effect", "held-out [um]", "p, corrected", "parameters", "plausible", "can't be told from"]
    physics = [f"{find_effect(e).label}: {find_effect(e).physics}" for e in diagnosis.verdict.effects]
    skipped = [f"Not tried: {', '.join(f'{e} ({why})' for e, why in diagnosis.skipped.items())}."] if diagnosis.skipped else []
    return Section("Which", [*physics, *skipped], figures, [Table(header, rows)])


def label(candidate: Candidate) -> str:
    """Effect with the part of it that is present."""
    return candidate.effect + (f" ({', '.join(candidate.groups[:3])})" if candidate.groups else "")


def _next(diagnosis: Diagnosis) -> list[Section]:
    if not diagnosis.next_measurements:
        return []
    rows = [
        [m.pose or "new", m.load_case, " / ".join(m.separates), 1e6 * m.difference_m, m.gain,
         ", ".join(f"{np.degrees(v):.0f}" for v in m.q)]
        for m in diagnosis.next_measurements
    ]  # fmt: skip
    header = ["pose", "load case", "tells apart", "difference [um]", "in standard deviations", "joint angles [deg]"]
    return [
        Section(
            "What to measure next",
            ["Samples in which the rivals predict the most different displacements."],
            (),
            [Table(header, rows)],
        )
    ]


def _notes(diagnosis: Diagnosis) -> list[Section]:
    notes = [n for n in diagnosis.notes if n not in diagnosis.comparison.notes]
    return [Section("Notes", notes)] if notes else []


def _um(metres: float) -> str:
    return f"{1e6 * metres:.1f} um"



