# SPDX-License-Identifier: Apache-2.0
"""Score what the tool said about a matrix of sessions against the truth.

    python tools/hidden/score.py DIR-truth OUT [--json] [--quiet]

Strict: a wrong name is wrong whatever else is said beside it, an axis in which nothing is hidden counts as a wrong name, and
what could be found is what the truth's oracle sees. Validation error: RMS difference between predicted and true deflection
of the TCP at other poses. Every rate is given for all sessions, and apart for those whose header states the noise as it is and
those that state it wrongly.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from answers import SERIOUS, Case, read_case
from axes import axes_in_words

Choice = Callable[[Case], bool]


@dataclass(frozen=True)
class Rate:
    """One line of the table: passed of how many, for all, noise claimed right, noise claimed wrongly."""

    key: str
    label: str
    goal: str
    counts: tuple[tuple[float, int], ...]

    def share(self, column: int = 0) -> float:
        passed, n = self.counts[column]
        return passed / n if n else float("nan")


def rate(key: str, label: str, goal: str, cases: Iterable[Case], of: Choice, test: Choice) -> Rate:
    """Share of the chosen cases that pass a test."""
    chosen = [c for c in cases if of(c)]
    parts = (chosen, [c for c in chosen if c.claim_right], [c for c in chosen if not c.claim_right])
    return Rate(key, label, goal, tuple((float(sum(map(test, p))), len(p)) for p in parts))


def names(key: str, label: str, goal: str, cases: Iterable[Case], of: Choice, count: Callable[[Case], tuple[int, int]]) -> Rate:
    """Names counted over all chosen cases: (right, of how many) per case."""
    chosen = [c for c in cases if of(c)]
    parts = (chosen, [c for c in chosen if c.claim_right], [c for c in chosen if not c.claim_right])
    sums = []
    for p in parts:
        pairs = [count(c) for c in p]
        sums.append((float(sum(a for a, _ in pairs)), sum(b for _, b in pairs)))
    return Rate(key, label, goal, tuple(sums))


def _precision(given: Callable[[Case], list[str]]) -> Callable[[Case], tuple[int, int]]:
    return lambda c: (sum(e in (*c.hidden, *c.background) for e in given(c)), len(given(c)))


def _recall(given: Callable[[Case], list[str]]) -> Callable[[Case], tuple[int, int]]:
    return lambda c: (sum(e in given(c) for e in c.visible), len(c.visible))


def _kind(*kinds: str) -> Choice:
    return lambda c: c.kind in kinds


def rates(cases: list[Case]) -> list[Rate]:
    """All rates of the table."""

    def clean(c: Case) -> bool:
        return c.kind in ("clean", "robust") and not c.hidden

    def strong(c: Case) -> bool:
        return c.kind == "single" and c.sees_all and c.strength >= SERIOUS

    def weak(c: Case) -> bool:
        return c.kind == "single" and c.sees_all and c.strength < SERIOUS

    def pair(c: Case) -> bool:
        return c.kind == "pair" and c.sees_all

    def named(c: Case) -> list[str]:
        return c.named

    def built(c: Case) -> list[str]:
        return c.ladder

    out = [
        rate("first_8", "first name right, 8 % and more", ">= 95 / 90", cases, strong, lambda c: c.first_right),
        rate("three_8", "  among the first three", "", cases, strong, lambda c: c.among_three),
        rate("first_3", "first name right, 3 %", ">= 80 / 75", cases, weak, lambda c: c.first_right),
        rate("pairs", "pairs, both visible: both right", ">= 75", cases, pair, lambda c: c.all_named),
        rate("wrong_name", "sessions with a wrong name", "<= 2", cases, lambda c: True, lambda c: c.wrong_name),
        rate("wrong_axis", "  of these only a wrong axis", "", cases, lambda c: True,
             lambda c: c.wrong_axis and not c.false_names),
        rate("false_alarm", "clean: anything but adequate", "<= 3 / 5", cases, clean, lambda c: c.status != "adequate"),
        rate("alarm_plain", "  no bad row, normal noise", "", cases, lambda c: clean(c) and c.plain and not c.mishap,
             lambda c: c.status != "adequate"),
        rate("alarm_bad_row", "  with a bad row", "", cases, lambda c: clean(c) and bool(c.mishap),
             lambda c: c.status != "adequate"),
        rate("unexplained", "outside, visible: unexplained", ">= 90", cases,
             lambda c: c.kind == "outside" and bool(c.visible), lambda c: c.status == "unexplained"),
        rate("variable", "  and a right variable", ">= 85", cases,
             lambda c: c.kind == "outside" and c.status == "unexplained", lambda c: c.variable_right),
        rate("outside_named", "  named all the same", "", cases, _kind("outside"), lambda c: bool(c.named)),
        names("many_precision", "many causes: precision of names", ">= 95", cases, _kind("many"), _precision(named)),
        names("many_recall", "many causes: recall of the visible", ">= 75", cases, _kind("many"), _recall(named)),
        names("ladder_precision", "  of the improved model: precision", ">= 95", cases, _kind("many"), _precision(built)),
        names("ladder_recall", "  of the improved model: recall", ">= 75", cases, _kind("many"), _recall(built)),
        rate("bad_row_found", "bad rows: pose is listed", "", cases, lambda c: bool(c.mishap), lambda c: c.mishap_found),
        rate("bad_row_verdict", "  verdict right all the same", "", cases,
             lambda c: bool(c.mishap) and c.kind in ("clean", "robust", "single"), lambda c: c.right),
        rate("accused", "  listed although nothing is wrong", "", cases, lambda c: not c.mishap and c.plain,
             lambda c: bool(c.accused)),
        names("absolute_precision", "absolute: precision of names", ">= 95", cases, _kind("absolute"), _precision(built)),
        names("absolute_recall", "absolute: recall of the visible", ">= 75", cases, _kind("absolute"), _recall(built)),
        rate("absolute_alarm", "  clean: anything but adequate", "<= 3 / 5", cases,
             lambda c: c.kind == "absolute" and not c.hidden, lambda c: c.status != "adequate"),
        rate("sorted", "candidates begin with the named effect", "100", cases, lambda c: bool(c.named),
             lambda c: c.sorted_as_named),
        rate("failed", "ended with an error", "0", cases, lambda c: True, lambda c: c.failed),
    ]  # fmt: skip
    return [r for r in out if r.counts[0][1]]


def ratios(cases: list[Case]) -> list[dict[str, Any]]:
    """Validation error over the oracle's, by kind of session: median and worst."""
    out = []
    groups: list[tuple[str, str, Choice]] = [
        ("single, visible", "<= 1.15, 3", lambda c: c.kind in ("single", "robust") and c.sees_all),
        ("pairs", "<= 1.15, 3", lambda c: c.kind == "pair"),
        ("many causes", "<= 1.3, 3", lambda c: c.kind == "many"),
        ("outside", "", lambda c: c.kind == "outside"),
        ("clean", "<= 1.15, 3", lambda c: c.kind in ("clean", "robust") and not c.hidden),
        ("absolute", "", lambda c: c.kind == "absolute"),
    ]
    for label, goal, of in groups:
        chosen = [c for c in cases if of(c) and not c.failed]
        if not chosen:
            continue
        line: dict[str, Any] = {"group": label, "goal": goal, "n": len(chosen)}
        for part, some in (("all", chosen), ("right", [c for c in chosen if c.claim_right]),
                           ("wrong", [c for c in chosen if not c.claim_right])):  # fmt: skip
            values = [c.to_oracle for c in some]
            line[part] = {"median": float(np.median(values)), "worst": float(np.max(values))} if values else None
        line["base_over_oracle"] = float(np.median([c.base / c.oracle for c in chosen]))
        out.append(line)
    return out


