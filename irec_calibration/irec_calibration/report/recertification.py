# SPDX-License-Identifier: Apache-2.0
"""What the certificate of a recertification says, from its outcome and the store."""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence

import numpy as np

from ..effects import known_effects
from ..model import Model
from ..recertification.flow import Outcome
from ..recertification.quick_check import odds_text
from ..recertification.readings import MANNED
from ..recertification.request import Place
from ..recertification.store import Store
from ..recertification.trend import TrendPoint, trend
from ..recertification.verdict import Kind, kind_of
from .certificate import Certificate

DIRECTED = re.compile(r"(?P<what>\D+)(?P<size>[\d.]+)(?P<unit> .* (?:along|about) )(?P<way>[xyz])")
MEASURED = ("force sensor", "tracker", "temperature")


def certificate_of(outcome: Outcome, place: Place, store: Store, operator: str) -> Certificate:
    """The certificate: what was done, before and after, tolerance, uncertainty, trend."""
    today = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M")
    now = store.in_force_entry()
    points = trend(store)
    return Certificate(
        title="Elastic calibration of a robot: recertification",
        subtitle=f"Cell {place.cell}, robot {place.serial}, {today}",
        verdict=_title(outcome),
        text=outcome.text,
        operator=operator,
        rows=[
            ("Tolerance of the process", f"{_mm(place.tolerance)}"),
            ("Calibration in force", "none" if now is None else f"{now.calibration}, since {now.at[:10]}, by {now.by}"),
            *_quick_rows(outcome),
            *_confirmed_rows(outcome, points),
            *_full_rows(outcome, place.tolerance),
            *_before_rows(outcome),
        ],
        points=points,
    )


def _mm(length: float) -> str:
    return f"{1e3 * length:.3f} mm" if length < 0.1e-3 else f"{1e3 * length:.2f} mm"


def _before_rows(outcome: Outcome) -> list[tuple[str, str]]:
    """What was looked at before anything moved: names of what held, values of what was measured."""
    if not outcome.preconditions:
        return []
    measured = [f"{p.name}: {p.text}" for p in outcome.preconditions if p.name in MEASURED]
    others = ", ".join(p.name for p in outcome.preconditions if p.name not in MEASURED and p.name not in MANNED)
    people = ", ".join(p.name for p in outcome.preconditions if p.name in MANNED)
    return [
        ("Looked at before anything moved", "\n".join([f"{others}: all as they have to be", *measured])),
        ("Looked at by the operator", people),
    ]


def _title(outcome: Outcome) -> str:
    """The verdict with effects by what they are called, not by their ids."""
    verdict, _, what = outcome.verdict.partition(": ")
    for effect in known_effects().values():
        what = re.sub(rf"\b{re.escape(effect.id)}\b", effect.label, what)
    return {"pass": "PASS", "recalibrated": "RECALIBRATED"}.get(verdict, f"{verdict.upper()}: {what}")


def _quick_rows(outcome: Outcome) -> list[tuple[str, str]]:
    q, p = outcome.quick, outcome.quick_plan
    if q is None or p is None:
        return []
    words = {"pass": "passed", "changed": "the robot has changed", "undecided": "not decided"}[q.decision]
    odds = f"odds that the robot has changed {odds_text(q.e_value)} (alarm at 50 to 1)"
    loads = f", with {p.lateral:g} times the forces across the tool" if p.lateral != 1.0 else ""
    rows = [("Quick check", f"{words}, after {q.visits} visits to {q.poses} poses{loads}; {odds}")]
    if q.like:
        rows.append(("It looks like", " or ".join(q.words[n] for n in q.like[:3])))
    if q.decision == "pass":
        seen = "\n".join(_grouped(p.seen)) or "nothing"
        rows.append(("Would have been found", f"{seen}\n(each missed with a probability of 5 % at the most)"))
        if p.never:
            why = "under these loads it does not move the tool there"
            rows.append(("Can't be seen at these poses", f"{'; '.join(p.never)}: {why}"))
    return rows


