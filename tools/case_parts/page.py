# SPDX-License-Identifier: Apache-2.0
"""The report of a case, one page that can be put beside the paper: Table 1, error maps, one course, the ladder, the
error budget."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from irec_calibration.report.page import Figure, Page, Section, Table, write_page
from irec_sim.production.hard import Hard
from irec_sim.production.runner import Drive

from . import pictures
from .axes_filter import BESIDE_PROFILE, CROSSED
from .budget import Budget
from .jobs import BRISK
from .table import PAPER, Drawn, Figures, average, cuts_in_draws, reduction

START = "without correction"
LEARNT, LAST = "+ filter of each axis, learnt on courses", "+ learnt once more on courses that it corrects"
PAPERS = "18 DOF, as in the paper"
NOT_KEPT = "tried on the fourth row, not kept: force extrapolated by the latency"


@dataclass(frozen=True)
class Found:
    """Everything a case found. table: name -> figures; rungs: name -> figures of each draw; drives: name -> record; told: name ->
    what the correction told."""

    case: str
    tolerance: float
    drives: dict[str, Drive]
    table: dict[str, Figures]
    rungs: dict[str, list[Figures]]
    corrections: dict[str, dict[str, float]]
    told: dict[str, Any]
    hard: Hard
    budget: Budget | None
    drawn: list[Drawn]
    numbered: list[Section]
    calibrated: str

    @property
    def outside(self) -> list[str]:
        """What of the plant lies outside of the real cell's bands."""
        return [d.told for d in self.drawn if d.outside]

    def cuts(self, rung: str) -> tuple[Drawn, Drawn]:
        """Reduction of mean and maximum on a row of the ladder, in all draws."""
        return cuts_in_draws(self.case, self.rungs[START], self.rungs[rung])


def write_report(found: Found, folder: Path) -> Path:
    """Figures and report.html."""
    paper = PAPER[found.case]
    own = found.drawn[2:]
    end = found.cuts(LAST)
    verdict = (
        f"On this plant the paper's own correction (18 DOF) takes away {own[0].short} of the mean error and {own[1].short} of "
        f"the maximum; on the real cell it took away {paper.reduction[0]:.1f} % and {paper.reduction[1]:.1f} %. "
        "All of the ladder below takes away, on courses that nothing was learnt from, "
        f"{end[0].short} and {end[1].short} (mean of {len(end[0].values)} draws and two standard errors; aim: "
        f"{paper.targets[0]:g} % and {paper.targets[1]:g} %, "
        f"{'reached' if all(d.mean >= d.band[0] for d in end) else 'not reached'})."
    )
    if found.outside:
        verdict += " THE PLANT IS OUTSIDE THE REAL CELL'S BANDS: " + "; ".join(found.outside) + "."
    sections = [_table_one(found), _maps(found, folder), _course(found, folder), _ladder(found, folder), _learned(found, folder)]
    if found.budget is not None:
        sections.append(_budget(found.budget, folder))
    sections += found.numbered
    sections.append(_honest(found))
    page = Page(
        title=f"{paper.title}: simulated, beside the paper",
        subtitle=f"{paper.what}; {len(found.drives['without'].ways.names)} courses on the hard plant of "
        f"config/truths/case_{found.case}.yaml",
        verdict=verdict,
        status="unexplained" if found.outside else "adequate",
        sections=sections,
    )
    return write_page(page, folder / "report.html")


