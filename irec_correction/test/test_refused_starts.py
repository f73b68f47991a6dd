# SPDX-License-Identifier: Apache-2.0
"""Nodes that can't start end with the reason: nothing here keeps time, so it runs beside other tests."""

from __future__ import annotations

import subprocess
import sys

import pytest
from cell_side import CELL, START

pytestmark = pytest.mark.ros


def refused(node: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A node that refuses to start, with what it says."""
    command = [sys.executable, "-m", f"irec_correction.nodes.{node}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * START, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stdout + done.stderr
    return done


@pytest.mark.parametrize("node", ["correction_node", "rsi_bridge", "can_ft_node"])
def test_ros_arguments_that_cannot_be_read_are_a_line_and_no_trace(ros_domain, node):
    assert "/nowhere/params.yaml" in refused(node, "--ros-args", "--params-file", "/nowhere/params.yaml").stderr


def test_a_bridge_without_a_cell_refuses_and_says_so(ros_domain):
    assert "parameter 'cell'" in refused("rsi_bridge").stderr


def test_a_cycle_time_that_rsi_does_not_have_is_refused(ros_domain):
    done = refused("rsi_bridge", "--ros-args", "-p", f"cell:={CELL}", "-p", "port:=0", "-p", "cycle_ms:=8")
    assert "cycle_ms" in done.stderr
