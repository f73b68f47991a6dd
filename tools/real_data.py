# SPDX-License-Identifier: Apache-2.0
"""Figures of docs/real-data: held-out error of a ladder of models on each measured set, and what `irec improve` makes of it.

    .venv/bin/python tools/real_data.py [SET ...] [-o docs/real-data] [--ladder]
    .venv/bin/python tools/real_data.py --across wam wam-random

Data are looked for in IREC_REAL_DATA, or ../shared/data beside the checkout; sets that are not there are skipped.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from irec_calibration.diagnose import compare, improve, validated
from irec_calibration.identification.absolute import base_terms, near_pairs, thinned
from irec_calibration.identification.identify import fit, observe_with_force_noise
from irec_calibration.identification.validation import ESTIMATOR
from irec_calibration.model import blank_model
from irec_calibration.report.style import BLUE, GREY, ORANGE, pyplot, save
from irec_calibration.session import Session
from irec_calibration.session.foreign import import_table

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("IREC_REAL_DATA", ROOT.parent / "shared" / "data"))
PLACED = ("station_pose", "marker_position")
TORSION, BENDING, ENCODER = ("joint_torsion",), ("joint_torsion", "link_bending"), ("joint_torsion", "encoder_harmonics")
HISTORY = ("joint_hysteresis", "joint_settling")


@dataclass(frozen=True)
class Set:
    """One measured set: profile, table, and effects beyond torsion that need a clock."""

    profile: str
    table: str
    title: str
    history: tuple[str, ...] = ()


SETS = {
    "ur5": Set(
        "ur5-jacobi", "jacobi_ur5_wam_lasertracker/UR5/3D_UR5_uncalibrated_grid_cleaned.csv", "UR5, laser tracker", HISTORY
    ),
    "wam": Set(
        "wam-jacobi",
        "jacobi_ur5_wam_lasertracker/WAM/3D_WAM_uncalibrated_grid_cleaned.csv",
        "Barrett WAM, laser tracker",
        HISTORY,
    ),
    "ur10-a": Set(
        "ur10-ipa-a", "ipa_ur10_lasertracker/Series_A/measurements_grid.csv", "UR10, T-Mac, series A", (*HISTORY, "thermal_drift")
    ),
    "ur10-b": Set("ur10-ipa-b", "ipa_ur10_lasertracker/Series_B/measurements_joint_configurations.csv", "UR10, T-Mac, series B"),
    "ur10-c": Set("ur10-ipa-c", "ipa_ur10_lasertracker/Series_C/measurements_random_poses.csv", "UR10, T-Mac, series C"),
    "ur10-d": Set("ur10-ipa-d", "ipa_ur10_lasertracker/Series_D/measurements_iso_cubes.csv", "UR10, T-Mac, series D"),
}

RANDOM = {  # other poses of the same robots, to compare models with
    f"{name}-random": Set(
        f"{name}-jacobi", f"jacobi_ur5_wam_lasertracker/{name.upper()}/3D_{name.upper()}_uncalibrated_random_cleaned.csv", ""
    )
    for name in ("ur5", "wam")
}


def ladder(one: Set) -> list[tuple[str, tuple[str, ...] | None]]:
    """Names of the models and the effects beyond the geometric model (None: stations and markers only)."""
    out: list[tuple[str, tuple[str, ...] | None]] = [
        ("stations, markers", None), ("+ geometry", ()), ("+ joint torsion", TORSION), ("+ torsion, link bending", BENDING),
        ("+ torsion, encoder harmonics", ENCODER),
    ]  # fmt: skip
    if "joint_hysteresis" in one.history:
        out.append(("+ torsion, joint hysteresis", (*TORSION, "joint_hysteresis")))
    if one.history:
        drift = ", drift" if "thermal_drift" in one.history else ""
        out.append((f"+ torsion, encoder, history{drift}", (*ENCODER, *one.history)))
    return out


def across(names: Sequence[str]) -> None:
    """Print how far the versions that `irec improve` makes of one set are from others of the same robot."""
    first, *others = (_imported((SETS | RANDOM)[name]) for name in names)
    for rung in improve(first).rungs:
        errors = (f"{name} {1e3 * compare(session, rung.model.terms).rms_m:.3f}" for name, session in zip(names[1:], others))
        print(f"{names[0]} {rung.title:44} rms, mm: {', '.join(errors)}", flush=True)


def _imported(one: Set) -> Session:
    with tempfile.TemporaryDirectory() as scratch:
        return import_table(ROOT / "docs" / "real-data" / f"{one.profile}.profile.yaml", DATA / one.table, scratch)


def run(name: str, one: Set, folder: Path, ladder_only: bool) -> None:
    """Print the ladder of one set, draw it, and print what `irec improve` adds and says."""
    session = _imported(one)
    whole = observe_with_force_noise(session, base_terms())
    few = thinned(whole)
    print(f"{name}: {len(session)} rows, {len(few.rows)} used; {ESTIMATOR}")
    print("  mean error on held-out poses, mm (standard error over poses)")
    for note in few.session.notes:
        print(f"  note: {note}")
    means, labels, geometric = [], [], None
    for label, effects in ladder(one):
        terms = blank_model(PLACED) if effects is None else [*base_terms(), *blank_model(effects)]
        made = validated(session, terms)
        error = made.held_out
        geometric = 1e3 * np.linalg.norm(error.residual, axis=1) if label == "+ geometry" else geometric
        means.append(1e3 * error.mean_m)
        labels.append(label)
        print(f"  {label:34} {1e3 * error.mean_m:8.4f} ({1e3 * error.mean_se_m:.4f})   rank {made.study.fit.rank}")
    floor = 1e3 * few.whiten.floor * np.sqrt(8.0 / (3.0 * np.pi))  # mean of the norm of three normal errors with that RMS
    print(f"  {'noise of instruments and robot':34} {floor:8.4f}")
    if not ladder_only:
        told = improve(session)
        for rung in told.rungs:
            what = f"irec improve: {rung.title if rung.added else 'start'}"
            print(f"  {what:34} {1e3 * float(rung.model.figures['cv_mean_m']):8.4f}   rms {1e3 * rung.cv_rms_m:.4f}")
        means.append(1e3 * float(told.rungs[-1].model.figures["cv_mean_m"]))
        labels.append("irec improve")
        print(f"  stopped: {told.stopped}")
        print(f"  verdict: {told.before.verdict.status}. {told.before.verdict.text}")
    pairs = near_pairs(whole, fit(base_terms(), whole).residual)
    draw(folder / f"{name}.png", one.title, labels, means, floor, geometric, whole, pairs)


def draw(path, title, labels, means, floor, geometric, whole, pairs) -> None:  # type: ignore[no-untyped-def]
    """Bars of the ladder, and how the residual is distributed."""
    plt = pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.5, 3.8), layout="constrained")
    at = np.arange(len(labels))[::-1]
    left.barh(at, means, color=[GREY, BLUE, *[ORANGE] * (len(labels) - 2)], height=0.65)
    for y, value in zip(at, means, strict=True):
        left.text(value + 0.01 * max(means), y, f"{value:.3f}", va="center", fontsize=9)
    left.axvline(floor, color="k", lw=1, ls="--")
    left.text(floor, len(labels) - 0.45, f" noise {floor:.3f}", ha="left", va="bottom", fontsize=9)
    left.set_yticks(at, labels)
    left.set_xlim(0, 1.15 * max(means))
    left.set_ylim(-0.6, len(labels) - 0.1)
    left.set_xlabel("mean error on held-out poses, mm")
    left.set_title(title)
    bins = np.linspace(0, float(np.quantile(geometric, 0.995)), 41)
    right.hist(geometric, bins, density=True, color=BLUE, alpha=0.75, label="geometry, held-out poses")
    if pairs.repeats:
        r = 1e3 * fit(base_terms(), whole).residual
        change = np.linalg.norm(r[pairs.first] - r[pairs.second], axis=1)
        right.hist(change, bins, density=True, color=ORANGE, alpha=0.75, label=f"difference within {len(change)} near pairs")
    right.set_xlabel("error, mm")
    right.set_ylabel("density, 1/mm")
    right.set_title("How large the errors are")
    right.set_ylim(0, 1.18 * right.get_ylim()[1])
    right.legend()
    save(figure, path)
    print(f"  wrote {path}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", choices=[*SETS, *RANDOM, []], help=f"default: all of {', '.join(SETS)}")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "real-data")
    parser.add_argument("--ladder", action="store_true", help="the ladder and the figure only")
    parser.add_argument("--across", action="store_true", help="improve on the first set, compare each version with the others")
    args = parser.parse_args()
    if args.across:
        known = SETS | RANDOM
        if len(args.sets) < 2 or not all((DATA / known[n].table).exists() for n in args.sets):
            parser.error(f"--across compares two sets or more, which have to be in {DATA}")
        across(args.sets)
        return
    if any(n in RANDOM for n in args.sets):
        parser.error(f"{', '.join(RANDOM)}: for --across only")
    for name in args.sets or SETS:
        if (DATA / SETS[name].table).exists():
            run(name, SETS[name], args.output, args.ladder)
        else:
            print(f"{name}: skipped, {DATA / SETS[name].table} is not there")


if __name__ == "__main__":
    main()
