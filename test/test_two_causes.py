# SPDX-License-Identifier: Apache-2.0
"""Two large causes of which neither stands alone: what both leave has structure that the generic family describes better."""

from __future__ import annotations

from pathlib import Path

import pytest
from irec_calibration.diagnose import diagnose
from irec_calibration.session import read_session
from irec_sim.cellfile import read_cell
from irec_sim.session import generate, scale_to_share, write_session
from irec_sim.truth import make_truth

CELL = Path(__file__).parents[1] / "config" / "cells" / "milling.yaml"


@pytest.mark.slow
def test_a_hose_and_a_force_sensor_that_is_mounted_turned_are_found_beside_each_other(tmp_path: Path) -> None:
    cell = read_cell(CELL)
    truth, _ = scale_to_share(cell, make_truth("milling", ["sensor_alignment", "external_force"], 2), 0.15, 2)
    verdict = diagnose(read_session(write_session(generate(cell, truth, 26, 2), tmp_path / "s", "s"))).verdict
    told = {*verdict.effects, *(name for several in verdict.one_of for name in several)}
    assert "external_force" in verdict.effects and "sensor_alignment" in told, verdict.text
    assert set(verdict.effects) <= {"external_force", "sensor_alignment"}
