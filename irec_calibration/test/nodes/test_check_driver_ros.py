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

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.alone]
CELL = Path(__file__).parents[3] / "config" / "cells" / "afp.yaml"
LONGEST = 280.0  # s of the machine's clock


def passes_every_level(folder: Path) -> None:
    report = folder / "check.json"
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


def node(module: str, *arguments: str) -> list[str]:
    return [sys.executable, "-m", module, "--ros-args", "-p", f"cell:={CELL}", *arguments]


def test_the_simulated_cell_passes_every_level(ros_domain: int, start_process: Start, tmp_path: Path) -> None:
    start_process(node("irec_sim.nodes.cell_node", "-p", "speed_factor:=3.0", "-p", "max_lead:=0.1"), name="cell")
    passes_every_level(tmp_path)


def test_a_file_that_is_no_report_is_not_written_over(ros_domain: int, tmp_path: Path) -> None:
    there = tmp_path / "cell.yaml"
    there.write_text(CELL.read_text())
    command = node("irec_calibration.nodes.check_driver", "-p", f"report:={there}")
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2 and f"{there}: exists and is not a report of check_driver" in done.stderr
    assert there.read_text() == CELL.read_text()


@pytest.mark.long
def test_the_driver_for_ros2_control_passes_every_level(ros_domain: int, start_process: Start, tmp_path: Path) -> None:
    from irec_calibration.commands.tool_load import parameter_file
    from irec_calibration.sensors.tool_load import ToolLoad
    from irec_sim.cellfile import read_cell as read_simulated

    chain = read_simulated(CELL).chain
    x, y, z = (float(v) for v in chain.tool_com)
    load = ToolLoad(float(chain.tool_mass), (x, y, z), (18.0, -11.0, 25.0), (1.2, -0.8, 0.5))  # bias of the simulated sensor
    weight = tmp_path / "tool_load.yaml"
    weight.write_text(parameter_file(load, ("mass", "com", "bias_force", "bias_torque")), encoding="utf-8")
    hardware = node("irec_sim.nodes.ros2_control_node", "-p", "speed_factor:=1.0", "-p", "max_lead:=0.1")
    start_process(hardware, name="hardware")
    driver = node("irec_calibration.nodes.ros2_control_driver", "--params-file", str(weight), "-p", "use_sim_time:=true")
    start_process(driver, name="driver")
    passes_every_level(tmp_path)
