# SPDX-License-Identifier: Apache-2.0
"""The blind matrix: many sessions with hidden effects under opaque names, the truth in a folder of its own.

DIR/sessions/<name>      what a diagnosis gets
DIR/validation/<name>    the same robot at other poses
DIR-truth/<name>         truth.yaml, truth.csv: noise-free TCP deflection in each row of the validation session
DIR-truth/matrix.csv     name, cell, kind, effects, strength (share of the RMS deflection), visible, scales
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from .cellfile import CellFile, read_cell
from .errors import SimError
from .outside import OUTSIDE
from .session import generate, scale_to_share, write_deflections, write_session
from .truth import Truth, make_truth
from .truth_catalogue import CATALOGUE

STRENGTHS = (0.03, 0.08, 0.15)
_NEED_RAIL = ("rail_compliance",)
_SERIOUS = (0.08, 0.15)


@dataclass(frozen=True)
class Case:
    """One cell of the matrix: kind clean, single, pair or outside; effects; share of the RMS deflection of each."""

    kind: str
    effects: tuple[str, ...]
    strength: float


def matrix_cases(rng: np.random.Generator, clean: int, pairs: int, strengths: Sequence[float] = STRENGTHS) -> list[Case]:
    """Every effect of the catalogue at every strength, pairs at the serious ones, clean cells, effects outside the catalogue."""
    cases = [Case("clean", (), 0.0) for _ in range(clean)]
    cases += [Case("single", (e,), s) for e in CATALOGUE for s in strengths]
    cases += [Case("outside", (e,), s) for e in OUTSIDE for s in strengths if s in _SERIOUS]
    names = [e for e in CATALOGUE if e != "encoder_harmonics"]
    for i in range(pairs):
        first, second = rng.choice(names, size=2, replace=False)
        cases.append(Case("pair", (str(first), str(second)), _SERIOUS[i % len(_SERIOUS)]))
    return cases


def _truth_of(case: Case, cell: CellFile, seed: int) -> tuple[Truth, bool]:
    """A truth in which every effect shows, if a few draws of its parameters give one."""
    for attempt in range(6):
        truth = make_truth(cell.name, list(case.effects), seed + 1000 * attempt, spread=0.2)
        if case.kind == "clean":
            return truth, False
        truth, shown = scale_to_share(cell, truth, case.strength, seed)
        if shown == set(case.effects):
            return truth, True
    return truth, False


def write_matrix(
    folder: str | Path, seed: int, cases: Sequence[Case] | None = None, poses: int = 31, validation_poses: int = 20,
    clean: int = 12, pairs: int = 8, progress: Callable[[str], None] = lambda _: None,
) -> Path:  # fmt: skip
    """Generate a whole matrix; returns the folder of the truth.

    Raises:
        SimError: one of the folders exists and is not empty.
    """
    folder = Path(folder)
    truth_folder = folder.with_name(folder.name + "-truth")
    for place in (folder, truth_folder):
        if place.exists() and any(place.iterdir()):
            raise SimError(f"{place}: exists and is not empty; name another folder with --out")
    rng = np.random.default_rng([seed, 5])
    todo = list(matrix_cases(rng, clean, pairs) if cases is None else cases)
    order = rng.permutation(len(todo))
    names = [f"s{value:06x}" for value in rng.choice(16**6, size=len(todo), replace=False)]
    cells = {name: read_cell(name) for name in ("afp", "milling")}
    truth_folder.mkdir(parents=True, exist_ok=True)
    with open(truth_folder / "matrix.csv", "w", newline="", encoding="utf-8") as f:
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow(["name", "cell", "kind", "effects", "strength", "reached", "scales"])
        for count, index in enumerate(order):
            case, name = todo[index], names[count]
            on_rail = count % 3 != 2 or any(e in _NEED_RAIL for e in case.effects)
            cell = cells["afp" if on_rail else "milling"]
            case_seed = int(rng.integers(1, 2**31))
            truth, shown = _truth_of(case, cell, case_seed)
            write_session(generate(cell, truth, poses, case_seed + 1), folder / "sessions" / name, name)
            validation = generate(cell, truth, validation_poses, case_seed + 2)
            write_session(validation, folder / "validation" / name, name)
            (truth_folder / name).mkdir()
            (truth_folder / name / "truth.yaml").write_text(yaml.safe_dump(truth.as_data(), sort_keys=False), encoding="utf-8")
            write_deflections(validation, truth_folder / name / "truth.csv")
            scales = " ".join(f"{h.scale:.4g}" for h in truth.hidden)
            writer.writerow([name, cell.name, case.kind, " ".join(case.effects), case.strength, int(shown), scales])
            f.flush()
            progress(f"{count + 1} of {len(todo)}: {name}")
    return truth_folder
