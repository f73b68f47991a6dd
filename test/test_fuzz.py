# SPDX-License-Identifier: Apache-2.0
"""Damaged, altered and hostile files are refused in one line: no trace, no hang, no gigabyte (`make fuzz`: an hour)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SECONDS, FEWEST = 34, 100  # some seconds of them to import what reads; files, on a busy machine
RUN = Path(__file__).resolve().parents[1] / "tools" / "fuzz" / "run.py"


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", [1, 2])  # half a minute of files each, one on each process of the suite
def test_no_reader_fails_on_mutated_files(tmp_path, seed):
    command = [sys.executable, RUN, "--seconds", str(SECONDS), "--seed", str(seed), "--keep", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert int(done.stdout.splitlines()[-1].split()[0]) > FEWEST, done.stdout
