# SPDX-License-Identifier: Apache-2.0
"""Wrong drivers over DDS: the live procedure and the live check_driver say what is wrong, before the second pose.

Here a few of them, each of another kind; all: tools/wrong_drivers/wrong_drivers.py.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("rclpy", reason="rclpy is missing: run `make test`")
pytest.importorskip("irec_msgs", reason="irec_msgs is not built: run `make test`")

import rclpy

ROOT = Path(__file__).parents[3]
sys.path.append(str(ROOT / "tools" / "wrong_drivers"))
if TYPE_CHECKING:
    Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = pytest.mark.ros
FAULTS = ("wrench in base_link", "joints of other names", "tcp_pose silent", "sign of the force turned")
CHECKED = "wrench in base_link"  # by check_driver too: one start of a process more


@pytest.fixture
def line(ros_domain: int, start_process: Start, tmp_path: Path) -> Iterator[Any]:
    from wrong_drivers import Line

    rclpy.init()
    made = Line(lambda name, arguments: start_process(arguments, name=name), tmp_path)
    yield made
    made.node.destroy_node()
    rclpy.try_shutdown()


def test_wrong_drivers_are_stopped_before_the_second_pose_with_the_right_sentence(line: Any) -> None:
    from wrong_drivers import EXPECTED

    said = {name: line.procedure(name) for name in FAULTS}
    for name, what in said.items():
        assert not what.success and what.poses == 0, f"{name}: {what.message}"
        assert EXPECTED[name].procedure in what.message, f"{name}: {what.message}"
    failed = line.check(CHECKED)
    assert any(EXPECTED[CHECKED].check in item for item in failed), failed
