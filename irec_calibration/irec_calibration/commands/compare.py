# SPDX-License-Identifier: Apache-2.0
"""`irec compare MODEL SESSION [-o DIR]`: predicted against measured, residual against noise, what is explainable at all."""

from __future__ import annotations

import argparse
import json
import shlex
import textwrap
from pathlib import Path

from ..diagnose import Comparison, compare, finite
from ..diagnose.tables import write_comparison
from ..effects.of_session import carrying
from ..files import all_or_none
from ..lengths import length
from ..model.file import check_belongs, load_model
from ..report.diagnosis import compare_section
from ..report.models import gap
from ..report.page import Figure, Page, write_page
from ..session import Session, read_session
from ._report import report


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", help="model.yaml")
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("-o", "--output", help="folder for residuals.csv and a report (default: none is written)")
    parser.add_argument("--json", action="store_true", help="machine-readable on standard output")


def run(args: argparse.Namespace) -> int:
    model, session = load_model(args.model), read_session(args.session)
    check_belongs(model, session.robot, session.serial)
    result = compare(carrying(session, model.carried), model.terms, model.sag_share)
    if args.output:
        folder = Path(args.output)
        with all_or_none():
            write_comparison(result, session, folder / "residuals.csv")
            report(lambda: [_page(result, session, folder, model.effects, args)])
    print(json.dumps(finite(as_json(result))) if args.json else in_words(result))
    return 0


def _page(result: Comparison, session: Session, folder: Path, effects: tuple[str, ...], args: argparse.Namespace) -> Path:
    model, said = shlex.quote(args.model), shlex.quote(args.session)
    verdict = (
        f"The model leaves {length(result.rms_m)} per sample; the noise explains {length(result.noise_floor_m)}, so that"
        f" {length(result.explainable_m)} could be explained by physics that the model lacks."
    )
    rows = [("model", result.rms_m, float("nan"))]
    title = f"The model leaves {length(result.rms_m)}"
    picture = gap(rows, result.noise_floor_m, folder / "verdict.png", title, of="residual per sample [um rms]")
    page = Page(
        f"{session.name}: {' + '.join(effects)}", verdict=verdict, hero=Figure(picture, f"{title}."),
        todo=[("Find out which effect is missing:", f"irec diagnose {said} --model {model}")],
        sections=[compare_section(result, session, folder)],
    )  # fmt: skip
    return write_page(page, folder / "report.html")


def as_json(c: Comparison) -> dict[str, object]:
    """Figures of a comparison."""
    return {
        "rms_m": c.rms_m, "noise_floor_m": c.noise_floor_m, "repeat_floor_m": c.repeat_floor_m, "explainable_m": c.explainable_m,
        "chi2_per_dof": c.chi2_per_dof, "by_axis_m": list(c.by_axis), "by_load_case_m": c.by_load_case, "by_pose_m": c.by_pose,
        "notes": list(c.notes),
    }  # fmt: skip


def in_words(c: Comparison) -> str:
    """A comparison for a terminal."""
    worst = sorted(c.by_pose.items(), key=lambda t: -t[1])[:5]
    lines = [
        f"residual {1e6 * c.rms_m:.1f} um per sample; noise of the instruments {1e6 * c.noise_floor_m:.1f} um;"
        f" explainable {1e6 * c.explainable_m:.1f} um",
        "along base x, y, z: " + ", ".join(f"{1e6 * v:.1f}" for v in c.by_axis) + " um",
        "by load case: " + ", ".join(f"{k} {1e6 * v:.1f}" for k, v in c.by_load_case.items()) + " um",
        "worst poses: " + ", ".join(f"{k} ({1e6 * v:.1f} um)" for k, v in worst),
    ]
    if c.repeat_floor_m == c.repeat_floor_m:
        lines.insert(1, f"repeats scatter by {1e6 * c.repeat_floor_m:.1f} um")
    return "\n".join(textwrap.fill(line, 100, subsequent_indent="  ") for line in [*lines, *(f"note: {n}" for n in c.notes)])