def _table_one(found: Found) -> Section:
    paper = PAPER[found.case]
    rows: list[list[object]] = []
    before = found.table["without"]
    for name, f in found.table.items():
        cut = ("", "", "") if name == "without" else tuple(f"{x:.1f} %" for x in reduction(before, f))
        label = {"without": "without correction", "oracle": "an oracle that knows the plant's statics"}.get(name, name)
        rows.append([label, *(f"{x:.3f}" for x in (f.mean, f.max, f.std, f.signed)), *cut, f"{100 * f.inside:.1f} %"])
    rows.append(["paper: without correction", *(f"{x:.3f}" for x in paper.without), "", "", "", "", ""])
    rows.append(
        [
            "paper: with correction (18 DOF)",
            *(f"{x:.3f}" for x in paper.corrected),
            "",
            *(f"{x:.1f} %" for x in paper.reduction),
            "",
        ]
    )
    header = [
        "",
        "mean [mm]",
        "max [mm]",
        "std of |e| [mm]",
        "std of e [mm]",
        "mean less by",
        "max less by",
        "std less by",
        f"within {1e3 * found.tolerance:g} mm",
    ]
    text = [
        f"Table 1 of the paper, {paper.what}, as the tracker measures it, over all courses and in one draw. The oracle corrects "
        "with the true static deflection at each moment, through the same low-pass and the same channel: what a perfect static "
        "model would do."
    ]
    text.append(
        "Secondary encoders: joint angles are read behind the gears, in calibration (session_links, generated directly) and in "
        "the correction, as the windup since a dry drive of the same course; the model is of the structure beyond. The windup is "
        "read slowly (3 Hz), because the offset shakes what the encoders read: fast changes of force are left."
    )
    text.append(
        "Without the tracker: the 18-DOF model of the same calibration session, in which no marker was read. The disc on the "
        "tooling is the measured point (docs/without-tracker.md), and its compliance is identified along. What it gives way "
        "across can't be told from the wrist; in the line below its stiffness is known from a bench, 5 % off."
    )
    text.append(
        "6 and 18 DOF are told apart on calibration poses (Fig. 9 below). Along these courses they leave about the same: what is "
        "left is friction, play and dynamics, which neither has."
    )
    if found.case == "machining":
        text.append(
            "A remark on the paper: with a mean of 0.101 mm and a maximum of 0.520 mm no standard deviation above "
            "sqrt(0.101 x 0.520) = 0.229 mm is possible, so that 0.342 mm must be of other data."
        )
    text.append(
        f"The second table holds the plant against the real cell's bands, in {len(found.drawn[0].values)} draws of what "
        "is unsteady (process force, noise, drift of sensor and tracker): the maximum over a part is an extreme value, and "
        "one draw of it tells little. The first is that of the table above; a plant is outside of a band where the mean over the "
        "draws is, by more than two standard errors."
    )
    bands: list[list[object]] = [
        [
            d.name,
            f"{d.digits(d.values[0])} {d.unit}",
            d.short,
            d.range,
            f"{d.band[0]:g} to {d.band[1]:g} {d.unit}",
            "outside" if d.outside else "within",
        ]
        for d in found.drawn
    ]
    drawn = Table(["", "first draw", "mean of the draws, two standard errors", "range", "band of the real cell", ""], bands)
    return Section("Table 1", text, tables=[Table(header, rows), drawn])


def _maps(found: Found, folder: Path) -> Section:
    number = "11(e), (f)" if found.case == "afp" else "13(b), (c)"
    path = pictures.maps(found.drives["without"], found.drives["18 DOF"], found.tolerance, found.case, folder / "maps.png")
    return Section(
        f"Fig. {number}", figures=[Figure(path, f"As Fig. {number}: the error without and with correction on one colour scale.")]
    )


def _course(found: Found, folder: Path) -> Section:
    path, name = pictures.course(
        found.drives["without"], found.drives["18 DOF"], found.drives["improved"], found.tolerance, folder / "course.png"
    )
    number = "Fig. 11(g)" if found.case == "afp" else "One level"
    return Section(
        number, figures=[Figure(path, f"{number}: course {name} without and with correction; the band is the tolerance.")]
    )


def _ladder(found: Found, folder: Path) -> Section:
    rows = []
    for name, draws in found.rungs.items():
        told = found.corrections.get(name, {})
        f, cut = average(draws), [d.short.replace(" ", "\u00a0") for d in found.cuts(name)] if name != START else ["", ""]
        active = f"{100 * told['limited_share']:.1f} %" if told else ""
        findings = f"{told['findings']:.0f}" if told else ""
        rows.append(
            [
                name,
                f"{f.mean:.3f}",
                f"{f.max:.3f}",
                *cut,
                f"{100 * f.inside:.1f} %",
                active,
                findings,
            ]
        )
    header = ["", "mean [mm]", "max [mm]", "mean less by", "max less by", "inside", "limits active", "watchdog"]
    path = pictures.ladder({name: average(draws) for name, draws in found.rungs.items()}, folder / "ladder.png")
    text = [
        "Each row has what the row above has, and one thing more. All of it was learnt on every second course; the figures are "
        f"of the others, each the mean of {len(found.rungs[LAST])} draws of what is unsteady (process force, noise, drift), give "
        "or take two standard errors (Table 1 has all courses, and one draw). Limits and watchdogs of the correction are in "
        "force in every row; what they did is told of the first draw."
    ]
    return Section(
        "Taking it down again",
        text,
        figures=[Figure(path, f"Mean and maximum error, step by step, mean of {len(found.rungs[LAST])} draws.")],
        tables=[Table(header, rows)],
    )