def promises(cases: list[Case]) -> list[str]:
    """Validation error over the error that the improved model says is to be expected, by kind of session."""
    lines = []
    for kind in dict.fromkeys(c.kind for c in cases):
        found = [c.after / c.expected for c in cases if c.kind == kind and not c.failed and np.isfinite(c.expected)]
        if found:
            low, middle, high = np.percentile(found, [10, 50, 90])
            within = sum(r <= 2.0 for r in found)
            figures = "".join(f"{r:8.2f}" for r in (low, middle, high, max(found)))
            lines.append(f"{f'{kind} ({len(found)})':38}{figures}{within:10} of {len(found)}")
    begin = f"{'validation error / error as expected':38}{'10 %':>8}{'median':>8}{'90 %':>8}{'worst':>8}{'at most 2':>16}"
    return ["", begin, *lines] if lines else []


def table(cases: list[Case]) -> str:
    """The score as one table."""
    lines = [f"{'':38}{'goal %':>12}  {'all':>16}{'noise as stated':>18}{'stated wrongly':>18}"]
    for r in rates(cases):
        cells = [f"{100 * passed / n:4.0f} % of {n:<4g}" if n else "-" for passed, n in r.counts]
        lines.append(f"{r.label:38}{r.goal:>12}  {cells[0]:>16}{cells[1]:>18}{cells[2]:>18}")
    lines.append("")
    lines.append(f"{'validation error / oracle':38}{'goal':>12}  {'all':>16}{'noise as stated':>18}{'stated wrongly':>18}")
    for line in ratios(cases):
        cells = [f"{x['median']:.2f}, {x['worst']:.1f}" if (x := line[k]) else "-" for k in ("all", "right", "wrong")]
        start = f"{line['group']} ({line['n']}; start {line['base_over_oracle']:.1f})"
        lines.append(f"{start:38}{line['goal']:>12}  {cells[0]:>16}{cells[1]:>18}{cells[2]:>18}")
    lines += promises(cases)
    lines += axes_in_words([a for c in cases for a in c.axes])
    seconds = [c.seconds for c in cases if not c.failed]
    if seconds:
        lines.append(f"irec improve: median {np.median(seconds):.1f} s, slowest {max(seconds):.1f} s")
    return "\n".join(lines)


