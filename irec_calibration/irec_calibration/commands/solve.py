# SPDX-License-Identifier: Apache-2.0
"""`irec solve SESSION -o model.yaml`: identify a model, Eq. (14)-(19)."""

from __future__ import annotations

import argparse
import json
import textwrap

from ..diagnose import solved
from ..identification.identify import default_terms, with_disc
from ..model import EIGHTEEN_DOF, SIX_DOF, Model, blank_model
from ..model.file import check_model_target, save_model
from ._expected_error import expected_in_words
from ._session import as_read, configure_plausible, configure_without_tracker, plausible_session


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("session", help="folder of the table, MCAP file or rosbag2 folder")
    parser.add_argument("-o", "--output", default="model.yaml", help="model file to write (default: model.yaml)")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--dof", type=int, choices=(6, 18), help="6: joint_torsion; 18: with link_bending (default)")
    which.add_argument(
        "--terms", help="effect ids with commas between, instead of --dof (default for absolute sessions: the geometric model)"
    )
    configure_plausible(parser)
    configure_without_tracker(parser)
    parser.add_argument("--json", action="store_true", help="machine-readable figures on standard output")


def run(args: argparse.Namespace) -> int:
    check_model_target(args.output)
    session = as_read(args, plausible_session(args))
    if args.terms or args.dof:
        effects = args.terms.split(",") if args.terms else (SIX_DOF if args.dof == 6 else EIGHTEEN_DOF)
        terms = with_disc(blank_model([e.strip() for e in effects]), session)
    else:
        terms = default_terms(session)
    model, notes = solved(session, terms)
    path = save_model(model, args.output)
    if args.json:
        print(json.dumps({"model": str(path), "effects": list(model.effects), **model.figures}))
    else:
        for note in notes:
            print(f"note: {note}")
        print(describe(model))
        print(f"wrote {path}")
    return 0


def describe(model: Model) -> str:
    """The model as a readable table with its figures."""
    lines = [f"{'parameter':34} {'value':>12} {'std. error':>12}  unit"]
    summed = {name for c in model.combinations for name in c.weights}
    for term in model.terms:
        for name, e in term.estimates.items():
            unknown = "only in combination" if f"{term.effect.id}.{name}" in summed else "not visible here"
            known = "" if e.identified else f"  ({unknown})" if e.se != e.se else "  (weakly known)"
            error = f"{e.se:12.3g}" if e.se == e.se else f"{'-':>12}"
            lines.append(f"{term.effect.id + '.' + name:34} {e.value:12.4g} {error}  {e.unit}{known}")
    f = model.figures
    lines.append(
        f"{f['poses']} poses, {f['samples']} samples; rank {f['rank']}; residual {1e6 * f['fit_rms_m']:.1f} um"
        f" (held-out poses {1e6 * f['cv_rms_m']:.1f} um), noise {1e6 * f['noise_floor_m']:.1f} um"
    )
    lines.append(f"mean error {1e3 * f['fit_mean_m']:.4f} mm, on held-out poses {1e3 * f['cv_mean_m']:.4f} mm")
    lines += expected_in_words(model)
    lines.append(textwrap.fill(f"estimator: {f['estimator']}", 100, subsequent_indent="  "))
    lines += [textwrap.fill(f"known as a sum: {c}", 100, subsequent_indent="  ") for c in model.combinations]
    if "held_at_zero" in model.made:
        lines.append(
            f"held at zero, since others do the same or the poses do not show them: {', '.join(model.made['held_at_zero'])}"
        )
    if "caution" in model.made:
        lines.append(f"caution: {model.made['caution']}")
    return "\n".join(lines)
