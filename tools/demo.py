# SPDX-License-Identifier: Apache-2.0
"""`make demo`: calibrate the simulated AFP cell through the nodes, then drive a loaded course without and with correction.

Everything is asked for as a person at a real cell would: actions and services of the nodes. Results go to out/demo.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from demo_parts.domain import free_domain
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_calibration.model.file import load_model
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import read_poses, write_poses
from irec_calibration.session import read_session

if TYPE_CHECKING:  # these import ROS, which must not happen before its domain is chosen
    from demo_parts.operator import Operator
    from demo_parts.processes import Processes
    from demo_parts.progress import Progress

ROOT = Path(__file__).resolve().parents[1]
N_POSES, D_MAX, POOL, SEED = 31, 0.175, 3000, 1  # of the plan: paper 4.2.3, d_max in m
PROCEDURE_TIMEOUT = 600.0  # s of the machine's clock
COURSE_TIMEOUT = 180.0
SPEED = 6.0  # simulated seconds per second, at most
COURSE_SPEED = 2.0  # simulated seconds per second: the correction has to keep up with 250 Hz of the cell's clock
MAX_LEAD = 0.019  # s of the cell's clock that it may be ahead of procedure and correction: less than their watchdogs allow
SIX, EIGHTEEN = ["joint_torsion"], ["joint_torsion", "link_bending"]


def main() -> int:
    """Run the demo; 0 if it went through, 2 if not."""
    parser = argparse.ArgumentParser(description="Calibrate the simulated AFP cell and drive a course with correction.")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "demo", help="folder for results (default: out/demo)")
    parser.add_argument("--cell", type=Path, default=ROOT / "config" / "cells" / "afp.yaml", help="cell file")
    parser.add_argument("--poses", type=int, default=N_POSES, help=f"number of engagement poses (default: {N_POSES})")
    parser.add_argument("--speed", type=float, default=SPEED, help=f"simulated seconds per second, at most (default: {SPEED:g})")
    return guarded(parser.parse_args(), _run)


def guarded(args: argparse.Namespace, run: Callable[[argparse.Namespace], None]) -> int:
    """Run a demo on a ROS domain of its own; one line for what went wrong and exit code 2, 130 where it was cancelled."""
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())  # before the first ROS import: nobody else's topics
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    from demo_parts.operator import RequestRefused
    from demo_parts.processes import NodeEnded

    for number in (signal.SIGINT, signal.SIGTERM):  # both end the nodes, also where SIGINT was ignored by who started this
        signal.signal(number, signal.default_int_handler)
    try:
        run(args)
    except (IrecError, RequestRefused, NodeEnded, ValueError) as error:
        print(f"\ndemo: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\ndemo: cancelled; all nodes are ended", file=sys.stderr)
        return 130
    return 0


def _run(args: argparse.Namespace) -> None:
    from demo_parts.operator import Operator
    from demo_parts.processes import Processes
    from demo_parts.progress import Progress

    out: Path = args.out
    if out.exists():
        shutil.rmtree(out)
    out.mkdir(parents=True)
    progress = Progress()
    progress.stage("plan", f"planning {args.poses} engagement poses on the mould")
    poses = plan_poses(args, out)
    progress.stage("start", "starting the simulated cell, procedure, calibration and recorder")
    with Processes(out / "log", {}) as processes:
        start_nodes(processes, args, out)
        operator = Operator(processes.check)
        try:
            made = calibrate(operator, progress, args, out, poses)
            progress.stage("course", "starting the correction, driving the loaded course without it")
            start_correction(processes, args)
            made["courses"] = drive(operator, progress, args, out, {"without": None, "with": made["models"]["18 DOF"][0]})
        finally:
            operator.close()
    report = _report(out, made, progress)
    progress.stage("figures", "drawing figures")
    _draw_and_print(args, out, made, progress, report)


def _report(out: Path, made: dict[str, Any], progress: Progress) -> Path:
    """The page of the session, as `irec report` writes it: verdict and evidence."""
    from irec_calibration.cli import main as irec

    progress.stage("report", "diagnosing the session, writing its report")
    words = ["report", str(made["session"]), "--model", str(made["models"]["18 DOF"][0])]
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = irec([*words, "-o", str(out / "report")])
    if code not in (0, 1):
        raise ValueError(f"no report: {said.getvalue().strip()}")
    progress.say(next(line for line in said.getvalue().splitlines() if "; wrote " in line))
    return out / "report" / "report.html"


def plan_poses(args: argparse.Namespace, out: Path) -> Path:
    """Poses of the cell if its file is there and fits, planned ones else."""
    cell = read_cell(args.cell)
    path = out / "poses.yaml"
    if cell.poses_path.is_file():
        try:
            if len(read_poses(cell.poses_path, cell.serial, cell.robot.sha256).poses) == args.poses:
                shutil.copy(cell.poses_path, path)
                return path
        except IrecError:
            pass  # made for another robot or description: plan again
    plan = make_plan(cell, args.poses, d_max=D_MAX, pool_size=POOL, seed=SEED)
    return write_poses(pose_list(cell, plan), path)


def start_nodes(processes: Processes, args: argparse.Namespace, out: Path, truth: str = "") -> None:
    """Start all nodes but the correction. `truth` is a file with hidden physics that only the simulated cell reads."""
    start = processes.start
    sim = {"use_sim_time": True}
    cell = str(args.cell)
    limits = {"speed_factor": args.speed, "max_lead": MAX_LEAD}
    hidden = {"truth": truth} if truth else {}
    start("cell", "irec_sim.nodes.cell_node", {"cell": cell, "course_csv": str(out / "course.csv"), **hidden, **limits})
    start("procedure", "irec_calibration.nodes.procedure_node", {"cell": cell, "session_folder": str(out), **sim})
    folder = str(out / "calibrations")
    start("calibration", "irec_calibration.nodes.calibration_node", {"cell": cell, "calibration_folder": folder})
    topics = "[joint_states, tcp_pose, wrench, tracker/point, robot/state, robot_description, irec/offset, irec/correction/state]"
    recorder = {"output": str(out / "bag"), "topics": topics, "autostart": False, **sim}
    start("recorder", "irec_calibration.nodes.recorder_node", recorder)


def start_correction(processes: Processes, args: argparse.Namespace) -> None:
    parameters = {"cell": str(args.cell), "autostart": True, "use_sim_time": True}
    processes.start("correction", "irec_correction.nodes.correction_node", parameters)


def calibrate(operator: Operator, tell: Progress, args: argparse.Namespace, out: Path, poses: Path) -> dict[str, Any]:
    """Procedure 1 and both models."""
    from irec_msgs.action import RunProcedure
    from irec_msgs.srv import SolveCompliances

    tell.stage("procedure", f"Procedure 1: {args.poses} poses, 5 load cases each")
    session = out / "session.mcap"
    goal = RunProcedure.Goal(poses_path=str(poses), session_path=str(session))

    def show(f: RunProcedure.Feedback) -> None:
        # `remaining` counts the cell's clock; the clock on the wall runs slower or faster
        spent = time.monotonic() - begun
        done = max(f.pose - 1, 0) / max(f.poses, 1)
        left = f"about {spent * (1 - done) / done:.0f} s left" if f.pose > 2 else "estimating the time left"
        tell.update(f"pose {f.pose} of {f.poses}, load case {f.load_case} of {f.load_cases}, {f.state}; {left}")

    begun = time.monotonic()
    result = operator.run_procedure(goal, PROCEDURE_TIMEOUT, show)
    if not result.success:
        raise ValueError(f"Procedure 1 did not come to its end: {result.message}")
    tell.say(result.message)
    tell.stage("solve", "solving 6 and 18 degrees of freedom")
    models = {}
    for name, effects in (("6 DOF", SIX), ("18 DOF", EIGHTEEN)):
        path = out / ("model.yaml" if effects is EIGHTEEN else "model_6dof.yaml")
        request = SolveCompliances.Request(session_path=str(session), effects=effects, model_path=str(path))
        answer = operator.call(SolveCompliances, "irec/solve", request, 60.0)
        if not answer.success:
            raise ValueError(f"solving {name}: {answer.message}")
        tell.say(f"{name}: {answer.message}")
        models[name] = (path, answer)
    return {"session": session, "models": models, "poses": result.poses_recorded, "path_poses": poses}


def drive(
    operator: Operator, tell: Progress, args: argparse.Namespace, out: Path, models: dict[str, Path | None]
) -> dict[str, Path]:
    """The loaded course once for each model, None for no correction; the tables that the cell writes, by the same names."""
    from demo_parts.operator import CELL_PARAMETERS, speed_request
    from rcl_interfaces.srv import SetParameters
    from std_srvs.srv import Trigger

    from irec_msgs.srv import ActivateModel

    def ask(kind: Any, name: str, request: Any, timeout: float, tell_waiting: Any = None) -> None:
        answer = operator.call(kind, name, request, timeout, tell_waiting)
        if not answer.success:
            raise ValueError(f"{name}: {answer.message}")

    operator.call(SetParameters, CELL_PARAMETERS, speed_request(COURSE_SPEED), 10.0)
    ask(Trigger, "recorder/start", Trigger.Request(), 10.0)
    courses, home = {}, read_cell(args.cell).home.tolist()
    took = ""  # how long the first course took on this machine, for the others
    for name, model in models.items():
        if model is not None:
            ask(ActivateModel, "irec/correction/activate_model", ActivateModel.Request(model_path=str(model)), 20.0)
            tell.say(f"{model.name} is in force; driving the course again with correction")

        def show(seconds: float, name: str = name, took: str = took) -> None:
            tell.update(f"course '{name}', {seconds:.0f} s{took}")

        operator.move_joints(home, 0.5, 60.0)  # away from the mould, before going to where the course begins
        began = time.monotonic()
        ask(Trigger, "sim/run_course", Trigger.Request(), COURSE_TIMEOUT, show)
        took = f" of about {time.monotonic() - began:.0f} s"
        courses[name] = out / f"course_{name}.csv"
        (out / "course.csv").rename(courses[name])
    ask(Trigger, "recorder/stop", Trigger.Request(), 30.0)
    return courses


def _draw_and_print(args: argparse.Namespace, out: Path, made: dict[str, Any], progress: Progress, report: Path) -> None:
    from demo_parts.course import figures_mm, read_course, reduction_percent
    from demo_parts.figures import course_figure, residuals_figure
    from demo_parts.table import table

    cell = read_cell(args.cell)
    without, corrected = (read_course(made["courses"][name]) for name in ("without", "with"))
    session = read_session(made["session"])
    models = {name: load_model(path) for name, (path, _) in made["models"].items()}
    residuals = residuals_figure(session, models, out / "residuals.png")
    drawn = course_figure(without, corrected, cell.tolerance, out / "course.png")
    deviation = {"without": figures_mm(without.lateral), "with": figures_mm(corrected.lateral)}
    reduction = reduction_percent(deviation["without"], deviation["with"])
    total = {"without": figures_mm(without.total), "with": figures_mm(corrected.total)}
    wall = progress.finish()
    model_path, answer = made["models"]["18 DOF"]
    summary = {
        "format": "irec-summary/1",
        "cell": cell.name,
        "deviation_mm": deviation,
        "reduction_percent": reduction,
        "total_deviation_mm": total,
        "total_reduction_percent": reduction_percent(total["without"], total["with"]),
        "calibration": {
            "poses": int(made["poses"]),
            "load_cases": len(cell.forces_in_tool),
            "residual_rms_m": float(answer.residual_rms),
            "noise_floor_m": float(answer.noise_floor),
            "cross_validated_rms_m": float(answer.cross_validated_rms),
        },
        "wall_s": wall,
        "files": {
            "session": str(made["session"]),
            "model": str(model_path),
            "model_6dof": str(made["models"]["6 DOF"][0]),
            "poses": str(made["path_poses"]),
            "bag": str(out / "bag"),
            "course_without": str(made["courses"]["without"]),
            "course_with": str(made["courses"]["with"]),
            "residuals_figure": str(residuals),
            "course_figure": str(drawn),
            "report": str(report),
        },
    }
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    print(table(deviation["without"], deviation["with"], reduction))
    print(f"  wall time: {', '.join(f'{name} {seconds:.0f} s' for name, seconds in wall.items())}")
    print(f"  results in {out}: report/report.html, summary.json, model.yaml, session.mcap, bag/, residuals.png, course.png")


if __name__ == "__main__":
    sys.exit(main())