def _confirmed_rows(outcome: Outcome, points: Sequence[TrendPoint]) -> list[tuple[str, str]]:
    """The stiffnesses after a check that was passed: those of the calibration, and up to what they are confirmed."""
    if outcome.quick is None or outcome.quick.decision != "pass" or not points or points[-1].event != "checked":
        return []
    now = points[-1]
    axes = [
        f"axis {k + 1}: {1e6 * e.value:.2f}, less than {100 * now.softer_below[k]:.0f} % more"
        for k, e in now.compliance.items() if k in now.softer_below
    ]  # fmt: skip
    text = f"{'; '.join(axes)} (urad for each N m by calibration {now.calibration}; a check does not identify them anew)"
    return [("How far single axes give way", text)] if axes else []


def _grouped(changes: Sequence[str]) -> list[str]:
    """`axis 1: 10 % softer`, `axis 2: 10 % softer` as `axis 1, 2: 10 % softer`, and what differs by size and direction only as
    `base: gives way 10, 14 um/kN more along x, y`; the rest as it is."""
    groups: dict[str, list[str]] = {}
    for change in changes:
        part, _, what = change.partition(": ")
        groups.setdefault(what, []).append(part)
    out: list[str] = []
    along: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for what, parts in groups.items():
        names = [parts[0], *(p.removeprefix("axis ") for p in parts[1:])]
        text = f"{', '.join(names)}: {what}"
        if directed := DIRECTED.fullmatch(text):
            along.setdefault((directed["what"], directed["unit"]), []).append((directed["size"], directed["way"]))
        else:
            out.append(text)
    for (what, unit), found in along.items():
        sizes, ways = zip(*found, strict=True)
        figure = sizes[0] if len(set(sizes)) == 1 else ", ".join(sizes)
        out.append(f"{what}{figure}{unit}{', '.join(ways)}")
    return out


def _full_rows(outcome: Outcome, tolerance: float) -> list[tuple[str, str]]:
    j = outcome.judgement
    if j is None:
        return []
    um = 1e6
    rows = [
        ("Full procedure", f"{j.model.figures.get('poses', '?')} poses; {len(j.held_out)} of them were kept apart to judge"),
        ("Error of the former calibration", _error(j.rms_old, tolerance)),
        ("Error of the new calibration", f"{_error(j.rms_new, tolerance)}, on the poses kept apart"),
        *_expected(j.model),
        ("What is asked of it", "\n".join(f"{c.text}: {'met' if c.holds else 'NOT met'}" for c in j.criteria)),
        ("What it describes", ", ".join(f"{t.effect.label} ({t.effect.id})" for t in j.model.terms)),
    ]
    known = [f"axis {k + 1}: {um * e.value:.2f} ± {2 * um * e.se:.2f}" for k, e in j.axes.items()]
    if known:
        without = "\nof a model without what is to be looked at: no sign of the axes" if _to_be_looked_at(outcome) else ""
        rows.append(("How far single axes give way", f"{'; '.join(known)} urad for each N m (± 2 standard errors){without}"))
    if j.missing.status == "missing_effect":
        rows.append(("Diagnosis, for an engineer", j.missing.text))
    if outcome.calibration:
        rows.append(("Stored as", outcome.calibration + (", now in force" if outcome.activated else ", not in force")))
    return rows


def _expected(model: Model) -> list[tuple[str, str]]:
    error = model.figures.get("expected_error_m")
    if not isinstance(error, float):
        return []
    caution = model.made.get("caution")
    return [("Error to be expected at the TCP", f"{_mm(error)}{f'; caution: {caution}' if caution else ''}")]


def _to_be_looked_at(outcome: Outcome) -> bool:
    return kind_of(outcome.verdict) is Kind.INVESTIGATE


def _error(rms: float, tolerance: float) -> str:
    return f"{_mm(rms)}, {100 * rms / tolerance:.0f} % of the tolerance" if np.isfinite(rms) else "there was none"
