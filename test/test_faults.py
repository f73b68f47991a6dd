# SPDX-License-Identifier: Apache-2.0
"""A part of the fault matrix (`make faults` runs all of it): one fault of each kind, with real processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
RUN = ROOT / "tools" / "faults" / "fault_matrix.py"
sys.path.append(str(RUN.parent))

from catalogue import CORRECTION_FAULTS, CORRECTION_PHASES, FAULTS, PHASES, SOLVE_FAULTS  # noqa: E402
from fault_matrix import chosen, everything  # noqa: E402
from table import Results, Row, page  # noqa: E402

PROCEDURE = ("force NaN", "force silent", "force frozen", "tracker frozen", "disk full")
CORRECTION = ("force frozen", "rail NaN", "model refused")


def test_every_fault_is_tried_at_every_phase() -> None:
    all_of_them = everything()
    assert len(all_of_them) == len(set(all_of_them)) >= 150
    assert len(all_of_them) == len(FAULTS) * len(PHASES) + len(SOLVE_FAULTS) + len(CORRECTION_FAULTS) * len(CORRECTION_PHASES)


def test_parts_are_disjoint_and_together_everything() -> None:
    parts = [chosen(["procedure/*"], f"{k}/7") for k in range(1, 8)]
    assert [c for part in parts for c in part] == chosen(["procedure/*"], "")


def test_results_are_gone_on_with_and_a_failure_stands_on_the_page(tmp_path: Path) -> None:
    first = Results(tmp_path / "results.jsonl")
    first.add(Row("procedure", "force NaN", "pressing", robot="stands after 0.5 s", max_force=1100.0))
    bad = Row("correction", "rail NaN", "active", largest_step=1e-4)
    bad.fail("the offset makes a step of 100 um")
    first.add(bad)
    again = Results(tmp_path / "results.jsonl")
    assert set(again.rows) == {"procedure/force NaN/pressing", "correction/rail NaN/active"}
    text = page(list(again.rows.values()), 200)
    assert "**2 combinations tried of 200" in text and "1 failed" in text
    assert "* correction, rail NaN, active: the offset makes a step of 100 um" in text


def tried(only: list[str], folder: Path) -> None:
    """Run these combinations with real processes; all are held."""
    pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")
    assert set(only) <= {"/".join(c) for c in everything()}
    done = subprocess.run(
        [sys.executable, RUN, "--out", str(folder), "--only", *only], capture_output=True, text=True, timeout=380, check=False
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert f"{len(only)} combinations, 0 failed" in done.stdout


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(400)
def test_slip_in_contact_and_a_refused_model_are_held(tmp_path: Path) -> None:
    tried(["procedure/slip/pressing", "correction/model refused/active"], tmp_path)


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
@pytest.mark.timeout(400)
@pytest.mark.parametrize("side", ["procedure", "correction"])
def test_the_robot_is_safe_and_the_cause_is_told(side: str, tmp_path: Path) -> None:
    faults, phase = (PROCEDURE, "pressing") if side == "procedure" else (CORRECTION, "active")
    tried([f"{side}/{fault}/{phase}" for fault in faults], tmp_path)
