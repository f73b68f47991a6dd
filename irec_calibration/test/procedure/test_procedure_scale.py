# SPDX-License-Identifier: Apache-2.0
"""A run that can't verify the scale of the force says so before it presses, at its end, and in its session."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fake_robot import FakeRobot
from irec_calibration.cell import read_cell
from irec_calibration.commands.check import check_file
from irec_calibration.procedure.scale import scale_notes
from irec_calibration.procedure.settings import Checks

CELLS = Path(__file__).parents[3] / "config" / "cells"


class Judge:
    """In place of Plausibility: all agrees, and of the scale is known what a test says."""

    def __init__(self, before: str, after: str) -> None:
        self.before, self.scale = before, SimpleNamespace(doubt=lambda: after)

    def scale_doubt_before(self, R_tool: np.ndarray) -> str:
        assert R_tool.shape[1:] == (3, 3)
        return self.before

    def problem(self, standing: object) -> str:
        return ""

    def weight_problem(self, R_tool: np.ndarray) -> str:
        return ""


def told(robot: FakeRobot) -> list[str]:
    return [e.text for e in robot.events if e.kind == "unverified"]


def test_what_the_poses_can_not_tell_is_said_before_anything_is_pressed() -> None:
    robot = FakeRobot(1, plausibility=Judge("alike", "alike"))
    robot.start().run(stop_when="force_mode")
    assert told(robot) == ["alike"] and robot.procedure.scale_doubt == "alike"
    robot.run()
    assert told(robot) == ["alike"] and robot.procedure.counts.complete == 1, "it is told once, and the run goes on"


def test_what_a_run_could_have_verified_and_has_not_is_said_at_its_end() -> None:
    robot = FakeRobot(1, plausibility=Judge("", "no wrench_raw")).start().run()
    assert told(robot) == ["no wrench_raw"] and robot.procedure.scale_doubt == "no wrench_raw"


def test_a_run_that_has_verified_the_scale_says_nothing_of_it() -> None:
    robot = FakeRobot(1, plausibility=Judge("", "")).start().run()
    assert not told(robot) and not robot.procedure.scale_doubt


def test_a_run_that_has_not_pressed_says_nothing_of_the_scale() -> None:
    robot = FakeRobot(1, plausibility=Judge("", "no wrench_raw")).start()
    robot.procedure.stop("cancelled")
    assert not told(robot.run())


@pytest.mark.parametrize(("limit", "presses"), [(0.0, True), (2000.0, True), (500.0, False)])
def test_a_cell_file_may_forbid_forces_of_a_scale_that_nobody_knows(limit: float, presses: bool) -> None:
    judge = Judge("alike", "alike")
    robot = FakeRobot(1, plausibility=judge, settings={"checks": Checks(unverified_n=limit)}).start().run()
    assert bool(robot.set_points) == presses
    if not presses:
        assert "more than 500 N (procedure.checks.unverified_n) is not pressed" in robot.procedure.stopped_because


def test_a_cell_file_that_states_no_mass_is_noted_by_irec_check(tmp_path: Path) -> None:
    cell = read_cell(CELLS / "afp.yaml")
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(cell.robot.urdf_text.replace('<mass value="120"/>', '<mass value="0"/>'), encoding="utf-8")
    text = cell.text.replace(str(cell.raw["robot"]["urdf"]), urdf.name).replace(str(cell.raw["poses"]), "none.yaml")
    bare = tmp_path / "cell.yaml"
    bare.write_text(text, encoding="utf-8")
    found = check_file(bare)
    assert not found["problems"]
    assert any("the scale of the force could not be verified" in n and "state no mass" in n for n in found["notes"])


def test_poses_that_incline_the_tool_differently_are_not_noted() -> None:
    assert scale_notes(read_cell(CELLS / "afp.yaml")) == []
