# SPDX-License-Identifier: Apache-2.0
"""Are the probabilities right that the tool states? Clean sessions, and how often what it states happens there.

    python tools/hidden/calibration.py -o out/calibration [--sessions 200] [--seed 1] [--processes 2]

Draws clean cells (random robots, poses, repeats, tails; half of them state their noise wrongly; no bad rows), runs
`irec diagnose` on each, and compares

* the smallest `p_value` of a session with how often a value as small comes up where nothing is hidden (a stated 1 % in 1 %),
* the largest log odds (`log_evidence`) of any candidate: odds of L nats for something that is not there may come up in at
  most exp(-L) of the sessions,
* the range that is stated for the noise with the true one (where diagnosis.json has `noise`).

Prints a table, writes calibration.json and calibration.png. It continues where a run was interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from run import blindfold

LEVELS = (0.1, 0.05, 0.01, 0.001)


@dataclass
class Clean:
    """What the tool states of one clean session.

    Attributes:
        p_values: of the candidates; odds: their log evidence; covered: whether the stated range of the noise has the true one.
        even: whether the noise is normal and does not wander: else part of it counts as rows that stand out, or cancels.
    """

    name: str
    claim_right: bool
    status: str
    p_values: list[float] = field(default_factory=list)
    odds: list[float] = field(default_factory=list)
    noise_ratio: float = float("nan")
    covered: bool | None = None
    even: bool = True


def diagnose(folder: Path, name: str, out: Path) -> str:
    """`irec diagnose` on one session; a line for the terminal."""
    from irec_calibration.cli import main as irec

    there = out / name
    there.mkdir(parents=True, exist_ok=True)
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = irec(["diagnose", str(folder / "sessions" / name), "-o", str(there)])
    if code > 1 or not (there / "diagnosis.json").exists():
        return f"{name}: FAILED\n{said.getvalue()}"
    (there / "done").touch()
    return name


def read(row: dict[str, str], out: Path) -> Clean:
    """What was stated, from diagnosis.json and the row of matrix.csv."""
    said = json.loads((out / row["name"] / "diagnosis.json").read_text(encoding="utf-8"))
    case = Clean(row["name"], row["claim"] == "right", said["verdict"]["status"])
    case.even = row.get("tail", "normal") == "normal" and row.get("slow", "0") == "0"
    for candidate in said["candidates"]:
        for key, values in (("p_value", case.p_values), ("log_evidence", case.odds)):
            if isinstance(candidate.get(key), (int, float)):
                values.append(float(candidate[key]))
    noise = said.get("noise") or {}
    if isinstance(noise.get("inferred_m"), (int, float)) and noise.get("claimed_m"):
        true = noise["claimed_m"] / float(row["claim_factor"])
        case.noise_ratio = noise["inferred_m"] / true
        if isinstance(noise.get("inferred_low_m"), (int, float)):
            case.covered = bool(noise["inferred_low_m"] <= true <= noise["inferred_high_m"])
    return case


def share(values: Sequence[bool]) -> dict[str, Any]:
    """How many of how many, and the 95 % range of the rate behind it (Wilson)."""
    n, k = len(values), int(sum(values))
    if not n:
        return {"n": 0}
    p, z = k / n, 1.96
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return {"n": n, "k": k, "rate": p, "low": float(max(0.0, (middle - half) / scale)), "high": float((middle + half) / scale)}


def summary(cases: list[Clean]) -> dict[str, Any]:
    """All rates of some sessions."""
    smallest = [min(c.p_values) for c in cases if c.p_values]
    largest = [max(c.odds) for c in cases if c.odds]
    return {
        "sessions": len(cases),
        "adequate": share([c.status == "adequate" for c in cases]),
        "named": share([c.status == "missing_effect" for c in cases]),
        "smallest_p_value": {str(a): share([p <= a for p in smallest]) for a in LEVELS},
        "odds": {str(a): share([x >= -np.log(a) for x in largest]) for a in LEVELS},
        "noise_covered": share([c.covered for c in cases if c.covered is not None]),
        "even_noise_covered": share([c.covered for c in cases if c.covered is not None and c.even]),
        "noise_ratio": [float(x) for x in np.nanquantile([c.noise_ratio for c in cases], [0.05, 0.5, 0.95])]
        if any(np.isfinite(c.noise_ratio) for c in cases)
        else None,
    }


def in_words(parts: dict[str, dict[str, Any]]) -> str:
    """The table."""

    def cell(s: dict[str, Any]) -> str:
        return f"{100 * s['rate']:.1f} ({100 * s['low']:.1f}-{100 * s['high']:.1f})" if s["n"] else "-"

    lines = [f"{'happens in % (95 % range)':44}" + "".join(f"{name:>26}" for name in parts)]
    rows = [("called adequate", lambda p: p["adequate"]), ("an effect is named", lambda p: p["named"])]
    rows += [(f"smallest p-value of a session <= {a:g}", lambda p, a=a: p["smallest_p_value"][str(a)]) for a in LEVELS]
    rows += [(f"stated odds of {1 / a:g} to 1 and more", lambda p, a=a: p["odds"][str(a)]) for a in LEVELS]
    rows += [("true noise within the stated range", lambda p: p["noise_covered"])]
    rows += [("the same, normal noise that does not wander", lambda p: p["even_noise_covered"])]
    lines += [f"{label:44}" + "".join(f"{cell(of(p)):>26}" for p in parts.values()) for label, of in rows]
    lines.append(f"{'sessions':44}" + "".join(f"{p['sessions']:>26}" for p in parts.values()))
    for name, p in parts.items():
        if p["noise_ratio"]:
            low, mid, high = p["noise_ratio"]
            lines.append(f"inferred / true noise, {name}: median {mid:.2f}, 5-95 % {low:.2f} .. {high:.2f}")
    return "\n".join(lines)


def draw(cases: list[Clean], path: Path) -> None:
    """Left: stated p-values against how often they come up (the diagonal is right, below it is cautious); right: noise found."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.6), constrained_layout=True)
    grid = np.logspace(-4, 0, 200)
    for label, some, colour in (
        ("noise stated as it is", [c for c in cases if c.claim_right], "#1f77b4"),
        ("noise stated wrongly", [c for c in cases if not c.claim_right], "#ff7f0e"),
    ):
        smallest = np.array([min(c.p_values) for c in some if c.p_values])
        if len(smallest):
            left.plot(grid, [(smallest <= g).mean() for g in grid], color=colour, label=label)
    left.plot(grid, grid, color="0.4", lw=1)
    left.fill_between(grid, 0.2 * grid, np.minimum(3 * grid, 1), color="0.9", zorder=0)
    left.set(xscale="log", yscale="log", xlim=(1e-4, 1), ylim=(1e-3, 1.05), xlabel="smallest stated p-value of a session")
    left.set_ylabel(f"share of clean sessions ({len(cases)}) with that or less")
    for label, even, colour in (("normal, does not wander", True, "#2ca02c"), ("heavy tails, or wanders", False, "#9467bd")):
        ratio = np.sort([c.noise_ratio for c in cases if c.even is even and np.isfinite(c.noise_ratio)])
        right.plot(ratio, np.arange(1, len(ratio) + 1) / max(len(ratio), 1), color=colour, label=label)
    right.axvline(1.0, color="0.4", lw=1)
    right.set(xlabel="noise inferred / true noise", ylabel="share of sessions with that or less", ylim=(0, 1))
    for axes in (left, right):
        axes.legend(fontsize=8, loc="upper left")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description="Compare stated probabilities with what happens on clean sessions.")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/calibration"))
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    matrix, said = args.output / "matrix", args.output / "said"
    truth = args.output / "matrix-truth"
    if not (truth / "done").exists():
        made = subprocess.run(
            [sys.executable, "-m", "irec_sim.cli", "hidden", "--only", "clean", "--count", str(args.sessions), "--no-mishaps",
             "--out", str(matrix), "--seed", str(args.seed)], stdout=subprocess.DEVNULL, check=False,
        )  # fmt: skip
        if made.returncode:
            return made.returncode
        (truth / "done").touch()
    with (truth / "matrix.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    todo = [r["name"] for r in rows if not (said / r["name"] / "done").exists()]
    began = time.perf_counter()
    with ProcessPoolExecutor(args.processes, initializer=blindfold) as pool:
        futures = [pool.submit(diagnose, matrix, name, said) for name in todo]
        for i, future in enumerate(as_completed(futures), 1):
            left = (time.perf_counter() - began) / i * (len(todo) - i)
            print(f"[{i}/{len(todo)}] {future.result()}, about {left / 60:.0f} min left", flush=True)
    cases = [read(r, said) for r in rows if (said / r["name"] / "done").exists()]
    if not cases:
        print(f"{said}: no diagnosis", file=sys.stderr)
        return 2
    parts = {
        "all": summary(cases),
        "noise as stated": summary([c for c in cases if c.claim_right]),
        "stated wrongly": summary([c for c in cases if not c.claim_right]),
    }
    print(in_words(parts))
    (args.output / "calibration.json").write_text(json.dumps(parts, indent=1), encoding="utf-8")
    draw(cases, args.output / "calibration.png")
    print(f"wrote {args.output / 'calibration.png'}, calibration.json")
    return 0


if __name__ == "__main__":
    sys.exit(main())
