# SPDX-License-Identifier: Apache-2.0
"""check_driver against live drivers that keep the contract: all levels, from looking on to pressing."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.slow]
CELL = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
LONGEST = 280.0  # s of the machine's clock


def test_the_simulated_cell_passes_every_level(ros_domain: int, start_process: Start, tmp_path: Path) -> None:
    cell = [sys.executable, "-m", "irec_sim.nodes.cell_node", "--ros-args", "-p", f"cell:={CELL}"]
    start_process([*cell, "-p", "speed_factor:=1.0", "-p", "max_lead:=0.1"], name="cell")
    report = tmp_path / "check.json"
    settings = {
        "cell": CELL, "use_sim_time": "true", "report": report,
        "level": "pressing", "approach": "true", "surface_confirmed": "true",
    }  # fmt: skip
    arguments = [word for name, value in settings.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", "irec_calibration.nodes.check_driver", "--ros-args", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
    assert report.is_file(), done.stderr or done.stdout
    items = json.loads(report.read_text())
    failed = [f"{i['name']}: {i['figure']} (limit {i['limit']}); {i['advice']}" for i in items if not i["passed"]]
    assert not failed, "\n".join(failed)
    assert done.returncode == 0, done.stderr
    assert {item["level"] for item in items} == {"passive", "moves", "offset", "pressing"}
