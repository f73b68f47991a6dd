# SPDX-License-Identifier: Apache-2.0
"""The `irec-sim` command: synthetic sessions and blind matrices from simulated cells."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from .cellfile import CellFile, read_cell
from .errors import SimError
from .hidden import write_matrix
from .matrix import KIND_NAMES, STRENGTHS, clean_cases, matrix_cases, plain_cases
from .poses import poses_of_file
from .session import generate, scale_to_share, write_deflections, write_session
from .truth import EFFECTS, Truth, make_truth, read_truth


def _truth(args: argparse.Namespace, cell: CellFile) -> Truth:
    if args.truth is None:
        return make_truth(cell.name, args.effect or [], args.truth_seed, effort=cell.chain.effort)
    if args.effect:
        raise SimError("give --truth or --effect, not both")
    return read_truth(args.truth, cell.name, args.truth_seed, cell.chain.effort)


def _session(args: argparse.Namespace) -> int:
    cell = read_cell(args.cell)
    truth = _truth(args, cell)
    if args.strength is not None:
        truth, shown = scale_to_share(cell, truth, args.strength, args.truth_seed)
        for h in truth.hidden:
            if h.effect not in shown:
                print(
                    f"irec-sim: {h.effect} does not reach {args.strength:g} of the deflection with these parameters",
                    file=sys.stderr,
                )
    at = None if args.at is None else poses_of_file(args.at, cell)
    count = args.poses if at is None else len(at.q)
    made = generate(cell, truth, count, args.seed, args.repeats, at=at)
    folder = write_session(made, args.output, args.name or Path(args.output).name)
    if args.truth_out is not None:
        out = Path(args.truth_out)
        if out.resolve() == folder.resolve() or folder.resolve() in out.resolve().parents:
            raise SimError(f"--truth-out {out}: must not be inside the session folder")
        out.mkdir(parents=True, exist_ok=True)
        (out / "truth.yaml").write_text(yaml.safe_dump(truth.as_data(), sort_keys=False), encoding="utf-8")
        write_deflections(made, out / "truth.csv")
    size = np.linalg.norm(made.rows[0].deflection, axis=2)
    print(f"{folder}: {count} poses x {len(cell.load_cases)} load cases x {args.repeats}")
    print(f"deflection of the TCP: mean {1e3 * size.mean():.3f} mm, max {1e3 * size.max():.3f} mm")
    return 0


def _hidden(args: argparse.Namespace) -> int:
    rng = np.random.default_rng([args.seed, 7])
    if args.effect:
        unknown = [e for e in args.effect if e not in EFFECTS and e != "clean"]
        if unknown:
            raise SimError(f"--effect {unknown[0]}: not known; there are clean, {', '.join(EFFECTS)}")
        cases = plain_cases(args.effect, args.strength or STRENGTHS, args.repeats)
    elif args.clean:
        cases = clean_cases(rng, args.count or 20, not args.no_mishaps)
    else:
        cases = matrix_cases(rng, args.size, args.quick, args.only or KIND_NAMES, args.count, not args.no_mishaps)
    truth = write_matrix(
        args.out, args.seed, cases, args.poses, args.validation_poses, lambda text: print(text, flush=True)
    )  # fmt: skip
    print(f"sessions in {args.out}, truth in {truth}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="irec-sim", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    session = commands.add_parser("session", help="write one synthetic calibration session in the table form")
    session.add_argument("--cell", default="afp", help="afp, milling or a cell file (default: afp)")
    session.add_argument("--truth", help="truth file; without one the default truth of the cell")
    session.add_argument(
        "--effect", action="append", metavar="ID", help=f"hidden effect with drawn parameters: {', '.join(EFFECTS)}"
    )
    session.add_argument("--truth-seed", type=int, default=0, help="draws what the truth leaves open (default: 0)")
    session.add_argument("--strength", type=float, help="scale each hidden effect to this share of the RMS deflection, e.g. 0.08")
    session.add_argument("--poses", type=int, default=31)
    session.add_argument("--at", metavar="FILE", help="pose file of irec plan: measure there, in place of --poses")
    session.add_argument("--repeats", type=int, default=1)
    session.add_argument("--seed", type=int, default=0, help="poses, times, noise")
    session.add_argument("--name", help="name in session.yaml")
    session.add_argument("-o", "--output", required=True, help="new folder for the session")
    session.add_argument("--truth-out", help="folder, outside the session, for the truth and the true deflection of each row")
    session.set_defaults(run=_session)
    hidden = commands.add_parser("hidden", help="write a blind matrix of sessions with hidden causes")
    hidden.add_argument("--out", required=True, help="new folder for the sessions; the truth goes to the same name with -truth")
    hidden.add_argument("--seed", type=int, default=0)
    hidden.add_argument("--size", type=float, default=1.0, help="multiplies the number of sessions (default: 1)")
    hidden.add_argument("--quick", action="store_true", help="about forty sessions")
    hidden.add_argument("--only", action="append", choices=KIND_NAMES, help="only this kind of session; may be given again")
    hidden.add_argument("--count", type=int, help="how many sessions of each kind (default: as the matrix has them)")
    hidden.add_argument("--clean", action="store_true", help="--count loaded and as many absolute sessions, nothing hidden")
    hidden.add_argument("--no-mishaps", action="store_true", help="nothing goes wrong in single rows")
    hidden.add_argument("--poses", type=int, help="of each session (default: 18 to 40, drawn)")
    hidden.add_argument("--validation-poses", type=int, default=20)
    hidden.add_argument("--effect", action="append", metavar="ID", help="only this effect (or 'clean'); may be given again")
    hidden.add_argument("--strength", action="append", type=float, help="with --effect: share of the RMS deflection")
    hidden.add_argument("--repeats", type=int, default=1, help="with --effect: cells of each")
    hidden.set_defaults(run=_hidden)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; exit code 0 done, 2 bad input."""
    args = _parser().parse_args(argv)
    try:
        return int(args.run(args))
    except SimError as error:
        print(f"irec-sim {args.command}: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
