# SPDX-License-Identifier: Apache-2.0
"""Damaged, altered and hostile files are refused in one line: no trace, no hang, no gigabyte (`make fuzz`: an hour)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).resolve().parents[1] / "tools" / "fuzz" / "run.py"


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_no_reader_fails_on_a_minute_of_mutated_files(tmp_path):
    done = subprocess.run(
        [sys.executable, RUN, "--seconds", "60", "--keep", tmp_path], capture_output=True, text=True, timeout=280, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    assert int(done.stdout.splitlines()[-1].split()[0]) > 100, done.stdout
