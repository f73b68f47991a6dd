# SPDX-License-Identifier: Apache-2.0
"""Hours of the procedure with real processes: `python tools/endurance/procedure.py [--hours 24] [--seconds S]`.

Run after run through the nodes against the simulated cell, faster than real time, each with a recording of its own. So that
hours of the cell take minutes, the cell goes in steps of 20 ms, its topics come at 50 Hz and less, and it may be half a second
ahead of the procedure (a force set point holds for 2 s there). Messages are of the same kinds as those of any cell, over the
same middleware, by a simulated clock. Memory, handles and threads of procedure and driver are read every few seconds. Ends
after so many hours of the cell or seconds of this machine, whichever comes first, and prints what grew, with confidence
intervals, over the hours that were really run. A run that stopped early (a machine too busy for the time limits of the cell) is
told and followed by the next. Exit 1 where something certainly grows, or where more runs stopped than came to their end.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parent / "faults")]

from demo_parts.domain import free_domain  # noqa: E402
from slopes import Sample, grows, sample, slopes  # noqa: E402
from stack import START, Stack  # noqa: E402

from irec_msgs.action import RunProcedure  # noqa: E402

LIMITS = {"memory_kB": 256.0, "handles": 0.05, "threads": 0.05}  # per hour of the cell
EVERY = 5.0  # s of the cell's clock between two samples
STOPS = 30  # more than came to their end: something else is wrong
RUN = 3600.0  # s of the machine's clock for one run
STEP = 0.02  # s of the cell
LEAD, LEASE = 0.5, 2.0  # s of the cell, of the messages under way, and of a force set point
RATES = {"clock": 50.0, "wrench": 50.0, "tracker": 50.0, "joint_states": 25.0, "tcp_pose": 25.0, "wrench_raw": 0.0}  # Hz
SAMPLES = ("min_samples: 20", "min_samples: 10")  # of the tracker in a window: there are 20 in each
POSES = HERE.parents[1] / "config" / "cells" / "afp_poses.yaml"


class Slow(Stack):
    """The processes, with a cell of fewer steps and messages."""

    def start_driver(self) -> None:
        text = self.cell.read_text()
        if SAMPLES[1] not in text:
            if SAMPLES[0] not in text:
                raise ValueError(f"{self.cell} has no {SAMPLES[0]!r} to be changed")
            self.cell.write_text(text.replace(*SAMPLES))
        self.robot, self.report = None, {"id": 0}
        rates = {f"rate.{name}": rate for name, rate in RATES.items()}
        self.start("driver", "faulty_cell",
                   {"cell": self.cell, "speed_factor": self.speed, "rail_speed": 5.0, "period": STEP, "max_lead": LEAD,
                    "force_lease": LEASE, **rates})  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0, help="of the cell's clock")
    parser.add_argument("--seconds", type=float, default=0.0, help="of this machine; 0: no limit")
    parser.add_argument("--speed", type=float, default=60.0, help="simulated s per s, as far as the machine can")
    parser.add_argument("--out", type=Path, default=Path("out/endurance"))
    args = parser.parse_args()
    stack = Slow(args.out.absolute(), free_domain(), args.speed)
    try:
        samples, runs, poses, stops = _run(stack, args.hours, args.seconds)
    finally:
        stack.close()
    hours = samples["procedure"][-1].hours if samples["procedure"] else 0.0
    print(f"{hours:.3f} h of the cell, {runs} runs, {poses} poses, {len(stops)} runs stopped early")
    bad: list[str] = [f"{len(stops)} runs stopped early, {runs} came to their end"] if len(stops) > runs else []
    for stop in stops:
        print(f"  stopped: {stop}")
    for name, taken in samples.items():
        found = slopes(taken)
        print(f"{name}: {taken[0].memory_kB / 1024:.1f} MB at first, {taken[-1].memory_kB / 1024:.1f} MB at last")
        for what, slope in found.items():
            print(f"  {what:<10} {slope}")
        bad += [f"{name}: {text}" for text in grows(found, LIMITS)]
    print("; ".join(bad) or "nothing certainly grows")
    return 1 if bad else 0


def _run(stack: Slow, hours: float, seconds: float) -> tuple[dict[str, list[Sample]], int, int, list[str]]:
    stack.ensure("driver", "procedure")
    stack.until(lambda: stack.action.server_is_ready() and stack.robot is not None and stack.report.get("time"), "nodes", START)
    began, end = float(stack.report["time"]), time.monotonic() + seconds if seconds else float("inf")
    samples: dict[str, list[Sample]] = {"procedure": [], "driver": []}
    runs = poses = 0
    stops: list[str] = []
    last = began
    session = stack.folder / "endurance.mcap"
    while time.monotonic() < end and (last - began) < 3600.0 * hours:
        session.unlink(missing_ok=True)
        goal = RunProcedure.Goal(poses_path=str(POSES), session_path=str(session))
        stack.mark()
        sent = stack.action.send_goal_async(goal)
        stack.until(sent.done, "the goal is answered", START)
        done = sent.result().get_result_async()
        until = time.monotonic() + RUN
        while not done.done() and time.monotonic() < min(until, end):
            stack.spin()
            stack.texts.clear()
            now = float(stack.report["time"])
            if now - last >= EVERY:
                last = now
                for name, taken in samples.items():
                    taken.append(sample((now - began) / 3600.0, stack.processes[name].pid))
        poses += sum(e["kind"] == "complete" for e in stack.events)
        if not done.done():
            sent.result().cancel_goal_async()
            stack.until(done.done, "the cancelled run's end", 120.0)
            break
        if done.result().result.success:
            runs += 1
        else:
            stops.append(done.result().result.message)
            print(f"stopped early: {stops[-1]}", file=sys.stderr, flush=True)
            if len(stops) > runs + STOPS:
                break
        left = 3600.0 * hours - (last - began)
        print(f"run {runs}: {done.result().result.message} ({left / 3600:.2f} h of the cell left)", file=sys.stderr, flush=True)
    return samples, runs, poses, stops


if __name__ == "__main__":
    sys.exit(main())
