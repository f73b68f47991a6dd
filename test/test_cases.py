# SPDX-License-Identifier: Apache-2.0
"""The hard plant of the first case study stays where the paper's real cell was, on a few courses."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))

from case_parts import calibrated  # noqa: E402
from case_parts.jobs import Case, Job, corrected  # noqa: E402
from case_parts.table import Figures, figures, outside_bands  # noqa: E402
from irec_calibration.cell import read_cell  # noqa: E402
from irec_sim.cellfile import read_cell as read_sim_cell  # noqa: E402
from irec_sim.production.hard import CAUSES, read_hard, without  # noqa: E402
from irec_sim.production.runner import drive  # noqa: E402
from irec_sim.production.ways import make_ways  # noqa: E402

COURSES = {"afp": (4, 8, 24, 28)}


@pytest.mark.parametrize("name", ["afp"])
def test_the_papers_own_correction_does_on_the_hard_plant_what_it_did_on_the_real_cell(name: str, tmp_path: Path) -> None:
    case = Case(name, tmp_path)
    sim, cell = read_sim_cell(case.cell_path), read_cell(case.cell_path)
    hard = read_hard(case.truth_path, sim)
    session = calibrated.measured_session(sim, cell, hard.truth, tmp_path / "session")
    calibrated.eighteen(session, tmp_path)
    ways = _some(make_ways(sim, hard.process), COURSES[name])
    job = Job("18dof", COURSES[name], str(tmp_path / "model_18dof.yaml"))
    controller = corrected(case, job, ways)
    before, after = (figures(drive(sim, hard, ways, c), cell.tolerance) for c in (None, controller))
    assert outside_bands(name, before, after) == []
    assert controller.told()["active_share"] > 0.95  # the correction was in force, and no watchdog took it out
    assert controller.told()["findings"] == 0


def _some(ways, rows):  # type: ignore[no-untyped-def]
    return ways.only(np.array(rows))


def test_a_plant_out_of_its_bands_is_told() -> None:
    good, easy = Figures(0.57, 0.956, 0.1, 0.1, 0.0), Figures(0.004, 0.02, 0.0, 0.0, 1.0)
    assert outside_bands("afp", good, Figures(0.061, 0.285, 0.05, 0.05, 1.0)) == []
    told = outside_bands("afp", good, easy)
    assert len(told) == 2 and "reduction of the mean is 99.3 %" in told[0]


@pytest.mark.parametrize("name", ["afp", "machining"])
def test_each_cause_of_a_hard_plant_can_be_switched_off(name: str) -> None:
    case = Case(name, Path())
    hard = read_hard(case.truth_path, read_sim_cell(case.cell_path))
    for cause in CAUSES:
        assert repr(without(hard, cause)) != repr(hard), cause
    assert without(hard, *CAUSES).truth.hidden == ()
