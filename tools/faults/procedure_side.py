# SPDX-License-Identifier: Apache-2.0
"""One fault at one phase of Procedure 1, with real processes: make it, judge what follows, recover."""

from __future__ import annotations

import json
import re
import resource
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from catalogue import DRIVER, FAULTS, PHASES, Fault
from irec_calibration.cell import read_cell
from irec_calibration.errors import IrecError
from irec_calibration.recertification.store import Store
from irec_calibration.recording import BagReader
from irec_ros.results import GoalResult, is_unknown
from stack import CELL, START, NotReached, Stack
from table import Row

from irec_msgs.action import RunProcedure
from irec_msgs.msg import RobotState

SAFE_WITHIN = 3.0  # s
LOOK = 3.3  # s that a fault is looked at, unless the run has ended before
FORCE_LIMIT = 1600.0  # N, procedure.force_abort_n of the cell file
REACH = 90.0  # s of the machine's clock to come to the phase
END = 60.0  # s of the machine's clock for the run to end
FOUND = 2.5  # s of the machine's clock
CHUNK = 20_000  # bytes of a recording: more than what it begins with
PAUSE = 3.2  # s that a stopped process stands
RUNS_PER_FILE = 5
OF_ACTION = ("send_goal", "cancel_goal", "get_result", "feedback", "status")


