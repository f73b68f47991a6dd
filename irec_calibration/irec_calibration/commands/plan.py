# SPDX-License-Identifier: Apache-2.0
"""`irec plan CELL -n 31 --method cover --d-max 0.175 -o poses.yaml`: choose engagement poses on the tooling of a cell.

`irec plan CELL --to-tell SESSION -o next_poses.yaml` chooses few that answer what a diagnosis of the session leaves open.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..cell import Cell, read_cell
from ..diagnose.to_tell import Told, chosen_to_tell, in_words, left_open, tells
from ..effects import find_effect
from ..errors import IrecError
from ..files import all_or_none
from ..poses.plan import TURN, TURN_FROM, Plan, make_plan, pose_list, turn_for
from ..poses.pool import Pool
from ..poses.select import METHODS
from ..poses.store import check_poses_target, write_poses
from ..report.pose_picture import save_picture
from ..report.style import pyplot
from ..session import read_session
from ..session.plausible import check_plausible
from ..typing import IntArray
from ._progress import Progress

POSES, POSES_TO_TELL = 31, 8
POOL, POOL_TO_TELL = 3000, 400


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cell", help="cell file, e.g. config/cells/afp.yaml")
    parser.add_argument("-n", type=int, help=f"number of poses (default: {POSES}; with --to-tell {POSES_TO_TELL})")
    parser.add_argument(
        "--to-tell", metavar="SESSION", help="choose poses that answer what a diagnosis of this session of the cell leaves open"
    )
    methods = "; ".join(f"{name}: {text}" for name, text in METHODS.items())
    parser.add_argument("--method", choices=list(METHODS), default="cover", help=f"{methods} (default: cover)")
    parser.add_argument(
        "--d-max", type=float, default=0.0, metavar="M", help="cover: stop when every candidate is within M metres of a pose"
    )
    turn = "poses, at least, in which loads turn the torque of each axis that they can turn; play shows nowhere else"
    parser.add_argument("--turn", type=int, metavar="POSES", help=f"{turn} (default: {TURN}, or 0 if N < {TURN_FROM})")
    parser.add_argument("--along-surface", action="store_true", help="distances along the surface instead of straight")
    parser.add_argument("--pool", type=int, help=f"candidates (default: {POOL}; with --to-tell {POOL_TO_TELL})")
    parser.add_argument("--seed", type=int, default=1, help="of the random draws (default: 1)")
    parser.add_argument("-o", "--output", help="pose file (default: that of the cell; with --to-tell next_poses.yaml beside it)")
    parser.add_argument("--picture", help="PNG of surface, pool and poses (default: beside the pose file)")
    parser.add_argument("--json", action="store_true", help="machine-readable figures on standard output")


def run(args: argparse.Namespace) -> int:
    cell = read_cell(args.cell)
    target = check_poses_target(args.output or _poses_path(args, cell))
    plan, told = _plan(args, cell)
    picture: Path | None = None
    missing = ""
    try:
        pyplot()
    except IrecError as error:
        if args.picture:
            raise
        missing = str(error)
    with all_or_none():
        path = write_poses(pose_list(cell, plan), target)
        if not missing:
            picture = save_picture(cell, plan, args.picture or path.with_suffix(".png"))
    if args.json:
        about = {"poses": str(path), "picture": str(picture) if picture else None}
        print(json.dumps({**about, "drawn": plan.pool.drawn, "rejected": plan.pool.rejected, "pool": len(plan.pool), **{
            "method": plan.method, "figures": plan.figures}, **({"to_tell": _told_json(told)} if told else {})}))  # fmt: skip
    else:
        print(f"pool: {plan.pool.counts()}")
        if told is None:
            _tell_figures(plan)
        else:
            print("\n".join([f"N = {len(plan.chosen)} poses, those that tell most first", *in_words(told, _label)]))
        print(f"wrote {path}" + (f" and {picture}" if picture else f" (no picture: {missing})"))
    return 0 if told is None or tells(told) else 1


def _plan(args: argparse.Namespace, cell: Cell) -> tuple[Plan, Told | None]:
    """The plan, and what it is expected to tell where it was made for that."""
    if not args.to_tell:
        n = POSES if args.n is None else args.n
        plan = make_plan(
            cell,
            n,
            method=args.method,
            d_max=args.d_max,
            pool_size=POOL if args.pool is None else args.pool,
            seed=args.seed,
            along_surface=args.along_surface,
            turn=turn_for(n) if args.turn is None else args.turn,
        )
        return plan, None
    if args.method != "cover" or args.d_max or args.turn is not None or args.along_surface:
        raise IrecError("--to-tell chooses poses by itself; give no --method, --d-max, --turn or --along-surface with it")
    n = POSES_TO_TELL if args.n is None else args.n
    session = read_session(args.to_tell)
    check_plausible(session)
    asked = left_open(session, cell, progress=Progress())
    told: list[Told] = []

    def choose(pool: Pool) -> IntArray:
        told.append(chosen_to_tell(asked, cell, pool, n))
        return told[0].chosen

    size = POOL_TO_TELL if args.pool is None else args.pool
    plan = make_plan(cell, n, method="to_tell", pool_size=size, seed=args.seed, choose=choose)
    return plan, told[0]


def _poses_path(args: argparse.Namespace, cell: Cell) -> Path:
    """Where poses go that have no place of their own: those of the whole procedure to where the cell says, others beside it."""
    return cell.poses_path.with_name("next_poses.yaml") if args.to_tell else cell.poses_path


def _told_json(told: Told) -> list[dict[str, object]]:
    return [
        {"names": [n for n in q.names if n], "nats": told.nats[i, -1].tolist(), "lacks": list(q.lacks), "chance": told.chance(i)}
        for i, q in enumerate(told.questions)
    ]


def _label(name: str) -> str:
    """An effect in words; with a colon its axes follow."""
    effect_id, colon, rest = name.partition(":")
    return find_effect(effect_id).label + (f" ({rest.strip()})" if colon else "")


def _tell_figures(plan: Plan) -> None:
    f = plan.figures
    print(f"N = {len(plan.chosen)} poses by {plan.method}, cover distance {1e3 * f['cover_distance_m']:.1f} mm")
    print(
        f"spread: {100 * f['edge_share']:.0f} % of the poses in the outer quarter of the surface, nearest neighbours "
        f"{f['nearest_neighbour_ratio']:.2f} times as far apart as random ones (below 1: clustered)"
    )
    print(
        f"O1 = {f['o1']:.4g} N m^2/rad on {f['rank']:.0f} identifiable combinations of compliances, "
        f"condition number {f['condition']:.3g}"
    )
    print(
        f"predicted uncertainty of the deflection over the work surface (tracker and settling noise, 18 DOF): "
        f"rms {1e6 * f['predicted_uncertainty_rms_m']:.1f} um, at most {1e6 * f['predicted_uncertainty_max_m']:.1f} um"
    )
    axes = [name.removeprefix("turnable_") for name, count in f.items() if name.startswith("turnable_") and count]
    turned = [f"{a} in {f[f'turned_{a}']:.0f} poses (of {f[f'turnable_{a}']:.0f} in the pool)" for a in axes]
    print(f"play shows where loads turn the torque of an axis: {', '.join(turned) or 'nowhere'}")