def _learned(found: Found, folder: Path) -> Section:
    told = found.told
    latency, plain, shaped = told["latency"], told["plain"], told["shaped"]
    text = [
        "The arm in motion: the training courses were driven dry, and five times under the process with the tracker on the tool; "
        "the force sensor was zeroed in the air before each, and the "
        f"rows read as a session (session_moving): {' + '.join(told['moving'].effects)}, "
        f"{1e6 * told['moving'].figures['cv_rms_m']:.0f} um on held-out places. A standing arm is held by the friction of its "
        "gears, a moving one is not.",
        f"Latency: the TCP follows the force {1e3 * latency.delay:.1f} +- {1e3 * latency.se:.1f} ms late "
        f"(irec latency {told['bag'].name}); without the low-pass's own delay {1e3 * told['lead']:.1f} ms.",
        f"Sensor noise before contact: {told['noise']:.2f} N. Of the unsteady deviation the designed filter leaves "
        f"{100 * plain.left:.0f} % by its own account where arm and drives are a delay, the low-pass {100 * plain.before:.0f} %; "
        f"with the answers of arm and drives as they were measured {100 * shaped.left:.0f} % instead of "
        f"{100 * shaped.before:.0f} %. Acceleration of the offset {shaped.acceleration:.2f} m/s^2 RMS.",
        f"Force profile: {'touch-down' if found.case == 'afp' else 'the entry of the cutter'} comes "
        f"{1e3 * told['profile'].spread:.0f} ms (one standard deviation) sooner or later "
        f"from course to course; in each course it is moved by up to {1e3 * told['slack']:.0f} ms to where the readings have it. "
        f"{told['profile'].left:.0f} N RMS of the readings are not common to all courses.",
        f"Filter of each axis of the force{', each from all three' if CROSSED[found.case] else ''}"
        f"{', for what the force profile does not tell' if BESIDE_PROFILE[found.case] else ''}: learnt from the training courses "
        f"that were driven without correction with the tracker on the tool, and from offsets swept at {told['swept']} "
        "postures. On these courses it leaves "
        f"{1e6 * told['own'].left:.1f} um RMS of the measured deviation, the unfiltered prediction "
        f"{1e6 * told['own'].before:.1f} um. Acceleration of the offset "
        f"{told['own'].acceleration:.2f} m/s^2 RMS in the roughest tenth of the time; the limit is raised to "
        f"{BRISK.translation.acceleration:g} m/s^2 for it.",
        f"Once more: the training courses were driven {told['again']} times with that filter, and it was learnt anew from all "
        "drives, without correction and with it (less what the offset that was sent has moved): "
        f"{1e6 * told['once_more'].left:.1f} um RMS. Where the answer to an offset is not quite that of the standing arm, it "
        "matters less in drives that are corrected.",
    ]
    rows = [
        [s.where, f"{m.frequency:.2f}", f"{m.damping:.3f}", f"{100 * m.share:.0f} %"]
        for s in told["shaken"]
        if s.structure is not None
        for m in s.structure.modes
    ]
    figures = [
        Figure(
            pictures.learned(told, folder / "learned.png"),
            "Explained motion over the delay; force profile; what the filters miss of the deviation; answer of the arm to a "
            "swept force and to a swept offset at three postures.",
        )
    ]
    return Section(
        "What was learnt, and how", text, figures, [Table(["posture", "Hz", "damping", "share of the static deflection"], rows)]
    )


def _budget(budget: Budget, folder: Path) -> Section:
    path = pictures.budget(budget, folder / "budget.png")
    rows = [[name, f"{1e3 * m:.1f}", f"{1e3 * x:.1f}"] for name, (m, x) in budget.parts.items()]
    rows.append(["sum = error with the 18-DOF correction", *(f"{1e3 * v:.1f}" for v in budget.total)])
    text = [
        "Each group of causes is switched off in the simulator, one after the other and in the opposite order, the "
        "cell calibrated again"
        " where calibration sees it (from a session that is generated directly); a bar is the mean of both."
        " A negative bar is a cause that hides another."
        " Only a few of the courses are driven for it, so the sum is not the error of Table 1."
    ]
    return Section(
        "Error budget",
        text,
        [Figure(path, "What the mean error after the paper's correction is made of; it adds up.")],
        [Table(["cause", "mean [um]", "maximum [um]"], rows)],
    )


def _honest(found: Found) -> Section:
    return Section(
        "What this is, and is not",
        [
            f"The calibration session was made {found.calibrated}. Those of the error budget's variants were generated directly.",
            "Plant, process forces and instruments are simulated; docs/case-studies.md has each number with its "
            "source. The analysis never"
            " read the truth: models, latency, profile, filter and modes come from the session, recordings and readings alone.",
            "The correction is that of correction_node (conditioning, deflection, limits, state machine, "
            "watchdog), one chain per course.",
        ],
    )