class ProcedureSide:
    """All combinations of one stack, one after the other."""

    def __init__(self, stack: Stack) -> None:
        self.stack, self.number = stack, 0
        self.session: Path | None = None
        self.runs = 0
        self._goal: Any = None
        self._answer: GoalResult | None = None
        self._store = Store(stack.folder / "calibrations", read_cell(CELL).serial)
        self._kept = stack.folder / "poses.yaml"
        poses = yaml.safe_load((CELL.parent / "afp_poses.yaml").read_text())
        poses["poses"] = sorted(poses["poses"], key=lambda p: abs(p["ext"]["rail"]))[:8]  # short ways
        self._kept.write_text(yaml.safe_dump(poses))

    # --- one combination ---------------------------------------------------------------------------------------------

    def run(self, fault: Fault, phase: str) -> Row:
        row = Row("procedure", fault.name, phase)
        try:
            self._ready(fault)
            self._begin_run(fresh=phase == "between poses")
            self._inject(fault, phase)
            row.number = self.number
            self._observe(fault)
            self._judge_robot(fault, row)
            self._recover(fault, row)
            self._judge_rest(fault, row)
        except NotReached as error:
            row.fail(str(error))
            self._start_again()
        return row

    def _ready(self, fault: Fault) -> None:
        s = self.stack
        for name in ("calibration", "recorder"):  # there only where they are to fail: others have little to do with them
            if name in fault.name:
                s.ensure(name)
            elif name in s.processes:
                s.processes.pop(name).end()
        for name, topic in (("driver", "robot/state"), ("procedure", "robot/force_setpoint")):
            if name in s.processes and s.processes[name].child.poll() is not None:
                s.until(lambda t=topic: s.node.count_publishers(t) == 0, f"DDS has forgotten the {name} that was killed", 40.0)
        new = s.ensure("driver", "procedure")
        s.arm(clear=True, speed=s.speed)
        s.robot = None
        s.until(lambda: s.action.server_is_ready() and s.robot is not None and s.robot.mode == RobotState.MODE_POSITION
                and not s.robot.retreating and s.report["id"] == 0, "the nodes are ready", START)  # fmt: skip
        if new:  # all of its topics, the clock among them, have to be found
            settled = time.monotonic() + FOUND
            s.until(lambda: time.monotonic() > settled, "the graph", 2.0 * FOUND)
        s.until(lambda: s.node.count_publishers("robot/force_setpoint") == 1, "one procedure is on the graph", 40.0)
        if "recorder" in fault.name:  # it has to have written a chunk before it can lose all but the open one
            s.until(lambda: sum(f.stat().st_size for f in s.recording.glob("*.mcap")) > CHUNK, "a chunk is recorded", START)

    def _begin_run(self, fresh: bool) -> None:
        """Go on with the recording of the run before, or begin a new one."""
        s = self.stack
        self.runs += 1
        resume = not fresh and self.session is not None and self.session.is_file() and self.runs % RUNS_PER_FILE != 0
        if not resume:
            if self.session is not None:
                self.session.unlink(missing_ok=True)
            self.session = s.folder / f"run_{self.number + 1}.mcap"
            self.session.unlink(missing_ok=True)
        s.mark()
        self._answer = None
        goal = RunProcedure.Goal(poses_path=str(self._kept), session_path=str(self.session), resume=resume)
        sent = s.action.send_goal_async(goal)
        s.until(sent.done, "the goal is answered", 30.0)
        self._goal = sent.result()
        if not self._goal.accepted:
            raise NotReached("the run was refused")
        self._answer = GoalResult(self._goal)

    @property
    def _result(self) -> Any:
        """Of the run under way; None until it has ended."""
        answer = None if self._answer is None else self._answer.poll()
        return None if answer is None or is_unknown(answer) else answer.result

    def _inject(self, fault: Fault, phase: str) -> None:
        s = self.stack
        self.number += 1
        first = 2 if phase == "between poses" else 1
        s.arm(id=self.number, fault=fault.name if fault.where == DRIVER else "outside", states=PHASES[phase], from_pose=first)
        s.until(lambda: s.report["id"] == self.number or self._result is not None, f"phase {phase}", REACH)
        if s.report["id"] != self.number:
            raise NotReached(f"the run ended before phase {phase}: {self._result.message}")
        self._texts_before, self._rows_before = len(s.texts), len(s.rows)
        self._at = time.monotonic()
        if fault.where != DRIVER:
            self._do_outside(fault.name)

    def _do_outside(self, name: str) -> None:
        s = self.stack
        kind, _, who = name.partition(" ")
        if name == "disk full":
            size = self.session.stat().st_size if self.session is not None else 0
            resource.prlimit(s.processes["procedure"].pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        elif name == "two procedures":
            action = "run_procedure/_action"  # an action is remapped piece by piece
            pieces = (f"irec/{action}/{p}:=second/{action}/{p}" for p in OF_ACTION)
            s.start("second", "irec_calibration.nodes.procedure_node",
                    {"cell": s.cell, "session_folder": s.folder, "use_sim_time": True}, "__node:=second", *pieces)  # fmt: skip
        elif name == "recorder dead":
            s.processes["recorder"].send(signal.SIGKILL)
        else:
            s.processes[who].send(signal.SIGKILL if kind == "SIGKILL" else signal.SIGSTOP)

    def _observe(self, fault: Fault) -> None:
        """Until the run has ended with the robot standing free, or the time to look is over."""
        s = self.stack
        gone = fault.name in ("SIGKILL driver", "SIGSTOP driver", "SIGKILL procedure")

        def over() -> bool:
            waited = time.monotonic() - self._at
            if gone:
                return waited > PAUSE + 0.5
            free = s.report["mode"] != 1 and s.report["force"] < 30.0 and not s.report["moving"]
            return (self._result is not None and (free or s.report["mode"] == 2)) or s.report["t"] > LOOK or waited > 4 * LOOK

        if fault.name == "two procedures":
            self._ask_second()
        s.until(over, "the fault is over", 60.0)
        if fault.name.startswith("SIGSTOP"):
            s.until(lambda: time.monotonic() - self._at > PAUSE, "the pause", 10.0)
        self.seen = dict(s.report)
        self.seen["state"] = "" if s.status is None else s.status.state
        self.seen["wall"] = time.monotonic() - self._at

    def _ask_second(self) -> None:
        """The second procedure is asked for a run of its own; it may not drive."""
        from rclpy.action import ActionClient

        s = self.stack
        client = ActionClient(s.node, RunProcedure, "second/run_procedure")
        s.until(client.server_is_ready, "the second procedure", START)
        goal = RunProcedure.Goal(poses_path=str(self._kept), session_path=str(s.folder / "second.mcap"))
        (s.folder / "second.mcap").unlink(missing_ok=True)
        client.send_goal_async(goal)
        seen = len(s.texts)
        s.until(lambda: any("another procedure" in t for t in s.texts[seen:]), "the second procedure says why it waits", 20.0)
        s.processes.pop("second").end()
        client.destroy()

    # --- what is judged ----------------------------------------------------------------------------------------------

    def _judge_robot(self, fault: Fault, row: Row) -> None:
        seen = self.seen
        if fault.name == "SIGKILL driver":
            row.robot = "driver gone"
            return
        row.max_force = seen["max_force"]
        if row.max_force > FORCE_LIMIT:
            row.fail(f"force reached {row.max_force:.0f} N")
        if fault.name == "SIGSTOP driver":  # its plant stands as well
            row.robot = "stands with its driver"
            return
        pressing, moving = seen["last_pressing"], seen["last_moving"]
        still_pressing = seen["mode"] == 1 or (seen["force"] > 30.0 and seen["mode"] != 2)
        under_way = seen["state"] in ("position_mode", "lift", "retract", "withdraw")
        if seen["mode"] == 2:
            row.robot = "drives off"
        elif still_pressing and seen["t"] >= SAFE_WITHIN:
            controlled = seen["last_loose"] < seen["t"] - 1.0
            row.robot = "presses, controlled" if controlled else "presses"
            legal = fault.holds or (fault.harmless and self._not_yet(fault))
            if not (legal and controlled) and not (legal and fault.persists):
                row.fail(f"presses {seen['t']:.1f} s after the fault began")
        elif pressing > SAFE_WITHIN and not fault.harmless and not fault.holds:
            row.fail(f"left the contact after {pressing:.1f} s")
            row.robot = f"free after {pressing:.1f} s"
        elif seen["moving"] and moving > SAFE_WITHIN and not (under_way or fault.harmless or fault.holds):
            row.robot = "moves"
            row.fail(f"still moves {seen['t']:.1f} s after the fault began, in state {seen['state']}")
        elif fault.harmless and self._result is None:
            row.robot = "goes on"
        else:
            row.robot = f"stands after {max(pressing, moving):.1f} s"

    def _not_yet(self, fault: Fault) -> bool:
        """Faults that can only act at a later step of the run."""
        return fault.persists

    def _recover(self, fault: Fault, row: Row) -> None:
        """End what is left of the run, in the way that the fault leaves open."""
        s = self.stack
        name = fault.name
        if name.startswith("SIGSTOP"):
            s.processes[name.split()[1]].send(signal.SIGCONT)
        procedure_dead = name == "SIGKILL procedure"
        if procedure_dead:
            row.run = "process killed"
        elif fault.persists and self._result is None:
            s.arm(id=self.number, fault=name if fault.where == DRIVER else "outside", states=(), speed=4.0)
            if name == "mode refused":
                self._goal.cancel_goal_async()
            try:
                s.until(lambda: self._result is not None, "the run's verdict", END)
            except NotReached:
                if not fault.harmless:
                    raise
        if not procedure_dead and self._result is None:
            s.arm(clear=True, speed=s.speed)
            self._go_on(row)
        if self._result is not None:
            row.run = "went on; " * row.went_on + str(self._result.message)
        if name == "disk full":
            resource.prlimit(s.processes["procedure"].pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
        last = s.report
        row.max_force = max(row.max_force, float(last.get("max_force", 0.0))) if last.get("id") == self.number else row.max_force
        if row.max_force > FORCE_LIMIT and not row.failures:
            row.fail(f"force reached {row.max_force:.0f} N")
        s.arm(clear=True, speed=s.speed)

    def _go_on(self, row: Row) -> None:
        """After the fault has gone: the run makes a step, or has ended; then it is cancelled."""
        s = self.stack
        seen, rows = len(s.states), len(s.rows)
        s.until(lambda: self._result is not None or len(s.rows) > rows or len(set(s.states[seen:])) > 1, "the run goes on", END)
        if self._result is None:
            row.went_on = True
            self._goal.cancel_goal_async()
            s.until(lambda: self._result is not None, "the cancelled run's verdict", END)

    def _judge_rest(self, fault: Fault, row: Row) -> None:
        s = self.stack
        said = [*s.texts[self._texts_before :], row.run]
        if not fault.cause:
            row.cause = "not of the run's concern"
        else:
            found = next((m for m in (re.search(rf".*(?:{fault.cause}).*", t) for t in said) if m), None)
            row.cause = "" if found is None else found[0].strip()
            if found is None and not row.went_on and not fault.silent:
                row.fail("nothing names the cause")
            elif found is None:
                row.cause = "its diagnostics fall silent" if fault.silent else "went on: nothing to tell"
        self._judge_recording(fault, row)
        if self._store.in_force() is not None:
            row.fail("a calibration has come into force")
        if fault.name == "recorder dead":
            self._readable(s.recording, row)

    def _judge_recording(self, fault: Fault, row: Row) -> None:
        """All rows that were published are in the file, and none of them is wrong."""
        s = self.stack
        try:
            bag = BagReader(self.session)  # type: ignore[arg-type]
            messages = [m for m in bag.messages() if m.topic.name in ("/irec/procedure/load_case", "/irec/procedure/event")]
            kept = [bag.decode(m) for m in messages if m.topic.name.endswith("load_case")]
            for m in messages:
                if m.topic.name.endswith("event"):
                    json.loads(bag.decode(m).data)
        except (IrecError, OSError, ValueError) as error:
            row.fail(f"the recording can't be read: {error}")
            row.data = "unreadable"
            return
        mine = {(r.pose, r.load_case, r.repeat, r.header.stamp.sec, r.header.stamp.nanosec) for r in s.rows}
        held = {(r.pose, r.load_case, r.repeat, r.header.stamp.sec, r.header.stamp.nanosec) for r in kept}
        lost = len(mine - held)
        wrong = [r for r in kept if not _sound(r)]
        row.data = f"{len(kept)} rows" + (f", {lost} of the open chunk lost" if lost else "")
        may_lose = fault.name in ("SIGKILL procedure", "disk full")
        if lost and not may_lose:
            row.fail(f"{lost} published rows are not in the recording")
        if wrong:
            row.fail(f"{len(wrong)} recorded rows can't be true, e.g. pose {wrong[0].pose}, load case {wrong[0].load_case}")

    def _readable(self, path: Path, row: Row) -> None:
        try:
            count = sum(sum(1 for _ in BagReader(f).messages()) for f in path.glob("*.mcap"))
            row.data += f"; recorder's file: {count} messages"
            if not count:
                row.fail("the recorder's file holds nothing")
        except (IrecError, OSError) as error:
            row.fail(f"the recorder's file can't be read: {error}")

    def _start_again(self) -> None:
        """After something that did not come: everything anew."""
        for process in self.stack.processes.values():
            process.end()
        self.stack.processes.clear()
        self.session = None


def _sound(row: Any) -> bool:
    """Whether a recorded row of the simulated cell can be true: finite, force as asked for, rail at its place."""
    f = row.wrench_in_tool.force
    force = np.array([f.x, f.y, f.z])
    p = row.p_marker_in_station
    numbers = [*force, p.x, p.y, p.z, *row.joint_position]
    if not np.all(np.isfinite(numbers)):
        return False
    cases = np.vstack([np.zeros(3), CASES])
    return float(np.abs(force - cases[row.load_case]).max()) < 60.0


CASES = read_cell(CELL).forces_in_tool


def combinations() -> list[tuple[Fault, str]]:
    """Fault by fault, phase by phase."""
    return [(fault, phase) for fault in FAULTS for phase in PHASES]
