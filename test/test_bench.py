# SPDX-License-Identifier: Apache-2.0
"""Benches that `make bench` and `make endurance` run: each prints its figures for a small case. How fast it was is not judged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arguments", "figure"),
    [
        ("workbench.py", ["--poses", "8", "--large", "0"], "slowest answer of a linear effect"),
        ("rows.py", ["155", "--fit"], "answer\n    186 "),
        pytest.param("poses_codec.py", [], "CODEC of 62 poses", marks=pytest.mark.long),
    ],
)
def test_a_bench_prints_its_figures(name, arguments, figure):
    command = [sys.executable, str(ROOT / "tools/bench" / name), *arguments]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=200)
    assert run.returncode in (0, 1) and "Traceback" not in run.stderr, run.stderr
    assert figure in run.stdout


@pytest.mark.ros
@pytest.mark.long
def test_the_endurance_of_the_procedure_measures_poses_and_tells_slopes(tmp_path):
    bench = [sys.executable, str(ROOT / "tools/endurance/procedure.py"), "--seconds", "90", "--out", str(tmp_path / "out")]
    run = subprocess.run(bench, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert "Traceback" not in run.stderr, run.stderr
    first = run.stdout.splitlines()[0]
    assert int(first.split(" runs, ")[1].split()[0]) >= 1, run.stdout
    assert "procedure: " in run.stdout and "driver: " in run.stdout and "memory_kB" in run.stdout
