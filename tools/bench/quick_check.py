# SPDX-License-Identifier: Apache-2.0
"""False alarms and missed changes of the quick check on simulated robots of the AFP cell; each number of robots by `--robots`.

The plant is irec_sim's; each year the tracker stands somewhere else. A change that moves the tool by less than 10 % of the
tolerance may be missed at its own size; it is tried once more at the size that the plan of the quick check states (stated
size). What is not decided goes on to the full procedure and so is found. Beside what was found stand the largest displacement
of the tool, and what can be found of it at all: by the best test of all visits, one that is told how each row changes, at 2 %
false alarms; and by the same test of a thousand repeats of each visit, where what the calibration itself leaves open remains.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from irec_calibration.cell import read_cell as planned_cell
from irec_calibration.identification.identify import default_terms, identify
from irec_calibration.poses.plan import TURN, make_plan
from irec_calibration.recertification.quick_check import (
    FALSE_ALARM,
    MOST_VISITS,
    Reference,
    check,
    reference_of,
    signal_to_noise,
)
from irec_calibration.recertification.quick_plan import MATTERS, QuickPlan, plan
from irec_calibration.recertification.station import with_stations_found
from irec_calibration.session import Session, read_session
from irec_calibration.typing import Array, Json
from irec_sim.cellfile import CellFile, read_cell
from irec_sim.observe import simulate
from irec_sim.poses import Poses
from irec_sim.recorded import Pass
from irec_sim.session import Conduct, Generated, make_schedule, write_session
from irec_sim.truth import EFFECTS, Hidden, Truth, make_truth
from scipy.spatial.transform import Rotation
from scipy.stats import beta, norm

POSES, POOL, TOLERANCE = 31, 1500, 3e-4
AFP = Path(__file__).parents[2] / "config" / "cells" / "afp.yaml"
MANY = 1000.0  # repeats of each visit
UNCHANGED = "nothing has changed"
LOOSE = {"per_translation": [1.6e-9, 1.6e-9, 2.2e-9], "per_rotation": [4e-8, 4e-8, 4e-8]}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=2, help="robots of each kind (default: 2)")
    parser.add_argument("--first", type=int, default=0, help="number of the first robot, which is its seed too (default: 0)")
    parser.add_argument("--unchanged", type=int, default=4, help="checks of each robot that has not changed (default: 4)")
    parser.add_argument("--repeats", type=int, default=1, help="times that the calibration measured each pose (default: 1)")
    parser.add_argument("--noise", type=float, default=1.0, help="true noise as a multiple of the stated one (default: 1)")
    across = "forces across the tool in the check, times those of the calibration (default: 1.25, what the cell bears)"
    parser.add_argument("--lateral", type=float, default=1.25, help=across)
    turn = "poses in which the load turns the torque of each axis that it can turn, as `irec plan --turn` (default: 3)"
    parser.add_argument("--turn", type=int, default=TURN, help=turn)
    parser.add_argument("--bounds", action="store_true", help="check no robot: only what the best test finds of each change")
    kept = "file of what was counted: robots that are in it already are not checked again, and are part of the table"
    parser.add_argument("--keep", type=Path, help=kept)
    args = parser.parse_args(arguments)
    done = _read(args)
    try:
        for seed in range(args.first, args.first + args.robots):
            if str(seed) not in done:
                done[str(seed)] = _robot(seed, args)
                print(f"robot {seed}", file=sys.stderr, flush=True)
                if args.keep:
                    args.keep.write_text(json.dumps({"settings": _settings(args), "robots": done}))
    except KeyboardInterrupt:
        print("interrupted: what was counted so far", file=sys.stderr)
    _print(done, args)
    return 0


def _settings(args: argparse.Namespace) -> Json:
    """What all robots of a table have in common."""
    return {k: v for k, v in vars(args).items() if k not in ("robots", "first", "keep")}


def _read(args: argparse.Namespace) -> dict[str, Json]:
    """Results of robots, by number, that were kept."""
    if not args.keep or not args.keep.exists():
        return {}
    kept = json.loads(args.keep.read_text())
    if kept["settings"] != _settings(args):
        raise SystemExit(f"{args.keep}: counted with {kept['settings']}, not with {_settings(args)}; name another file")
    return dict(kept["robots"])


def _robot(seed: int, args: argparse.Namespace) -> Json:
    """One robot: calibrated, then checked unchanged and with each change; name -> what came of it each time."""
    found: dict[str, list[Json]] = {}
    truth = make_truth("afp", [], seed)
    where = _planned(seed, args.turn)
    base = with_stations_found(_measured(truth, where, 1000 + seed, args.noise, args.repeats))
    reference = reference_of(identify(base, default_terms(base)).terms, base, TOLERANCE)
    chosen = plan(reference, args.lateral)
    poses = [p - 1 for p in chosen.poses]
    for number, (name, changed) in enumerate(_kinds(truth, chosen.sizes, args.unchanged)):
        noise_seed = 10_000 + 100 * seed + number
        if args.bounds:
            decision, visits = "undecided", 0
        else:
            decision, visits = _checked(reference, changed, _some(where, poses), noise_seed, args.noise, chosen)
        moved = float(np.linalg.norm(_moved(truth, changed, where), axis=1).max())
        best, many = _bound(reference, truth, changed, _some(where, poses), args.lateral)
        # one that moves the tool by a part of the tolerance that matters, or that is as large as the plan says it has to be
        matters = moved > MATTERS * TOLERANCE or name.endswith("stated size")
        result = {"decision": decision, "visits": visits, "moved": moved, "matters": matters, "best": best, "many": many}
        found.setdefault(name, []).append(result)
    return found


def _planned(seed: int, turn: int) -> Poses:
    """The poses that `irec plan` chooses for the AFP cell."""
    made = make_plan(planned_cell(AFP), POSES, pool_size=POOL, seed=seed, turn=turn)
    pool, chosen = made.pool, made.chosen
    return Poses(pool.q[chosen], pool.rail[chosen], pool.p_in_base[chosen], pool.R_in_base[chosen])


def _print(done: Mapping[str, Json], args: argparse.Namespace) -> None:
    found: dict[str, list[Json]] = {}
    for robot in done.values():
        for name, results in robot.items():
            found.setdefault(name, []).extend(results)
    said = (
        f"each calibrated on {POSES} poses measured {args.repeats} times, {args.turn} or more of them turn each axis that can be"
    )
    said += f" turned, noise {args.noise:g} times the stated, {args.lateral:g} times the forces across the tool"
    numbers = sorted(int(n) for n in done)
    print(f"quick check, {len(done)} robots ({numbers[0]} to {numbers[-1]}), {said}" if done else "no robot was checked")
    best = "best: what the best test of the same readings finds"
    print(f"found: did not pass; moved: largest displacement of the tool; {best}, also with {MANY:g} repeats of each")
    print(f"{'':30}  changed  not decided  pass  mean visits  moved um   found  best  repeats")
    for name, results in found.items():
        n, c = len(results), Counter(r["decision"] for r in results)
        mean = {k: float(np.mean([r[k] for r in results])) for k in ("visits", "best", "many")}
        moved = 1e6 * max(r["moved"] for r in results)
        row = f"{c['changed']:7}  {c['undecided']:11}  {c['pass']:4}  {mean['visits']:11.1f}  {moved:8.0f}"
        share = "     -" if args.bounds else f"{100.0 * (1.0 - c['pass'] / n):4.0f} %"
        print(f"{name:30}  {row}  {share}  {100 * mean['best']:3.0f} %  {100 * mean['many']:4.0f} %")
    if args.bounds:
        return
    same = Counter(r["decision"] for r in found.get(UNCHANGED, []))
    times = same.total()
    if times:
        print(f"false alarms: {_share(same['changed'], times)}; unchanged robots that passed: {_share(same['pass'], times)}")
    others = [r for name, results in found.items() if name != UNCHANGED for r in results if r["matters"]]
    if others:
        caught = sum(r["decision"] != "pass" for r in others)
        print(f"changes that matter or have their stated size and did not pass: {_share(caught, len(others))}")


def _share(k: int, n: int) -> str:
    """k of n with its 95 % confidence interval (Clopper and Pearson)."""
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return f"{k} of {n} (95 % interval {100 * low:.1f} to {100 * high:.1f} %)"


def _kinds(truth: Truth, sizes: Mapping[str, float], unchanged: int) -> list[tuple[str, Truth]]:
    kinds = [(UNCHANGED, truth)] * unchanged
    for k in range(6):
        name = f"axis {k + 1}: 10 % softer"
        at = {name: 1.0} | ({f"axis {k + 1}: softer, stated size": sizes[name]} if sizes.get(name, 1.0) > 1.0 else {})
        for label, size in at.items():
            axial = truth.axial.copy()
            axial[k] *= 1.0 + 0.1 * size
            kinds.append((label, replace(truth, axial=axial)))
    for k in range(6):
        name = f"axis {k + 1}: play of 100 urad"
        at = {name: 1.0} | ({f"axis {k + 1}: play, stated size": sizes[name]} if sizes.get(name, 1.0) > 1.0 else {})
        kinds += [(label, _with(truth, "joint_backlash", joint=k + 1, width=1e-4 * size)) for label, size in at.items()]
    return [*kinds, ("base has come loose", _with(truth, "base_compliance", **LOOSE))]


def _with(truth: Truth, effect: str, **parameters: Any) -> Truth:
    drawn = EFFECTS[effect].draw(np.random.default_rng(0))
    return replace(truth, hidden=(Hidden(effect, {**drawn, **parameters}),))


def _some(where: Poses, index: list[int]) -> Poses:
    return Poses(where.q[index], where.rail[index], where.p[index], where.R[index])


def _cell(lateral: float = 1.0) -> CellFile:
    """The AFP cell with other forces across the tool."""
    cell = read_cell("afp")
    return replace(cell, load_cases=cell.load_cases * np.array([lateral, lateral, 1.0]))


def _moved(before: Truth, after: Truth, where: Poses, lateral: float = 1.0) -> Array:
    """Change of the tool's displacement as observed, over all poses and load cases, (m, 3), m."""
    cell = _cell(lateral)
    schedule = make_schedule(cell, where, 0.0, np.random.default_rng(0))
    a, b = (simulate(cell, t.physics(), schedule).apparent_deflection(cell) for t in (before, after))
    return np.asarray(b - a).reshape(-1, 3)


