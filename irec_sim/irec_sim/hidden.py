# SPDX-License-Identifier: Apache-2.0
"""The blind matrix: many sessions with hidden causes under opaque names, the truth in a folder of its own.

DIR/sessions/<name>      what a diagnosis gets
DIR/validation/<name>    the same robot at other poses
DIR-truth/<name>         truth.yaml (physics, noise, mishaps, what the oracle says), truth.csv: noise-free TCP deflection in
                         each row of the validation session
DIR-truth/matrix.csv     one line per session
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from .absolute import AbsoluteMade, draw_setup, generate_absolute, write_absolute, write_truth_rows
from .absolute_oracle import consult_absolute
from .absolute_truth import draw_absolute, draw_arm
from .cellfile import CellFile, read_cell
from .errors import SimError
from .matrix import Case
from .noise import claimed_over_true, draw_claim, draw_noise
from .oracle import Oracle, consult
from .outside import OUTSIDE
from .realistic import draw_causes, realistic
from .session import Conduct, Generated, generate, scale_to_share, write_deflections, write_session
from .truth import Hidden, Truth, make_truth, plain

COLUMNS = (
    "name", "cell", "kind", "effects", "background", "visible", "strength", "reached", "scales", "claim", "claim_factor", "tail",
    "slow", "mishap", "repeats", "one_order", "temperatures", "variables", "base_m", "oracle_m",
)  # fmt: skip
_NEED_RAIL = "rail_compliance"
# robots of a series differ, and no spring sits where one thinks
_BUILT: dict[str, Any] = {"spread": 0.3, "unequal": 0.35, "off_centre": 0.03}
_BACKGROUND_NATS = 2.0  # what a cause that nobody is asked for may show at most


@dataclass(frozen=True)
class Drawn:
    """A session of the matrix before it is written."""

    cell: CellFile
    truth: Truth
    made: Generated
    validation: Generated
    oracle: Oracle
    reached: bool


def _truth_of(case: Case, cell: CellFile, seed: int, rng: np.random.Generator) -> tuple[Truth, bool]:
    """A truth in which every effect shows, if a few draws of its parameters give one."""
    if case.kind == "many":
        truth = make_truth(cell.name, [], seed, **_BUILT)
        names = case.effects or tuple(draw_causes(rng, int(rng.integers(3, 8)), cell.rail is not None))
        return replace(truth, hidden=tuple(Hidden(e, realistic(e, rng)) for e in names)), True
    for attempt in range(6):
        truth = make_truth(cell.name, list(case.effects), seed + 1000 * attempt, **_BUILT)
        if not case.effects:
            return truth, True
        truth, shown = scale_to_share(cell, truth, case.strength, seed)
        if shown == set(case.effects):
            return truth, True
    return truth, False


def draw_session(case: Case, seed: int, poses: int, validation_poses: int, cells: dict[str, CellFile]) -> Drawn:
    """One session of the matrix, its validation session and what the oracle says of them."""
    for attempt in range(4):
        drawn = _draw(case, seed + 7919 * attempt, poses, validation_poses, cells)
        if case.kind != "outside" or any(s.visible for s in drawn.oracle.seen):
            break  # a cause outside the catalogue that nobody could see would say nothing
    return drawn


def _draw(case: Case, seed: int, poses: int, validation_poses: int, cells: dict[str, CellFile]) -> Drawn:
    rng = np.random.default_rng([seed, 6])
    on_rail = rng.random() < 0.6 or _NEED_RAIL in case.effects
    cell = cells["afp" if on_rail else "milling"]
    truth, reached = _truth_of(case, cell, seed, rng)
    if "geometry_error" not in case.effects and rng.random() < 0.5:  # links are never quite as long as stated
        slightly = Hidden("geometry_error", realistic("geometry_error", rng), background=True)
        truth = replace(truth, hidden=(*truth.hidden, slightly))
    noise = draw_noise(cell.noise, rng, case.tail, case.slow)
    claim = draw_claim(noise, case.claim, rng)
    conduct = Conduct(
        noise, claim, not case.one_order, case.repeats, case.repeated, case.temperatures, case.mishap or None
    )  # fmt: skip
    check = replace(conduct, repeats=1, repeated_poses=None, mishap=None)
    for _ in range(6):
        made = generate(cell, truth, poses, seed + 1, conduct=conduct)
        validation = generate(cell, truth, validation_poses, seed + 2, conduct=check)
        oracle = consult(made, validation, truth)
        loud = [s.effect for s in oracle.seen if s.nats > _BACKGROUND_NATS]
        if not any(h.background and h.effect in loud for h in truth.hidden):
            break
        truth = replace(
            truth,
            hidden=tuple(replace(h, scale=h.scale / 2.0) if h.background and h.effect in loud else h for h in truth.hidden),
        )
    return Drawn(cell, truth, made, validation, oracle, reached)


@dataclass(frozen=True)
class DrawnAbsolute:
    """An absolute session of the matrix before it is written."""

    made: AbsoluteMade
    validation: AbsoluteMade
    oracle: Oracle


def draw_absolute_session(case: Case, seed: int, poses: int, validation_poses: int) -> DrawnAbsolute:
    """An arm under gravity with wrong geometry; a quarter of them have nothing else."""
    rng = np.random.default_rng([seed, 8])
    arm = draw_arm(rng)
    bare = rng.random() < 0.25
    truth = draw_absolute(arm, 0 if bare or case.nothing_hidden else int(rng.integers(1, 6)), rng)
    setup = draw_setup(arm.chain, rng)
    noise = draw_noise({"tracker_m": 1e-5, "tracker_m_per_m": 5e-6, "force_n": 1.0}, rng, case.tail, case.slow)
    claim, robot_m = draw_claim(noise, case.claim, rng), float(rng.uniform(5e-6, 3e-5))
    made = generate_absolute(truth, setup, poses, noise, claim, robot_m, rng, case.mishap)
    check = generate_absolute(truth, setup, validation_poses, noise, claim, robot_m, rng)
    return DrawnAbsolute(made, check, consult_absolute(made, check))


def write_matrix(
    folder: str | Path, seed: int, cases: Sequence[Case], poses: int | None = None, validation_poses: int = 20,
    progress: Callable[[str], None] = lambda _: None,
) -> Path:  # fmt: skip
    """Generate a whole matrix; returns the folder of the truth.

    Args:
        poses: of each session; None: 18 to 40, drawn.

    Raises:
        SimError: one of the folders exists and is not empty.
    """
    folder = Path(folder)
    truth_folder = folder.with_name(folder.name + "-truth")
    for place in (folder, truth_folder):
        if place.exists() and any(place.iterdir()):
            raise SimError(f"{place}: exists and is not empty; name another folder with --out")
    rng = np.random.default_rng([seed, 5])
    order = rng.permutation(len(cases))
    names = [f"s{value:06x}" for value in rng.choice(16**6, size=len(cases), replace=False)]
    seeds = rng.integers(1, 2**31, len(cases))
    cells = {name: read_cell(name) for name in ("afp", "milling")}
    truth_folder.mkdir(parents=True, exist_ok=True)
    with open(truth_folder / "matrix.csv", "w", newline="", encoding="utf-8") as f:
        writer = csv.DictWriter(f, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for count, index in enumerate(order):
            case, name, case_seed = cases[index], names[count], int(seeds[count])
            places = folder / "sessions" / name, folder / "validation" / name, truth_folder / name
            places[2].mkdir()
            if case.kind == "absolute":
                line = _write_absolute(draw_absolute_session(case, case_seed, int(rng.integers(80, 200)), 50), places, name)
            else:
                count_poses = poses or int(rng.integers(18, 41))
                line = _write(draw_session(case, case_seed, count_poses, validation_poses, cells), places, name)
            writer.writerow(_common(case) | line)
            f.flush()
            progress(f"{count + 1} of {len(cases)}: {name}")
    return truth_folder


Places = tuple[Path, Path, Path]


def _write(drawn: Drawn, places: Places, name: str) -> dict[str, Any]:
    """Write both sessions and the truth; what matrix.csv says of them."""
    write_session(drawn.made, places[0], name)
    write_session(drawn.validation, places[1], name)
    write_deflections(drawn.validation, places[2] / "truth.csv")
    (places[2] / "truth.yaml").write_text(yaml.safe_dump(truth_data(drawn), sort_keys=False), encoding="utf-8")
    truth, made = drawn.truth, drawn.made
    distance = np.concatenate([r.distance.ravel() for r in made.rows])
    return _seen(drawn.oracle, [h.effect for h in truth.hidden if not h.background]) | {
        "name": name, "cell": drawn.cell.name, "background": " ".join(h.effect for h in truth.hidden if h.background),
        "reached": int(drawn.reached), "scales": " ".join(f"{h.scale:.4g}" for h in truth.hidden),
        "claim_factor": f"{claimed_over_true(made.claim, made.noise, distance):.3f}", "variables": " ".join(variables_of(truth)),
    }  # fmt: skip


def _write_absolute(drawn: DrawnAbsolute, places: Places, name: str) -> dict[str, Any]:
    """The same for an absolute session."""
    made, truth = drawn.made, drawn.made.truth
    write_absolute(made, places[0], name)
    write_absolute(drawn.validation, places[1], name)
    write_truth_rows(drawn.validation, places[2] / "truth.csv")
    data = {
        "format": "irec-absolute-truth/1", "robot": truth.arm.name,
        "geometry": {k: getattr(truth.geometry, k).tolist() for k in ("zero", "p", "turn")},
        "effects": [{"effect": e, "parameters": plain(p)} for e, p in truth.hidden],
        "noise": made.noise.as_data() | {"robot_m": made.robot_m}, "claim": made.claim,
        "mishaps": [m.as_data() for m in made.mishaps], "oracle": drawn.oracle.as_data(),
    }  # fmt: skip
    (places[2] / "truth.yaml").write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return _seen(drawn.oracle, [e for e, _ in truth.hidden]) | {
        "name": name, "cell": truth.arm.name, "background": "geometry_error", "reached": 1, "scales": "",
        "claim_factor": f"{claimed_over_true(made.claim, made.noise, made.distance):.3f}", "variables": "",
        "repeats": 1, "one_order": 0, "temperatures": "ambient",
    }  # fmt: skip


def truth_data(drawn: Drawn) -> dict[str, Any]:
    """Content of truth.yaml: what `--truth` reads again, and beside it what the judge needs."""
    return {
        **drawn.truth.as_data(),
        "noise": drawn.made.noise.as_data(), "claim": drawn.made.claim,
        "mishaps": [m.as_data() for m in drawn.made.mishaps], "oracle": drawn.oracle.as_data(),
    }  # fmt: skip


def _common(case: Case) -> dict[str, Any]:
    return {
        "kind": case.kind, "strength": case.strength, "claim": case.claim, "tail": case.tail, "slow": int(case.slow),
        "mishap": case.mishap, "repeats": case.repeats, "one_order": int(case.one_order), "temperatures": case.temperatures,
    }  # fmt: skip


def _seen(oracle: Oracle, asked: list[str]) -> dict[str, Any]:
    visible = {s.effect for s in oracle.seen if s.visible}
    return {
        "effects": " ".join(asked), "visible": " ".join(e for e in asked if e in visible),
        "base_m": f"{oracle.base_m:.4g}", "oracle_m": f"{oracle.oracle_m:.4g}",
    }  # fmt: skip


def variables_of(truth: Truth) -> list[str]:
    """Variables that hidden causes outside the catalogue depend on, as columns of a session or tau_k, strongest first."""
    return [v for h in truth.hidden if h.effect in OUTSIDE for v in OUTSIDE[h.effect].variables(h.parameters)]
