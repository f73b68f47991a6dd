# SPDX-License-Identifier: Apache-2.0
"""The report of a diagnosis: verdict, the one figure that shows it, what to do next; then the evidence."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..diagnose.result import Candidate, Comparison, Diagnosis, View
from ..effects import find_effect, known_effects
from ..effects.of_session import scene_of
from ..effects.scene import Scene
from ..identification.validation import ESTIMATOR
from ..lengths import length
from ..model import Estimate
from ..session.data import Session
from ..typing import Array
from . import models, samples
from .addition import probability
from .next_steps import after_diagnosis
from .page import Figure, Page, Section, Table, write_page
from .why_named import contradiction

STATUS = {
    "adequate": "The model is adequate",
    "missing_effect": "An effect is missing",
    "unexplained": "There is structure that no effect explains",
}
TOO_FEW = "Too few data to judge a model"
SHOWN = 12
MOST_AGAINST = 4


def write_diagnosis_report(
    diagnosis: Diagnosis,
    session: Session,
    folder: Path,
    *,
    named: tuple[str, str] = ("", ""),
    more: Sequence[Section] = (),
) -> list[Path]:
    """Write the figures and report.html into a folder; returns the files, the page first.

    Args:
        named: paths of session and model as the user typed them, for commands to copy.
        more: sections to append.
    """
    v = diagnosis.verdict
    hero = _hero(diagnosis, session, folder)
    page = Page(
        title=f"{TOO_FEW if v.too_few else STATUS[v.status]}: {session.name}",
        subtitle=f"Robot {session.serial or 'without serial'}, model {' + '.join(diagnosis.model.effects)}, "
        f"{len(session.poses)} poses, {len(diagnosis.comparison.rows)} samples",
        verdict=v.text,
        status=v.status,
        hero=hero,
        todo=after_diagnosis(
            diagnosis, named[0] or str(session.path or "SESSION"), named[1], without_tracker=session.contact is not None
        ),
        sections=[
            *_which(diagnosis, session, folder),
            *_formulas(diagnosis),
            *_where(diagnosis, session, folder),
            compare_section(diagnosis.comparison, session, folder),
            *_next(diagnosis, session),
            *_notes(diagnosis),
            *more,
        ],
    )
    figures = [hero.path, *(f.path for s in page.sections for f in s.figures)]
    return [write_page(page, folder / "report.html"), *figures]


def _hero(d: Diagnosis, session: Session, folder: Path) -> Figure:
    """The one figure that shows the verdict."""
    v, floor = d.verdict, d.comparison.noise_floor_m
    held_out = np.isfinite(d.cv_rms_m)
    rows = [("model as it is", d.cv_rms_m if held_out else d.fit_rms_m, d.cv_rms_se_m if held_out else float("nan"))]
    added = [label(c) for c in d.candidates if c.effect in v.effects]
    if v.status == "missing_effect" and added and np.isfinite(d.cv_rms_after_m):
        rows += [(f"with {' and '.join(added[:2])}{' ...' if len(added) > 2 else ''}", d.cv_rms_after_m, d.cv_rms_se_after_m)]
        cause = " and ".join(find_effect(e).label for e in v.effects).capitalize()
        title = f"{cause} {'take' if len(v.effects) > 1 else 'takes'} the error from {length(rows[0][1])} to {length(rows[1][1])}"
    elif v.status == "unexplained":
        title = f"The model leaves {length(rows[0][1])}, the noise explains {length(floor)}"
        rows += [("with the best formula", p.cv_rms_m, p.cv_rms_se_m) for p in d.proposals[:1]]
    elif v.usual and not v.too_few:
        title = "Noise and what every robot has explain what the model leaves"
        rows += [("with what every robot has", d.cv_rms_after_m, d.cv_rms_se_after_m)]
    else:
        explained = v.status == "adequate" and not v.too_few
        title = "What the model leaves is what the noise explains" if explained else "Error and noise"
    return Figure(models.gap(rows, floor, folder / "verdict.png", title), f"{title}. Estimator: {ESTIMATOR}.")


def _formulas(d: Diagnosis) -> list[Section]:
    """Formulas for what has structure and no name."""
    if not d.proposals:
        return []
    text = "Short laws in the variables that the rest depends on, each refitted with the whole model. They name no cause."
    rows = [[p.formula, f"{length(p.cv_rms_m)} +- {length(p.cv_rms_se_m)}", f"{p.log_evidence:.0f}"] for p in d.proposals]
    return [Section("Formulas for what has no name", [text], [], [Table(["formula", "held out", "log odds"], rows)])]


def compare_section(comparison: Comparison, session: Session, folder: Path) -> Section:
    """Predicted against measured, residual against noise."""
    rows = comparison.rows
    commanded = np.zeros((len(rows), 3))
    if session.kind == "loaded":
        commanded = session.p_tcp_in_base[rows] - session.p_tcp_in_base[session.reference_row()[rows]]
    loaded = session.kind == "loaded"
    measured = comparison.measured if loaded else None
    figures = [
        Figure(
            samples.norms_per_sample(
                commanded,
                comparison.residual,
                comparison.noise_floor_m,
                folder / "samples.png",
                poses=session.pose[rows],
                measured=measured,
            ),
            "What the controller commanded, what was measured beyond it, and what the model leaves of that, sample by sample."
            if loaded
            else "What the model leaves of each sample.",
        ),
        Figure(
            samples.predicted_against_measured(comparison.measured, comparison.predicted, folder / "measured.png"),
            "Measured against predicted displacement of the marker; the line is agreement.",
        ),
        Figure(
            samples.residual_maps(
                session.p_tcp_in_base[rows],
                [comparison.residual],
                ["Residual"],
                folder / "map.png",
                poses=session.pose[rows],
                on_surface=loaded,
            ),
            "Residual vectors at the TCP positions with the numbers of the poses, seen along the direction of least extent.",
        ),
    ]
    worst = sorted(comparison.by_pose.items(), key=lambda item: -item[1])[:SHOWN]
    return Section(
        f"The model leaves {length(comparison.rms_m)}, the noise explains {length(comparison.noise_floor_m)}",
        [
            f"{length(comparison.explainable_m)} could be explained by physics that the model lacks.",
            *comparison.notes,
        ],
        figures,
        [
            Table(["load case", "residual rms"], [[case, length(rms)] for case, rms in comparison.by_load_case.items()]),
            Table(["pose (worst first)", "residual rms"], [[pose, length(rms)] for pose, rms in worst]),
        ],
    )


def _where(diagnosis: Diagnosis, session: Session, folder: Path) -> list[Section]:
    significant = [w for w in diagnosis.where if w.shows]
    against = _against(diagnosis, significant, session, folder)
    quiet = len(diagnosis.where) - len(significant)
    if not significant:
        text = f"None of {quiet} views (load case, axis, angle, place, time, ...) shows structure in the residual."
        return [Section("Where: no view shows structure", [text], against)]
    shown = significant[:SHOWN]
    heading = "Where the model fails" if diagnosis.verdict.status != "adequate" else "What the residual goes along with"
    figures = [
        Figure(
            models.views([w.view for w in shown], [w.share for w in shown], folder / "where.png"),
            "How much of the squared residual goes along with each view; views without a sign of it are not drawn.",
        ),
        *against,
    ]
    rows = [[w.sentence, length(w.rms_m), f"{100 * w.share:.0f} %", probability(w.p_value)] for w in shown]
    text = f"{quiet} other views show no sign of structure." if quiet else ""
    return [Section(heading, [text] if text else [], figures, [Table(["in words", "rms there", "share", "corrected p"], rows)])]


def _against(d: Diagnosis, significant: Sequence[View], session: Session, folder: Path) -> list[Figure]:
    """The residual against each variable that it depends on."""
    wanted = list(
        dict.fromkeys([*d.verdict.depends_on, *(w.view.split(" ")[-1] if "tau_" in w.view else w.view for w in significant)])
    )
    out: list[Figure] = []
    known = variables(session)
    for name in wanted:
        name = name.removesuffix(" cubed")
        if name in known and len(out) < MOST_AGAINST:
            values, text = known[name]
            path = folder / f"against_{re.sub(r'[^A-Za-z0-9_]+', '_', name)}.png"
            c = d.comparison
            out.append(
                Figure(
                    samples.residual_against(values[c.rows], c.residual, text, c.noise_floor_m, path),
                    f"The residual along base x, y and z against {text.split(' [')[0]}; the band is the noise.",
                )
            )
    return out


def variables(session: Session) -> dict[str, tuple[Array, str]]:
    """Variables of a session that a residual may depend on: name -> values (n,), label with unit; angles in degrees."""
    scene = scene_of(session)
    out: dict[str, tuple[Array, str]] = {"stamp": (session.stamp, "time in the session [s]")}
    revolute = ~scene.kin.is_prismatic
    torque, of = scene.load_torque(), "process torque" if session.kind == "loaded" else "torque of weight and process"
    for k in range(scene.n_joints):
        q = session.q[:, k]
        out[f"joint_{k + 1}"] = (np.degrees(q), f"angle of joint {k + 1} [deg]") if revolute[k] else (q, f"joint {k + 1} [m]")
        out[f"tau_{k + 1}"] = (torque[:, k], f"{of} about axis {k + 1} [{'N m' if revolute[k] else 'N'}]")
        step, turns = scene.step[:, k], bool(revolute[k])
        out[f"step_{k + 1}"] = (np.degrees(step) if turns else step, f"step of joint {k + 1} [{'deg' if turns else 'm'}]")
    out |= {f"ext_{n}": (v, f"external axis {n}") for n, v in session.ext.items()}
    out |= {f"temp_{n}": (v, f"temperature {n} [degC]") for n, v in session.temperature.items()}
    out |= {f"force_{a}": (session.force_in_tool[:, i], f"force along tool {a} [N]") for i, a in enumerate("xyz")}
    out |= {f"tcp_{a}": (session.p_tcp_in_base[:, i], f"TCP along base {a} [m]") for i, a in enumerate("xyz")}
    out["reach"] = (np.linalg.norm(session.p_tcp_in_base, axis=1), "reach [m]")
    out["load_case"] = (session.load_case.astype(float), "load case")
    return out


def _which(diagnosis: Diagnosis, session: Session, folder: Path) -> list[Section]:
    v = diagnosis.verdict
    shown = sorted(diagnosis.candidates, key=lambda c: (c.effect not in v.effects, -c.log_evidence))[:SHOWN]
    shown = [c for c in shown if np.isfinite(c.cv_rms_m)]
    scene = scene_of(session)
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
                    [label(c) for c in shown if c.effect in v.effects],
                    folder / "candidates.png",
                ),
                "A trial of each effect: error on held-out poses with it added and everything refitted, in the linear problem"
                " about the model; `irec add` fits it exactly. Hatched: named by the verdict.",
            )
        )
    rows = [
        [
            label(c),
            length(c.cv_rms_m),
            probability(c.p_value),
            "; ".join(f"{n} = {Estimate(**e)}" for n, e in list(c.parameters.items())[:3])
            + (" ..." if len(c.parameters) > 3 else ""),
            "yes" if c.plausible else f"no: {beyond(c, scene) or 'it was cut down to plausible values'}",
            ", ".join(c.confusable_with) or "-",
        ]
        for c in shown
    ]
    header = ["effect", "trial, held out", "corrected p", "parameters", "plausible", "can't be told from"]
    known = known_effects()
    physics = [f"{known[e].label.capitalize()}: {known[e].physics}" for e in v.effects if e in known]
    physics += [f"{known[e].label.capitalize()} is there as in every robot: no cause to look for." for e in v.usual if e in known]
    skipped = [f"Not tried: {', '.join(f'{e} ({why})' for e, why in diagnosis.skipped.items())}."] if diagnosis.skipped else []
    titles = {
        "missing_effect": f"Which: {' and '.join(v.effects)}",
        "adequate": "Which: no effect is missing" if v.usual else "Which: no effect is needed",
        "unexplained": "Which: none of the catalogue",
    }
    return [
        Section(
            titles[v.status], [*physics, *contradiction(shown, v.effects, v.one_of), *skipped], figures, [Table(header, rows)]
        )
    ]


def label(candidate: Candidate) -> str:
    """Effect with the part of it that is present."""
    return candidate.effect + (f" ({', '.join(candidate.groups[:3])})" if candidate.groups else "")


def beyond(candidate: Candidate, scene: Scene) -> str:
    """The first value of a candidate beyond what is physically likely, with its limit; empty where there is none."""
    for p in candidate.term.effect.parameters(scene):
        low, high = p.plausible_range
        if p.name in candidate.term.estimates and not low <= (v := candidate.term.estimates[p.name].value) <= high:
            return f"{p.name} = {v:.3g} {p.unit}, limit {low if v < low else high:.3g} {p.unit}"
    return ""


def _next(diagnosis: Diagnosis, session: Session) -> list[Section]:
    if not diagnosis.next_measurements:
        return []
    sliding = session.robot.kinematics(session.q[:1]).is_prismatic
    rows = [
        [m.pose or "new", m.load_case, " / ".join(m.separates), length(m.difference_m), f"{m.gain:.1f}", m.repeats or "too often",
         " ".join(f"{v:.3f} m" if slides else f"{np.degrees(v):.0f}" for v, slides in zip(m.q, sliding, strict=False))]
        for m in diagnosis.next_measurements
    ]  # fmt: skip
    header = ["pose", "load case", "separates", "difference", "nats of one sample", "times", "joint angles [deg]"]
    text = "Samples that tell rivals apart best, and how often to take them. What counts is what is left once both are refitted."
    return [Section("What to measure next", [text], (), [Table(header, rows)])]


def _notes(diagnosis: Diagnosis) -> list[Section]:
    notes = [n for n in diagnosis.notes if n not in diagnosis.comparison.notes]
    return [Section("Notes", notes)] if notes else []
