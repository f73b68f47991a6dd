# SPDX-License-Identifier: Apache-2.0
"""`make demo-year`: three years of one simulated robot through the nodes, faster than real time.

Commissioning; a year in which nothing has happened; a year in which a gear has aged; a year in which the base has come loose; and
back to the calibration before. Every year the tracker stands somewhere else. What is hidden is written where only the simulated
cell reads it; certificates, history and trend are made from what irec found. Results go to out/demo-year.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from demo import ROOT, guarded
from irec_calibration.cell import read_cell
from irec_calibration.poses.plan import make_plan, pose_list, turn_for
from irec_calibration.poses.store import write_poses
from irec_calibration.recertification.preconditions import FAILS, HOLDS, told_lines
from irec_calibration.recertification.run_state import interrupted
from irec_calibration.recertification.store import Store
from irec_calibration.recertification.trend import trend
from irec_calibration.report.certificate import trend_png
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from demo_parts.operator import Operator
    from demo_parts.progress import Progress

RUN_TIMEOUT = 3600.0  # s of the machine's clock for one recertification; a process that ends is told at once
IDLE_SPEED = 0.5  # simulated seconds per second while a session is judged, which needs the processors
SPEED = 8.0
DONE = "years.json"
MAX_LEAD = 0.1  # s of the cell's clock that it may be ahead of who listens; the correction does not move anything here
RATES = {"clock": 50.0, "joint_states": 50.0, "tcp_pose": 50.0, "wrench": 125.0, "wrench_raw": 0.0, "tracker": 62.5}  # Hz
REFERENCE_DISTANCE = 0.008  # m
WAYS = {"home_speed": 1.0, "linear_speed": 0.5}  # between the poses: nobody stands beside a simulated robot
TICKS = 50.0  # Hz, of a correction that has nothing to correct
FIRST_POSES, N_POSES = 36, 18  # of the first calibration, with which a quick check can tell more; of the others
POOL, SEED = 1500, 1  # of the plans
AXIAL = [2.2e-7, 2.0e-7, 2.5e-7, 1.2e-6, 1.3e-6, 2.1e-6]  # rad/(N m), of the simulated robot when it was new
LOOSE = {"per_translation": [1.6e-9, 1.6e-9, 2.2e-9], "per_rotation": [4.0e-8, 4.0e-8, 4.0e-8]}


@dataclass(frozen=True)
class Year:
    """What happens in a year. softer: axis, factor; loose: the base; expected: how the verdict has to begin."""

    name: str
    hidden: str
    expected: str
    softer: tuple[int, float] | None = None
    loose: bool = False


YEARS = (
    Year("commissioning", "a new robot", "recalibrated"),
    Year("year 1", "nothing", "pass"),
    Year("year 2", "the gear of axis 2 is 15 % softer", "recalibrated", softer=(2, 1.15)),
    Year("year 3", "the base has come loose", "investigate: base_compliance", softer=(2, 1.15), loose=True),
)


def main() -> int:
    """Run the demo; 0 if everything that was hidden was found, 1 if not, 2 if it could not be carried out."""
    parser = argparse.ArgumentParser(description="Three years of one simulated robot: certificates, history, roll back.")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "demo-year", help="folder of results (default: out/demo-year)")
    parser.add_argument("--cell", type=Path, default=ROOT / "config" / "cells" / "afp.yaml", help="cell file")
    parser.add_argument("--go-on", action="store_true", help="keep what is done, also of an interrupted run, and go on after it")
    parser.add_argument("--years", type=int, default=len(YEARS), help="end after so many (default: all)")
    parser.add_argument("--speed", type=float, default=SPEED, help=f"simulated seconds per second, at most (default: {SPEED:g})")
    found: list[bool] = []
    code = guarded(parser.parse_args(), lambda args: found.append(_run(args)))
    return code or (0 if all(found) else 1)


def _run(args: argparse.Namespace) -> bool:
    from demo_parts.operator import Operator
    from demo_parts.processes import Processes
    from demo_parts.progress import Progress

    out: Path = args.out
    progress = Progress()
    nominal, args.cell = args.cell, out / "cell.yaml"
    rows: list[dict[str, Any]] = json.loads((out / DONE).read_text()) if args.go_on and (out / DONE).exists() else []
    if not rows:
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        content = _absolute(nominal)
        content["procedure"].update(WAYS)
        content["reference_distance"] = REFERENCE_DISTANCE  # a robot with a loose base sags by more than that of the cell file
        args.cell.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        progress.stage("plan", f"planning {FIRST_POSES} and {N_POSES} engagement poses")
        cell = read_cell(args.cell)
        for path, n in ((_poses(out, YEARS[0]), FIRST_POSES), (_poses(out, YEARS[1]), N_POSES)):
            write_poses(pose_list(cell, make_plan(cell, n, pool_size=POOL, seed=SEED, turn=turn_for(n))), path)
    with Processes(out / "log", {}) as office, contextlib.ExitStack() as at_end:
        folder = str(out / "calibrations")
        office.start(
            "calibration", "irec_calibration.nodes.calibration_node", {"cell": str(args.cell), "calibration_folder": folder}
        )
        # it takes models into force; there is nothing to correct, and readings of a cell that is faster than real time cost time
        settings: dict[str, object] = {"cell": str(args.cell), "use_sim_time": True, "rate": TICKS}
        office.start("correction", "irec_correction.nodes.correction_node", settings, {"wrench": "wrench_of_no_process"})
        operator = None
        resume = bool(rows) and bool(interrupted(Store(out / "calibrations", read_cell(args.cell).serial)))
        for number, year in list(enumerate(YEARS))[len(rows) : args.years]:
            progress.stage(year.name, f"{year.name}: switching the simulated cell on; the tracker stands somewhere else")
            with Processes(out / "log" / year.name.replace(" ", "_"), {}) as shopfloor:
                _switch_on(shopfloor, args, out, number, year)
                if operator is None:
                    operator = Operator(office.check)
                    at_end.callback(operator.close)
                    _configure(operator)
                rows.append(_recertify(operator, progress, out, year, resume))
                resume = False
                if not rows[-1]["answered"]:  # what comes after it would rest on it; --go-on takes it up
                    break
                (out / DONE).write_text(json.dumps(rows, indent=1), encoding="utf-8")
                if number == len(YEARS) - 1:
                    rows.append(_roll_back(operator, progress))
    return _print_result(args, out, rows, progress)


def _switch_on(processes: Any, args: argparse.Namespace, out: Path, number: int, year: Year) -> None:
    """Cell and procedure of one year; what is hidden and where the tracker truly stands goes to the simulated cell only."""
    hidden = out / "hidden"
    hidden.mkdir(exist_ok=True)
    axial = [c * (year.softer[1] if year.softer and year.softer[0] == k + 1 else 1.0) for k, c in enumerate(AXIAL)]
    effects = [{"effect": "base_compliance", "scale": 1.0, "parameters": LOOSE}] if year.loose else []
    truth = {"format": "irec-truth/1", "compliance": {"axial": axial}, "background_friction": 0.012, "effects": effects}
    (hidden / f"truth_{number}.yaml").write_text(yaml.safe_dump(truth), encoding="utf-8")
    moved = _tracker_elsewhere(args.cell, hidden / f"cell_{number}.yaml", number)
    cell, sim = str(args.cell), {"use_sim_time": True}
    start = processes.start
    start(
        "cell", "irec_sim.nodes.cell_node",
        {"cell": str(moved), "truth": str(hidden / f"truth_{number}.yaml"), "seed": 10 + number, "speed_factor": args.speed,
         "max_lead": MAX_LEAD, "course_csv": str(out / "course.csv"), **{f"rate.{n}": r for n, r in RATES.items()}},
    )  # fmt: skip
    start("procedure", "irec_calibration.nodes.procedure_node", {"cell": cell, "session_folder": str(out / "sessions"), **sim})


def _poses(out: Path, year: Year) -> Path:
    return out / ("poses_first.yaml" if year is YEARS[0] else "poses.yaml")


def _absolute(cell: Path) -> dict[str, Any]:
    """Content of a cell file with absolute paths."""
    content: dict[str, Any] = yaml.safe_load(cell.read_text(encoding="utf-8"))
    content["robot"]["urdf"] = str((cell.parent / content["robot"]["urdf"]).resolve())
    if isinstance(content.get("surface"), dict) and "file" in content["surface"]:
        content["surface"]["file"] = str((cell.parent / content["surface"]["file"]).resolve())
    return content


def _tracker_elsewhere(cell: Path, path: Path, number: int) -> Path:
    """A cell file for the simulator in which each station stands some centimetres and mrad from where it is stated."""
    content = _absolute(cell)
    rng = np.random.default_rng(number)
    for station in content["stations"]:
        turn = Rotation.from_rotvec(rng.normal(0.0, 2e-3, 3)) if number else Rotation.identity()
        station["xyz"] = (np.array(station["xyz"]) + (rng.normal(0.0, 0.01, 3) if number else 0.0)).tolist()
        station["quat_xyzw"] = (turn * Rotation.from_quat(station["quat_xyzw"])).as_quat().tolist()
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def _configure(operator: Operator) -> None:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    configure = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    operator.call(ChangeState, "correction_node/change_state", configure, 60.0)


def _recertify(operator: Operator, progress: Progress, out: Path, year: Year, resume: bool) -> dict[str, Any]:
    from demo_parts.operator import RequestRefused

    from irec_msgs.action import Move, Recertify, RunProcedure

    operator.wait_for_action(RunProcedure, "irec/run_procedure")
    operator.wait_for_action(Move, "robot/move")
    stage = ""

    def show(f: Any) -> None:
        nonlocal stage
        if f.stage != stage:
            stage = f.stage
            progress.say(f"{year.name}: {stage.replace('_', ' ')}")
            if stage == "judgement":
                operator.set_speed(IDLE_SPEED)
        if told := told_lines(f.message):
            wrong = [line for line in told if line.startswith(FAILS)]
            names = ", ".join(line.removeprefix(HOLDS).partition(":")[0] for line in told if line not in wrong)
            progress.say(f"{year.name}: as they have to be: {names}")
            for line in wrong:
                progress.say(f"{year.name}: {line}")
        else:
            progress.update(f"{year.name}: {f.message}")

    goal = Recertify.Goal(operator_name="M. Muster", confirmed=["area", "disc", "tool"], poses_path=str(_poses(out, year)))
    goal.resume = resume
    row: dict[str, Any] = {"what": year.name, "hidden": year.hidden, "expected": year.expected}
    try:
        result = operator.run_action(Recertify, "irec/recertify", goal, RUN_TIMEOUT, show)
    except RequestRefused as error:
        return {**row, "found": f"no verdict: {error}", "text": str(error), "right": False, "in_force": "", "answered": False}
    progress.say(f"{year.name}: {result.verdict}. {result.text}")
    if result.certificate_path:
        name = year.name.replace(" ", "_")
        for suffix in (".html", ".pdf"):
            shutil.copy(Path(result.certificate_path).with_suffix(suffix), out / f"certificate_{name}{suffix}")
    right, in_force = result.verdict.startswith(year.expected), Path(result.model_path).parent.name
    return {**row, "found": result.verdict, "text": result.text, "right": right, "in_force": in_force, "answered": True}


def _roll_back(operator: Operator, progress: Progress) -> dict[str, Any]:
    from irec_msgs.srv import PutInForce

    answer = operator.call(PutInForce, "irec/put_in_force", PutInForce.Request(operator_name="M. Muster"), 30.0)
    progress.say(f"roll back: {answer.message}")
    return {"what": "roll back", "hidden": "-", "expected": "calibration 0001", "found": answer.message, "text": answer.message,
            "right": answer.success and answer.calibration == "0001", "in_force": answer.calibration}  # fmt: skip


def _print_result(args: argparse.Namespace, out: Path, rows: list[dict[str, Any]], progress: Progress) -> bool:
    cell = read_cell(args.cell)
    points = trend(Store(out / "calibrations", cell.serial))
    (out / "trend.png").write_bytes(trend_png(points))
    wall = progress.finish()
    summary = {"format": "irec-summary/1", "cell": cell.name, "years": rows, "wall_s": wall}
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    print(f"\n  {'':14} {'hidden':36} {'found':46} in force")
    for r in rows:
        wrong = "" if r["right"] else "  NOT as it should be"
        print(f"  {r['what']:14} {r['hidden']:36} {r['found'][:44]:46} {r['in_force']:8}{wrong}")
    print(f"\n  wall time {wall['total']:.0f} s; in {out}: certificate_*.html and .pdf, trend.png, summary.json")
    print(f"  history: .venv/bin/irec history {args.cell}")
    return all(r["right"] for r in rows)


if __name__ == "__main__":
    sys.exit(main())
