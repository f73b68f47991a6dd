# SPDX-License-Identifier: Apache-2.0
"""Damaged, altered and hostile files are refused in one line: no trace, no hang, no gigabyte (`make fuzz`: an hour)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

FILES = 1000  # the same ones each time, on a busy machine too
RUN = Path(__file__).resolve().parents[1] / "tools" / "fuzz" / "run.py"


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])  # a quarter of a minute each
def test_no_reader_fails_on_mutated_files(tmp_path, seed):
    command = [sys.executable, RUN, "--files", str(FILES), "--seed", str(seed), "--keep", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=880, check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert done.stdout.splitlines()[-1] == f"{FILES} files, 0 failures", done.stdout
