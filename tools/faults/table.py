# SPDX-License-Identifier: Apache-2.0
"""Results of the matrix: one line of JSON each while it runs, a page in the end."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 110  # characters of a cause in the table


@dataclass
class Row:
    """One combination: what happened, and what of it is not as it has to be."""

    side: str
    fault: str
    phase: str
    robot: str = ""
    max_force: float = 0.0  # N, true
    largest_step: float = 0.0  # m, of the offset
    cause: str = ""
    data: str = ""
    run: str = ""
    failures: list[str] = field(default_factory=list)
    seconds: float = 0.0
    number: int = 0
    went_on: bool = False

    @property
    def key(self) -> str:
        return f"{self.side}/{self.fault}/{self.phase}"

    def fail(self, why: str) -> None:
        self.failures.append(why)


class Results:
    """Keeps every row in a file, so that a matrix can be stopped and gone on with."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows: dict[str, Row] = {}
        if path.exists():
            for line in path.read_text().splitlines():
                row = Row(**json.loads(line))
                self.rows[row.key] = row

    def add(self, row: Row) -> None:
        self.rows[row.key] = row
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with open(self._path, "a") as file:
            file.write(json.dumps(asdict(row)) + "\n")


def page(rows: Sequence[Row], planned: int) -> str:
    """docs/faults.md."""
    failed = [r for r in rows if r.failures]
    count = Counter(r.side for r in rows)
    lines = [
        "# Faults at the wrong moment",
        "",
        "Written by this command, about half an hour; it goes on where it was stopped. Not to be edited.",
        "",
        "```bash",
        "make faults                                             # all; what was tried before is not tried again",
        "make faults FAULTS=\"--fresh --only 'procedure/e-stop/*'\"  # side/fault/phase",
        "```",
        "",
        "Real processes over DDS: the simulated cell with a driver that can be made to fail, the procedure, the calibration, the",
        "recorder; for the correction a publisher in place of the cell. Each fault begins at a phase of the procedure or of the",
        "correction, and the simulation then runs in real time. A row is the newest try of its combination.",
        "",
        "What has to hold for each: the robot is out of the contact or stands within 3 s (or presses on under control where the",
        "fault does not touch the force), the true force stays below the abort limit of 1600 N, the offset makes no step above",
        "its limit, a diagnostic, a status or the verdict names the cause, what was recorded is whole and true, the run goes on",
        "or ends with a verdict, no calibration comes into force.",
        "",
        "What this does not show: the driver is the simulator's; a lost network is made in it (topics of both directions are",
        "lost, moves and modes fail), not on a wire; a node that was killed can't tell its cause itself (its diagnostics fall",
        "silent, and the driver or the other nodes say what they miss).",
        "",
        f"**{len(rows)} combinations tried of {planned} ({', '.join(f'{n} {s}' for s, n in sorted(count.items()))}),"
        f" {len(failed)} failed.**",
        "",
    ]
    if len(rows) < planned:
        left = planned - len(rows)
        lines += [f"The other {left} are not tried yet: nothing is known of them. `make faults` goes on with them.", ""]
    if failed:
        lines += ["## Failed", ""] + [f"* {r.side}, {r.fault}, {r.phase}: {'; '.join(r.failures)}" for r in failed] + [""]
    for side, heads in (
        ("procedure", ("fault", "phase", "robot", "largest force, N", "cause as told", "recording", "")),
        ("solve", ("fault", "phase", "cause as told", "what follows", "")),
        ("correction", ("fault", "phase", "offset ends", "largest step, um", "cause as told", "")),
    ):
        part = [r for r in rows if r.side == side]
        if not part:
            continue
        lines += [f"## {side.capitalize()}", "", "| " + " | ".join(heads) + " |", "|" + " --- |" * len(heads)]
        for r in part:
            mark = "**failed**" if r.failures else "held"
            cells = {
                "procedure": (r.fault, r.phase, r.robot, f"{r.max_force:.0f}", _short(r.cause), r.data, mark),
                "solve": (r.fault, r.phase, _short(r.cause), _short(r.run), mark),
                "correction": (r.fault, r.phase, r.robot, f"{1e6 * r.largest_step:.0f}", _short(r.cause), mark),
            }[side]
            lines.append("| " + " | ".join(cells) + " |")
        lines.append("")
    return "\n".join(lines)


def _short(text: str) -> str:
    text = " ".join(text.split()).replace("|", "/").replace(f"{ROOT}/", "")
    return text if len(text) <= LIMIT else text[: LIMIT - 1].rstrip() + "…"
