# SPDX-License-Identifier: Apache-2.0
"""One fault while a session is being solved: the caller is answered or sees the node gone, and nothing comes into force."""

from __future__ import annotations

import resource
import shutil
import signal
import time
from pathlib import Path
from typing import Any

from irec_calibration.cell import read_cell
from irec_calibration.recertification.store import Store
from stack import CELL, START, NotReached, Stack
from table import Row

from irec_msgs.srv import SolveCompliances

ANSWER = 60.0  # s of the machine's clock


class SolveSide:
    """All faults, each followed by a solve that has to succeed."""

    def __init__(self, stack: Stack) -> None:
        self.stack = stack
        self._client = stack.node.create_client(SolveCompliances, "irec/solve")
        self._store = Store(stack.folder / "calibrations", read_cell(CELL).serial)
        self._session = stack.folder / "solve_session"

    def _make_session(self) -> None:
        """A drawn session of the simulated cell."""
        import subprocess
        import sys

        if not self._session.exists():
            made = [sys.executable, "-m", "irec_sim.cli", "session", "--poses", "12", "--seed", "3", "--name", "solve",
                    "-o", str(self._session)]  # fmt: skip
            subprocess.run(made, check=True, capture_output=True, timeout=120)

    def run(self, fault: str) -> Row:
        row = Row("solve", fault, "solve")
        s = self.stack
        try:
            self._make_session()
            s.ensure("driver", "procedure", "calibration")
            s.until(self._client.service_is_ready, "irec/solve", START)
            self._make(fault, row)
            self._after(row)
        except NotReached as error:
            row.fail(str(error))
        return row

    def _call(self, session: Path, model: Path) -> Any:
        request = SolveCompliances.Request(session_path=str(session), model_path=str(model), effects=["joint_torsion"])
        return self._client.call_async(request)

    def _make(self, fault: str, row: Row) -> None:
        s, folder = self.stack, self.stack.folder
        process = s.processes["calibration"]
        session, model = self._session, folder / "solved.yaml"
        if fault == "path not writable":
            model = Path("/proc/nowhere/model.yaml")
        elif fault == "disk full":
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (64, resource.RLIM_INFINITY))
            model.unlink(missing_ok=True)
        elif fault == "session gone":
            session = folder / "no such session"
        elif fault in ("session altered", "session damaged"):
            session = folder / "altered"
            shutil.rmtree(session, ignore_errors=True)
            shutil.copytree(self._session, session)
            header = session / "session.yaml"
            text = header.read_text()
            header.write_text(_altered(text) if fault == "session altered" else text[: len(text) // 2] + "\n  - [")
        future = self._call(session, model)
        if fault.startswith("SIG"):
            s.spin(0.3)
            who = s.processes[fault.split()[1]]
            who.send(signal.SIGKILL if fault.startswith("SIGKILL") else signal.SIGSTOP)
            if fault.startswith("SIGSTOP"):
                end = time.monotonic() + 3.0
                s.until(lambda: time.monotonic() > end, "the pause", 10.0)
                who.send(signal.SIGCONT)
        if fault == "SIGKILL calibration":
            s.until(lambda: not self._client.service_is_ready(), "the caller sees that the node has gone", 40.0)
            row.cause, row.run = "irec/solve has gone from the graph", "no answer"
            process.end()
            return
        try:
            s.until(future.done, "an answer of irec/solve", ANSWER)
        finally:
            if fault == "disk full":
                resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
        answer = future.result()
        row.cause = answer.message
        wanted = fault.startswith("SIG")
        if answer.success != wanted:
            row.fail(f"irec/solve says success: {answer.success}: {answer.message}")
        if not answer.message:
            row.fail("nothing names the cause")
        if fault == "disk full" and model.exists():
            row.fail("a broken model file was left")

    def _after(self, row: Row) -> None:
        s = self.stack
        s.ensure("driver", "procedure", "calibration")
        s.until(self._client.service_is_ready, "irec/solve after the fault", START)
        future = self._call(self._session, s.folder / "good.yaml")
        s.until(future.done, "an answer of irec/solve after the fault", ANSWER)
        if not future.result().success:
            row.fail(f"the next solve fails: {future.result().message}")
        row.run += "; the next solve succeeds" if row.run else "the next solve succeeds"
        if self._store.in_force() is not None:
            row.fail("a calibration has come into force")


def _altered(text: str) -> str:
    """A header whose load cases are a list, as somebody might have edited it."""
    lines, out, skip = text.splitlines(), [], False
    for line in lines:
        if line.startswith("load_cases:"):
            out.append("load_cases: [1, 2]")
            skip = True
        elif skip and (line.startswith((" ", "-"))):
            continue
        else:
            skip = False
            out.append(line)
    return "\n".join(out) + "\n"
