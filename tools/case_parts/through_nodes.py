# SPDX-License-Identifier: Apache-2.0
"""The calibration session of a case through the nodes, as at a real cell: simulated cell on the hard plant and procedure.
Interrupted, it goes on after the last complete pose."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from demo_parts.domain import free_domain
from irec_calibration.cell import Cell
from irec_calibration.errors import IrecError

if TYPE_CHECKING:
    from irec_msgs.action import RunProcedure

SPEED = 6.0  # simulated seconds per second, at most
MAX_LEAD = 0.019  # s of the cell's clock that it may be ahead of the procedure: less than its watchdogs allow
TIMEOUT = 1800.0  # s of the machine's clock; a busy machine takes several times what a free one does
TELL = 8.0  # s between lines
REFERENCE = 0.007  # m from contact. The arm sags by up to 4.3 mm under its own weight, and nobody has corrected its programs for
# that, as was done in the paper: at the 3 mm of the cell file it touches already at a quarter of the poses.


def cell_of(cell: Cell, folder: Path) -> Path:
    """The cell file as it is taken through the nodes: the reference further from contact."""
    data = yaml.safe_load(cell.path.read_text(encoding="utf-8"))
    data["robot"]["urdf"] = str((cell.path.parent / data["robot"]["urdf"]).resolve())
    data.update(poses=str(cell.poses_path), reference_distance=REFERENCE)
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True), encoding="utf-8")
    return path


def record(cell: Cell, truth: Path, recording: Path, say: Callable[[str], None]) -> int:
    """Procedure 1 at the poses of the cell file into `recording`; goes on where the file is there already.

    Returns:
        Complete poses.

    Raises:
        IrecError: ROS is not there, a node has ended or refused, or the run did not come to its end.
    """
    os.environ["ROS_DOMAIN_ID"] = str(free_domain())  # before the first ROS import: nobody else's topics
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"  # no packet leaves the machine
    try:
        from demo_parts.operator import Operator, RequestRefused
        from demo_parts.processes import NodeEnded, Processes

        from irec_msgs.action import RunProcedure
    except ImportError as error:
        raise IrecError(f"the nodes need ROS 2 and irec_msgs ({error}); --no-nodes generates the session without them") from error
    path = str(cell_of(cell, recording.parent))
    goal = RunProcedure.Goal(poses_path=str(cell.poses_path), session_path=str(recording), resume=recording.is_file())
    if goal.resume:
        say(f"going on with {recording.name}")
    try:
        with Processes(recording.parent / "log", {}) as processes:
            given = {"cell": path, "truth": str(truth), "speed_factor": SPEED, "max_lead": MAX_LEAD}
            processes.start("cell", "irec_sim.nodes.cell_node", given)
            asked = {"cell": path, "session_folder": str(recording.parent), "use_sim_time": True}
            processes.start("procedure", "irec_calibration.nodes.procedure_node", asked)
            operator = Operator(processes.check)
            try:
                result = operator.run_procedure(goal, TIMEOUT, _Told(say))
            finally:
                operator.close()
    except (RequestRefused, NodeEnded) as error:
        raise IrecError(f"calibration through the nodes: {error}; the same command goes on from there") from error
    if not result.success:
        raise IrecError(f"Procedure 1 did not come to its end: {result.message}; the same command goes on from there")
    say(result.message)
    return int(result.poses_recorded)


class _Told:
    """Progress of the procedure, a line now and then."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self._begun, self._first, self._last = say, time.monotonic(), 0, time.monotonic()

    def __call__(self, f: RunProcedure.Feedback) -> None:
        now = time.monotonic()
        self._first = self._first or f.pose
        if now < self._last + TELL:
            return
        self._last, done = now, f.pose - self._first
        left = f", about {(now - self._begun) / done * (f.poses - f.pose + 1):.0f} s left" if done > 1 else ""
        self._say(f"pose {f.pose} of {f.poses}, load case {f.load_case} of {f.load_cases}, {f.state}{left}")
