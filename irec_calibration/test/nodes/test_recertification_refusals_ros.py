# SPDX-License-Identifier: Apache-2.0
"""What is wrong is told by the nodes with what to do now: before anything moves, and in the middle of a run."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy
from aged_robot import calibrated_before
from irec_calibration.cell import read_cell
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import write_poses
from irec_calibration.session import read_session
from quick_cell import quick_cell
from test_recertification_restarts_ros import Person, kill, node

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.long, pytest.mark.timeout(900)]
POSES = 14


class Site:
    """A cell that is switched on, a calibration in force, and a calibration_node that is started anew for each case."""

    def __init__(self, folder: Path, start: Start, **cell: object) -> None:
        self.folder, self._start = folder, start
        self.cell_file = quick_cell(folder)
        self.poses = folder / "poses.yaml"
        known = read_cell(self.cell_file)
        write_poses(pose_list(known, make_plan(known, POSES, pool_size=150)), self.poses)
        self.cell = self.switch_on(**cell)
        module = "irec_calibration.nodes.procedure_node"
        self.procedure = self._node("procedure", module, session_folder=folder, use_sim_time="true")
        self._stores = 0
        rclpy.init()
        self.person = Person()

    def switch_on(self, **parameters: object) -> subprocess.Popen[bytes]:
        """Robot and instruments."""
        return self._node("cell", "irec_sim.nodes.cell_node", speed_factor=4.0, max_lead=0.1, **parameters)

    def calibration_node(self, calibrations: Path, cell_file: Path | None = None) -> subprocess.Popen[bytes]:
        parameters = {"cell": cell_file or self.cell_file, "calibration_folder": calibrations}
        self.person.client = None  # of the node before
        return self._node(f"calibration_{calibrations.parent.name}", "irec_calibration.nodes.calibration_node", **parameters)

    def _node(self, name: str, module: str, **parameters: object) -> subprocess.Popen[bytes]:
        return self._start(node(module, **{"cell": self.cell_file, **parameters}), name=name)

    def store(self, **conduct: float) -> Path:
        """Folder of calibrations, of its own, with one in force."""
        self._stores += 1
        work = self.folder / f"store_{self._stores}"
        work.mkdir()
        calibrated_before(read_cell(self.cell_file), self.poses, work / "cal", work, **conduct)
        return work / "cal"

    def asked(self, calibrations: Path, cell_file: Path | None = None, **goal: object) -> str:
        """Verdict and text of a recertification; nothing has moved and the calibration in force is what it was."""
        process = self.calibration_node(calibrations, cell_file)
        try:
            result = self.person.answer(self.person.ask(**{"poses_path": str(self.poses), "check_only": True, **goal}))
        finally:
            kill(process)
        assert not list(calibrations.rglob("*.mcap")) and not result.activated and result.model_path
        assert result.text.startswith("Nothing was moved. ") and result.text.endswith("then start again."), result.text
        assert "Do this now: " in result.text
        return f"{result.verdict}. {result.text}"

    def changed_cell(self, old: str, new: str) -> Path:
        text = self.cell_file.read_text()
        assert old in text
        path = self.folder / f"cell_{abs(hash(new))}.yaml"
        path.write_text(text.replace(old, new))
        return path


@pytest.fixture
def site(ros_domain: int, start_process: Start, tmp_path: Path) -> Iterator[Callable[..., Site]]:
    made: list[Site] = []

    def build(**cell: object) -> Site:
        made.append(Site(tmp_path, start_process, **cell))
        return made[-1]

    yield build
    for one in made:
        one.person.node.destroy_node()
    rclpy.try_shutdown()


def test_operator_temperature_tool_model_and_nodes_are_looked_at_before_anything_moves(site: Callable[..., Site]) -> None:
    here = site()
    listed = here.changed_cell("tolerance_m:", "operators: [M. Maier]\ntolerance_m:")
    text = here.asked(here.store(), listed, operator_name="M. Muster")
    assert text.startswith("failed: operator.") and "none of those whom the cell file names (M. Maier)" in text

    text = here.asked(here.store(warmer=60.0))
    assert text.startswith("failed: temperature.") and "move the robot until it is warm" in text

    heavier = here.changed_cell("payload: {mass: 0.0", "payload: {mass: 12.0")
    text = here.asked(here.store(), heavier)
    assert text.startswith("failed: stated tool.") and "mount that tool again" in text

    edited = here.store()
    (model,) = edited.glob("*/0001/model.yaml")
    model.write_text(model.read_text() + "# looked at\n")
    text = here.asked(edited)
    assert text.startswith("failed: model.") and "restore it from a backup" in text

    text = here.asked(here.store(), check_only=False, dry_run=False)
    assert text.startswith("failed: correction_node.") and "start and configure it" in text

    kill(here.procedure)
    text = here.asked(here.store())
    assert text.startswith("failed: procedure_node.") and "procedure_node: does not answer; start it" in text


def test_a_tracker_that_sees_nothing_is_told_before_anything_moves(site: Callable[..., Site]) -> None:
    here = site(**{"rate.tracker": 0.0})
    text = here.asked(here.store())
    assert text.startswith("failed: tracker.") and "does not see the marker; free the line of sight" in text
    assert "Do this now: put that right (tracker), then start again." in text


def test_instruments_that_fall_silent_end_the_run_with_advice_and_it_goes_on_later(site: Callable[..., Site]) -> None:
    here = site()
    person, few = here.person, here.folder / "few.yaml"
    known = read_cell(here.cell_file)
    write_poses(pose_list(known, make_plan(known, 4, pool_size=60)), few)
    calibrations = here.folder / "new" / "cal"
    here.calibration_node(calibrations)
    future = person.ask(full=True, poses_path=str(few))
    person.presses(after=1)
    kill(here.cell)
    lost = person.answer(future)
    assert not lost.success and lost.verdict.startswith("failed: "), lost.verdict
    assert "call irec/recertify with resume; it goes on after the last complete pose" in lost.text
    here.switch_on()
    result = person.answer(person.ask(resume=True))
    assert result.verdict.startswith("failed: 4 poses were measured, at least 12 are needed"), result.text
    assert result.text.startswith("On poses kept apart the new calibration errs by"), "the answer that was asked for comes first"
    assert "Do this now: " in result.text
    (recording,) = calibrations.rglob("full.mcap")
    assert len(read_session(recording)) == 4 * 6, "each pose once"
