# SPDX-License-Identifier: Apache-2.0
"""`irec plan CELL -n 31 --method cover --d-max 0.175 -o poses.yaml`: choose engagement poses on the tooling of a cell."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..cell import read_cell
from ..errors import IrecError
from ..poses.plan import TURN, TURN_FROM, make_plan, pose_list, turn_for
from ..poses.select import METHODS
from ..poses.store import write_poses
from ..report.pose_picture import save_picture


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cell", help="cell file, e.g. config/cells/afp.yaml")
    parser.add_argument("-n", type=int, default=31, help="number of poses (default: 31)")
    methods = "; ".join(f"{name}: {text}" for name, text in METHODS.items())
    parser.add_argument("--method", choices=list(METHODS), default="cover", help=f"{methods} (default: cover)")
    parser.add_argument(
        "--d-max", type=float, default=0.0, metavar="M", help="cover: stop when every candidate is within M metres of a pose"
    )
    turn = "poses, at least, in which loads turn the torque of each axis that they can turn; play shows nowhere else"
    parser.add_argument("--turn", type=int, metavar="POSES", help=f"{turn} (default: {TURN}, or 0 if N < {TURN_FROM})")
    parser.add_argument("--along-surface", action="store_true", help="distances along the surface instead of straight")
    parser.add_argument("--pool", type=int, default=3000, help="size of the pool of candidates (default: 3000)")
    parser.add_argument("--seed", type=int, default=1, help="of the random draws (default: 1)")
    parser.add_argument("-o", "--output", help="pose file (default: the one that the cell file names)")
    parser.add_argument("--picture", help="PNG of surface, pool and poses (default: beside the pose file)")
    parser.add_argument("--json", action="store_true", help="machine-readable figures on standard output")


def run(args: argparse.Namespace) -> int:
    cell = read_cell(args.cell)
    plan = make_plan(
        cell,
        args.n,
        method=args.method,
        d_max=args.d_max,
        pool_size=args.pool,
        seed=args.seed,
        along_surface=args.along_surface,
        turn=turn_for(args.n) if args.turn is None else args.turn,
    )
    path = write_poses(pose_list(cell, plan), args.output or cell.poses_path)
    picture: Path | None = None
    missing = ""
    try:
        picture = save_picture(cell, plan, args.picture or path.with_suffix(".png"))
    except IrecError as error:
        if args.picture:
            raise
        missing = str(error)
    f = plan.figures
    if args.json:
        about = {"poses": str(path), "picture": str(picture) if picture else None}
        print(json.dumps({**about, "drawn": plan.pool.drawn, "rejected": plan.pool.rejected, "pool": len(plan.pool), **{
            "method": plan.method, "figures": f}}))  # fmt: skip
        return 0
    print(f"pool: {plan.pool.counts()}")
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
    print(f"wrote {path}" + (f" and {picture}" if picture else f" (no picture: {missing})"))
    return 0
