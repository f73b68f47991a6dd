# SPDX-License-Identifier: Apache-2.0
"""The page for the cell in a real browser, against the simulated cell and the nodes."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")
pytest.importorskip("nicegui", reason="NiceGUI is missing: pip install 'irec_calibration[workbench]'")
pytest.importorskip("playwright.sync_api", reason="Playwright is missing: pip install playwright")

from aged_robot import calibrated_before
from irec_calibration.cell import Cell, read_cell
from irec_calibration.poses.plan import make_plan, pose_list
from irec_calibration.poses.store import write_poses
from irec_calibration.recertification.store import Store
from irec_calibration.workbench.cell_logic import CONFIRM
from quick_cell import quick_cell
from test_browser import Person
from workbench_server import CHROMIUM, Server

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [
    pytest.mark.ros,
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(not CHROMIUM, reason="no Chromium here: apt-get install chromium"),
]
POSES = 14
SPEED = 6.0
WHOLE_RUN = 600_000  # ms


class Shopfloor:
    """Cell, nodes, page and browser of one test."""

    def __init__(self, cell: Cell, folder: Path, start: Start, browser: object, page_folder: Path) -> None:
        self.cell, self.folder, self._start = cell, folder, start
        self.node("irec_sim.nodes.cell_node", cell=cell.path, speed_factor=SPEED, max_lead=0.1)
        self.node("irec_calibration.nodes.procedure_node", cell=cell.path, session_folder=folder, use_sim_time="true")
        self.node("irec_calibration.nodes.calibration_node", cell=cell.path, calibration_folder="cal")
        self.server = Server(folder, "--cell", str(cell.path), "--calibrations", str(folder / "cal"))
        self.person = Person(browser, page_folder, 820, 1180)
        self.person.page.goto(f"{self.server.url}/cell")

    def node(self, module: str, **parameters: object) -> None:
        settings = [text for name, value in parameters.items() for text in ("-p", f"{name}:={value}")]
        self._start([sys.executable, "-m", module, "--ros-args", *settings], name=module.rpartition(".")[2])

    def begin(self, button: str, *also: str) -> None:
        """Press a button and confirm everything; `also`: further boxes to tick."""
        person = self.person
        person.part(button).click()
        for name in (*(f"tick-{key}" for key in CONFIRM), *also):
            person.part(name).click()
        person.part("name").fill("M. Muster")
        person.part("start").click()

    def poses_told(self) -> int:
        """Pose that the page says the robot is in; 0: it says none."""
        found = re.search(r"Pose (\d+) of \d+", self.person.part("far").inner_text())
        return int(found[1]) if found else 0


@pytest.fixture
def opened(
    ros_domain: int, start_process: Start, browser: object, tmp_path: Path
) -> Iterator[Callable[[Callable[[Cell], object]], Shopfloor]]:
    """Opens the page; takes what prepares the store from the cell."""
    made: list[Shopfloor] = []

    def open_page(prepare: Callable[[Cell], object]) -> Shopfloor:
        path = quick_cell(tmp_path)
        text = path.read_text()
        lines = [f"poses: {tmp_path / 'poses.yaml'}" if line.startswith("poses:") else line for line in text.splitlines()]
        path.write_text("\n".join(lines) + "\n")
        cell = read_cell(path)
        write_poses(pose_list(cell, make_plan(cell, POSES, pool_size=150)), tmp_path / "poses.yaml")
        prepare(cell)
        made.append(Shopfloor(cell, tmp_path, start_process, browser, tmp_path))
        return made[-1]

    yield open_page
    for shopfloor in made:
        shopfloor.server.kill()
        shopfloor.person.page.close()


def test_check_asks_first_tells_every_precondition_and_moves_nothing_without_a_calibration(opened) -> None:
    shopfloor = opened(lambda cell: None)
    person = shopfloor.person
    person.sees("light", "UNKNOWN")
    person.part("check").click()
    person.part("start").click()
    person.sees("missing", "Enter your name first")
    person.page.get_by_role("button", name="Leave it").click()
    shopfloor.begin("check")
    person.sees("preconditions", "✓ operator: M. Muster")
    person.sees("preconditions", "✗ model: there is no calibration in force")
    person.sees("preconditions", "✓ procedure_node: answers")
    person.sees("preconditions", "✓ force sensor: reads")
    person.sees("preconditions", "✓ tracker: the marker drifts by")
    person.sees("light", "Nothing was moved")
    person.sees("light", "UNKNOWN")
    person.sees("now", "Do this now: put that right (model), then start again")
    person.keeps_picture("refused")
    assert not list((shopfloor.folder / "cal").rglob("*.mcap")), "nothing was measured"
    assert person.errors == []


@pytest.mark.long
def test_a_softer_axis_is_seen_and_recalibrated_with_a_pause_and_a_stop_and_the_way_back(opened) -> None:
    stores: list[Store] = []

    def prepare(cell: Cell) -> None:
        folder = Path(cell.path).parent
        stores.append(calibrated_before(cell, folder / "poses.yaml", folder / "cal", folder, axis=2, softer=1.3))

    shopfloor = opened(prepare)
    person = shopfloor.person
    shopfloor.node(
        "irec_correction.nodes.correction_node", cell=shopfloor.cell.path, calibrations="cal", autostart="true",
        use_sim_time="true", rate=50.0,
    )  # fmt: skip

    shopfloor.begin("check")
    person.sees("far", "Pose 1 of ", WHOLE_RUN)
    assert person.part("stop").is_visible() and person.part("pause").is_visible()
    person.sees("light", "NOT GOOD", WHOLE_RUN)
    person.sees("light", "axis 2")
    person.sees("now", "Do this now: run the full recalibration")
    person.keeps_picture("checked")

    shopfloor.begin("recalibrate", "full")
    person.sees("preconditions", "✓ correction_node: answers")
    person.sees("far", f"Pose 2 of {POSES}", WHOLE_RUN)
    person.part("pause").click()
    person.sees("light", "leaving the contact")
    person.sees("far", "Paused.")
    person.keeps_picture("paused")
    before = shopfloor.poses_told()
    person.page.wait_for_timeout(3000)  # in which it would have gone on by more than a pose
    assert shopfloor.poses_told() == before
    person.part("resume").click()
    person.sees("far", f"Pose {before + 1} of {POSES}", WHOLE_RUN)
    person.part("stop").click()
    person.sees("light", "UNKNOWN", WHOLE_RUN)
    person.sees("now", "press Recalibrate and tick 'Go on", WHOLE_RUN)
    person.keeps_picture("stopped")
    assert stores[0].in_force_entry().calibration == "0001"

    shopfloor.begin("recalibrate", "go-on")
    person.sees("far", f" of {POSES}", WHOLE_RUN)
    assert shopfloor.poses_told() > before, "complete poses are not measured again"
    person.sees("light", "✓ GOOD", WHOLE_RUN)
    person.sees("light", "It is now in force", WHOLE_RUN)
    person.sees("now", "check one part at reduced speed")
    person.keeps_picture("recalibrated")
    assert stores[0].in_force_entry().calibration == "0002"
    with person.page.expect_download() as download:
        person.part("certificate").click()
    assert download.value.suggested_filename == "certificate.pdf"

    person.part("go-back").click()
    person.sees("past", "0002: ")
    assert person.part("past").count() == 2 and person.part("past").first.is_disabled(), "0002 is in force now"
    person.keeps_picture("go-back")
    person.part("past").nth(1).click()
    person.page.get_by_text("Enter your name first").wait_for()
    person.part("back-name").fill("M. Muster")
    person.part("past").nth(1).click()
    person.sees("light", "Calibration 0001 is in force now")
    entry = stores[0].in_force_entry()
    assert (entry.calibration, entry.by) == ("0001", "M. Muster")
    assert person.errors == []