def _bound(reference: Reference, before: Truth, after: Truth, where: Poses, lateral: float) -> tuple[float, float]:
    """What the best test finds of a change, of all visits and of many repeats of them."""
    session, moved = _measured(before, where, 1, 1.0, lateral=lateral), _moved(before, after, where, lateral)
    threshold = norm.isf(FALSE_ALARM)
    once, often = (float(norm.cdf(signal_to_noise(reference, session, moved, n) - threshold)) for n in (1.0, MANY))
    return once, often


def _checked(reference: Reference, truth: Truth, where: Poses, seed: int, noise: float, chosen: QuickPlan) -> tuple[str, int]:
    session = _measured(truth, where, seed, noise, lateral=chosen.lateral)
    for n in chosen.looks:
        result = check(reference, session.select_poses(list(range(1, n + 1))), chosen.sizes, last=n == MOST_VISITS)
        if result.decision != "undecided":
            break
    return result.decision, n


def _measured(truth: Truth, where: Poses, seed: int, noise: float, repeats: int = 1, lateral: float = 1.0) -> Session:
    """A session whose tracker stands some centimetres and milliradians from where it is stated."""
    cell, rng = _cell(lateral), np.random.default_rng([seed, 1])
    schedule = make_schedule(cell, where, 0.0, rng)
    rows = simulate(cell, truth.physics(), schedule)
    turn, shift = Rotation.from_rotvec(rng.normal(0.0, 4e-3, 3)).as_matrix(), rng.normal(0.0, 0.02, 3)
    sigma = noise * (cell.noise["tracker_m"] + cell.noise["tracker_m_per_m"] * rows.distance)
    passes = []
    for k in range(repeats):
        marker = rows.p_marker + rng.standard_normal(rows.p_marker.shape) * sigma[..., None]
        marker += rng.normal(0.0, noise * cell.noise.get("settling_m", 0.0), marker.shape)
        force = rows.force_reading + rng.normal(0.0, cell.noise["force_n"], rows.force_reading.shape)
        stamp = schedule.stamp + k * (schedule.stamp.max() + 10.0)
        numbers = np.arange(1, len(where.q) + 1)
        passes.append(Pass(numbers, schedule.case, stamp, rows.q, rows.p_controller, marker @ turn.T + shift, force))
    with tempfile.TemporaryDirectory() as folder:
        made = Generated(cell, Conduct(repeats=repeats), dict(cell.noise), [schedule] * repeats, [rows] * repeats, passes)
        return read_session(write_session(made, Path(folder) / "s", "s"))


if __name__ == "__main__":
    sys.exit(main())