def line_of(c: Case) -> str:
    """One session in one line."""
    hidden = " ".join(e if e in c.visible else f"({e})" for e in c.hidden) or "-"
    noise = ("" if c.claim_right else "noise stated wrongly ") + c.mishap
    said = "+".join(c.named) + (f" depends on {', '.join(c.depends_on[:3])}" if c.status == "unexplained" else "")
    where = "; ".join(axes_of(a) for a in c.axes)
    ratio = f"{c.to_oracle:5.1f}" if not c.failed else "    -"
    strength = f"{100 * c.strength:.0f} %" if c.strength else ""
    what = f"{'ok' if c.right else '--'} {c.name} {c.kind:8}{strength:>5} {hidden}"
    return f"{what} | {c.status} {said} {where} | {ratio} {noise}".rstrip()


def axes_of(a: Any) -> str:
    """Axes named and hidden, for the line of a session."""
    named = ", ".join(sorted(a.right | a.wrong)) or ("not told apart" if a.offered else "no axis")
    return f"[{a.kind}: {named}; hidden {', '.join(sorted(a.hidden)) if len(a.hidden) < 6 else 'all'}]"


def as_json(cases: list[Case]) -> dict[str, Any]:
    """The score for machines."""
    columns = ("all", "right", "wrong")
    return {
        "format": "irec-hidden-score/1",
        "sessions": len(cases),
        "rates": {
            r.key: {"label": r.label.strip(), "goal": r.goal}
            | {k: {"passed": p, "of": n} for k, (p, n) in zip(columns, r.counts, strict=True)}
            for r in rates(cases)
        },
        "ratios": ratios(cases),
        "cases": [
            {"name": c.name, "kind": c.kind, "hidden": c.hidden, "visible": c.visible, "status": c.status, "named": c.named,
             "right": c.right, "to_oracle": None if c.failed else c.to_oracle} for c in cases
        ],
    }  # fmt: skip


def finished(folder: Path) -> bool:
    """Whether run.py is through with a session, well or not."""
    return (folder / "timing.json").exists() or (folder / "error.txt").exists()


def main() -> int:
    parser = argparse.ArgumentParser(description="Score a blind run against the truth.")
    parser.add_argument("truth", type=Path, help="folder with matrix.csv")
    parser.add_argument("output", type=Path, help="folder that run.py wrote")
    parser.add_argument("--json", action="store_true", help="print the score as JSON")
    parser.add_argument("--quiet", action="store_true", help="only the table, no line per session")
    args = parser.parse_args()
    with (args.truth / "matrix.csv").open(encoding="utf-8") as file:
        rows = [r for r in csv.DictReader(file) if finished(args.output / r["name"])]
    if not rows:
        print(f"{args.output}: no result of run.py for a session of {args.truth}", file=sys.stderr)
        return 2
    cases = [read_case(row, args.truth, args.output) for row in rows]
    if args.json:
        print(json.dumps(as_json(cases), indent=1))
        return 0
    if not args.quiet:
        for c in sorted(cases, key=lambda c: (c.kind, c.hidden, c.strength)):
            print(line_of(c))
        print()
    print(table(cases))
    return 0


if __name__ == "__main__":
    sys.exit(main())
